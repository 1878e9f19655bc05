"""First guesses of the windows' initial states, from the angles around their beginnings."""

from __future__ import annotations

import numpy as np
from heli_host.data.arrays import Floats, Integers
from heli_sim.model.parts import AXES

from heli_lab.fit.identify.estimation_problem.grid import make_grid
from heli_lab.fit.identify.estimation_problem.problem import RIGID_STATES, Problem, delay_of
from heli_lab.fit.identify.record import Record
from heli_lab.fit.identify.thresholds import SETTLED_S, SHORT_FIT_S, STATE_FIT_S


def initial_state_guess(problem: Problem, theta: Floats) -> list[Floats]:
    """Guess the initial states of all windows from the measured angles; see `states_at`. Shapes: `theta`
    (f,); returns (w, states).
    """
    return [
        states_at(problem, index, problem.first_rows(index), theta) for index in range(len(problem.records))
    ]


def states_at(problem: Problem, index: int, rows: Integers, theta: Floats) -> Floats:
    """Estimate the states of the model at given rows of a flight from the measured angles. Shapes: `rows`
    (w,), `theta` (f,); returns (w, states).

    Angles and rates come from parabolas through the samples around each row. States of effects come from a
    free run (open-loop simulation) that ends at the row; a state that an encoder measures is the measured
    angle.
    """
    record = problem.records[index]
    states = np.zeros((len(rows), problem.state_count))
    states[:, :RIGID_STATES] = _angles_and_rates_by_parabola(record, rows, STATE_FIT_S)
    if problem.state_count == RIGID_STATES:
        return states
    states[:, RIGID_STATES:] = _effect_states_after_run_in(problem, index, rows, states, theta)
    measured = {state: axis for effect in problem.model.effects for state, axis in effect.measured_as.items()}
    for column, state in enumerate(problem.model.states):
        if state.name in measured:
            states[:, column] = record.angles_rad[rows, AXES.index(measured[state.name])]
    return states


def alternative_states(problem: Problem, index: int, theta: Floats, states: Floats) -> list[Floats]:
    """List other initial states to try for windows whose optimisation ended in a wrong local minimum.
    Shapes: `theta` (f,), `states` (w, states); returns (w, states).

    The first alternative is the end of the previous window, if the two windows adjoin: friction and backlash
    depend on the motion before. The second has rates from a few samples only, which a jump of the torque
    nearby does not distort. The others are the alternatives that effects define.
    """
    short_fit = states.copy()
    short_fit[:, :RIGID_STATES] = _angles_and_rates_by_parabola(
        problem.records[index], problem.first_rows(index), SHORT_FIT_S
    )
    ends_of_previous = _ends_of_previous_windows(problem, index, theta, states)
    return [ends_of_previous, short_fit, *_starts_of_effects(problem, index, theta)]


def _ends_of_previous_windows(problem: Problem, index: int, theta: Floats, states: Floats) -> Floats:
    """Predict the state at the end of the window before each window, shape (w, states).

    The state of a window stays as in `states` if no window ends just before it, or if that prediction
    diverges.
    """
    grid, parameters = problem.grid(index, fine=False, theta=theta), problem.parameters(theta, index)
    _, ends = problem.kernel.predict(grid.inputs, states, parameters)
    first, count = np.array(problem.windows(index)).T
    # A window that follows a gap or a diverged window keeps its own states.
    adjoins = first[:-1] + count[:-1] == first[1:]
    previous = np.flatnonzero(adjoins & np.isfinite(ends[:-1]).all(axis=1))
    result = states.copy()
    result[previous + 1] = ends[previous]
    return result


def _starts_of_effects(problem: Problem, index: int, theta: Floats) -> list[Floats]:
    """Return the first guess of the initial states, shape (w, states), shifted by the offsets of each
    alternative that an effect defines.
    """
    model = problem.model
    values = dict(zip(model.parameter_names, problem.parameters(theta, index), strict=True))
    columns = {state.name: column for column, state in enumerate(model.states)}
    starts = []
    for effect in model.effects:
        for offsets in effect.alternative_starts(values):
            start = states_at(problem, index, problem.first_rows(index), theta)
            for name, offset in offsets.items():
                start[:, columns[name]] += offset
            starts.append(start)
    return starts


def _effect_states_after_run_in(
    problem: Problem, index: int, rows: Integers, states: Floats, theta: Floats
) -> Floats:
    """Estimate the states of effects at given rows by simulations that end there. Shapes: `rows` (w,),
    `states` (w, states); returns (w, states - 6).

    A simulation begins `SETTLED_S` before its row, with effects at rest. It may begin before the segment of
    free flight, because the voltages drive the rotors also while the arm lies on its table. There, angles and
    rates are not those of free flight, and the simulation starts with the ones at its end instead.
    """
    record, parameters = problem.records[index], problem.parameters(theta, index)
    effect_states = np.zeros((len(rows), problem.state_count - RIGID_STATES))
    # No simulation may cross a gap of the log.
    starts_after_gaps = np.array([0, *(gap + 1 for gap in record.gaps)])
    earliest = starts_after_gaps[np.searchsorted(starts_after_gaps, rows, side="right") - 1]
    lengths = np.minimum(rows - earliest, round(SETTLED_S / record.step_s))
    simulated = np.flatnonzero(lengths > 0)
    if len(simulated):
        first_rows = rows[simulated] - lengths[simulated]
        windows = list(zip(first_rows.tolist(), lengths[simulated].tolist(), strict=True))
        grid = make_grid(record, windows, 1, delay=delay_of(problem.model, parameters))
        start = states[simulated].copy()
        start[:, RIGID_STATES:] = 0.0
        in_segment = first_rows >= _segment_of_rows(record, rows[simulated])[:, 0]
        start[in_segment, :RIGID_STATES] = _angles_and_rates_by_parabola(
            record, first_rows[in_segment], STATE_FIT_S
        )
        _, end = problem.kernel.predict(grid.inputs, start, parameters)
        effect_states[simulated] = end[:, RIGID_STATES:]
    return np.where(np.isfinite(effect_states), effect_states, 0.0)


def _segment_of_rows(record: Record, rows: Integers) -> Integers:
    """Return first row, and last row plus one, of the free segment that contains each row, shape (w, 2)."""
    segments = np.array(record.segments)
    return segments[np.searchsorted(segments[:, 0], rows, side="right") - 1]


def _angles_and_rates_by_parabola(record: Record, rows: Integers, reach_s: float) -> Floats:
    """Fit a parabola to the angles around each row, and return its value and slope there. Shapes: `rows`
    (w,); returns (w, 6).
    """
    reach = max(3, round(reach_s / record.step_s))
    segments = _segment_of_rows(record, rows)
    low, high = np.maximum(segments[:, 0], rows - reach), np.minimum(segments[:, 1], rows + reach + 1)
    angles_and_rates = np.empty((len(rows), RIGID_STATES))
    # Rows with as many samples before and after them share one least-squares problem. Only rows near the edge
    # of a segment have fewer samples on one side.
    reaches, group = np.unique(np.column_stack((low - rows, high - rows)), axis=0, return_inverse=True)
    for number, (before, after) in enumerate(reaches):
        members = np.flatnonzero(group.ravel() == number)
        # Shape (members, samples, axes), then (samples, members * axes): one parabola per column.
        samples = record.angles_rad[rows[members, None] + np.arange(before, after)]
        columns = samples.transpose(1, 0, 2).reshape(after - before, -1)
        coefficients = np.polynomial.polynomial.polyfit(np.arange(before, after) * record.step_s, columns, 2)
        # The first two coefficients are the value and the slope: shape (members, 2 * axes) in the end.
        value_and_slope = coefficients[:2].reshape(2, len(members), 3).transpose(1, 0, 2)
        angles_and_rates[members] = value_and_slope.reshape(len(members), -1)
    return angles_and_rates
