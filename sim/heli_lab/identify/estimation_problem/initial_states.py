"""First guesses of the windows' initial states, from the angles around their beginnings."""

from __future__ import annotations

from typing import Final

import numpy as np
from heli_host.arrays import Floats, Integers
from heli_sim.model.parts import AXES

from heli_lab.identify.estimation_problem.grid import make_grid
from heli_lab.identify.estimation_problem.problem import Problem
from heli_lab.identify.record import Record
from heli_lab.identify.thresholds import SETTLED_S, SHORT_FIT_S, STATE_FIT_S

_MECHANICAL: Final = 6
"""Three angles and their rates; the states of effects follow."""


def initial_state_guess(problem: Problem, theta: Floats) -> list[Floats]:
    """Initial states of all windows with free parameters `theta`, shape (f,), as the angles around their
    beginnings suggest: shape (w, states) for each record, see `states_at`.
    """
    return [
        states_at(problem, index, _beginnings(problem, index, theta), theta)
        for index in range(len(problem.records))
    ]


def states_at(problem: Problem, index: int, rows: Integers, theta: Floats) -> Floats:
    """States at given rows, shape (w, states).

    Angles and rates are those of parabolas through the samples around each row. States of effects are those
    after a free run that ends there, or the measured angle if the state is an angle that an encoder measures.

    Parameters
    ----------
    index : int
        Which record.
    rows : ndarray of int64 (w,)
        Samples of the record at which windows begin.
    theta : ndarray (f,)
        Free parameters.
    """
    record = problem.records[index]
    states = np.zeros((len(rows), problem.state_count))
    states[:, :_MECHANICAL] = _parabolas(record, rows, STATE_FIT_S)
    if problem.state_count == _MECHANICAL:
        return states
    states[:, _MECHANICAL:] = _after_run_in(problem, index, rows, states, theta)
    measured = {state: axis for effect in problem.model.effects for state, axis in effect.measured_as.items()}
    for place, state in enumerate(problem.model.states):
        if state.name in measured:
            states[:, place] = record.angles_rad[rows, AXES.index(measured[state.name])]
    return states


def alternative_states(problem: Problem, index: int, theta: Floats, states: Floats) -> list[Floats]:
    """Other initial states of a record's windows, each of shape (w, states), for windows whose present state
    is in a wrong basin of attraction.

    The first alternative is the end of the window before, if no time lies between the two windows: friction
    and backlash depend on how the arm came there. The second has rates from a few samples only, which a jump
    of the torque nearby does not bend. The others are the alternatives that effects give.

    Parameters
    ----------
    index : int
        Which record.
    theta : ndarray (f,)
        Free parameters.
    states : ndarray (w, states)
        Initial states.
    """
    record, windows = problem.records[index], problem.windows(index)
    grid = problem.grid(index, False, theta)
    parameters = problem.parameters(theta, index)
    ends = problem.kernel.end(grid.inputs, states, parameters)
    before, warm_start = states.copy(), states.copy()
    warm_start[:, :_MECHANICAL] = _parabolas(record, np.array([first for first, _ in windows]), SHORT_FIT_S)
    for number, (first, _) in enumerate(windows):
        if number and sum(windows[number - 1]) == first and np.isfinite(ends[number - 1]).all():
            before[number] = ends[number - 1]
    places = {state.name: place for place, state in enumerate(problem.model.states)}
    values = dict(zip((parameter.name for parameter in problem.model.parameters), parameters, strict=True))
    shifted = []
    for effect in problem.model.effects:
        for offsets in effect.alternative_starts(values):
            other = states_at(problem, index, _beginnings(problem, index, theta), theta)
            for name, offset in offsets.items():
                other[:, places[name]] += offset
            shifted.append(other)
    return [before, warm_start, *shifted]


def _beginnings(problem: Problem, index: int, theta: Floats) -> Integers:
    grid = problem.grid(index, False, theta)
    return grid.rows[grid.inputs.first]


def _after_run_in(problem: Problem, index: int, rows: Integers, states: Floats, theta: Floats) -> Floats:
    """States of effects after a free run that ends at each row, shape (w, states - 6).

    Voltages count from before the free segment too: there the arm may stand on its table, but the rotors that
    they drive are the same. Such a run starts with the angles of its end.
    """
    record, parameters = problem.records[index], problem.parameters(theta, index)
    effect_states = np.zeros((len(rows), problem.state_count - _MECHANICAL))
    begun = np.array([0, *(gap + 1 for gap in record.gaps)])
    first = begun[np.searchsorted(begun, rows, side="right") - 1]
    back = np.minimum(rows - first, round(SETTLED_S / record.step_s))
    some = np.flatnonzero(back > 0)
    if len(some):
        begun_at = rows[some] - back[some]
        windows = list(zip(begun_at.tolist(), back[some].tolist(), strict=True))
        grid = make_grid(record, windows, 1, delay=problem.input_shape(parameters)[0])
        start = states[some].copy()
        start[:, _MECHANICAL:] = 0.0
        free = begun_at >= _segments_of(record, rows[some])[:, 0]
        start[free, :_MECHANICAL] = _parabolas(record, begun_at[free], STATE_FIT_S)
        effect_states[some] = problem.kernel.end(grid.inputs, start, parameters)[:, _MECHANICAL:]
    return np.where(np.isfinite(effect_states), effect_states, 0.0)


def _segments_of(record: Record, rows: Integers) -> Integers:
    """First row, and last row plus one, of the free segments that `rows` lie in, shape (w, 2)."""
    segments = np.array(record.segments)
    starts: Integers = segments[np.searchsorted(segments[:, 0], rows, side="right") - 1]
    return starts


def _parabolas(record: Record, rows: Integers, reach_s: float) -> Floats:
    """Angles and rates at `rows`, from the samples around each in the same segment, shape (w, 6)."""
    reach = max(3, round(reach_s / record.step_s))
    segments = _segments_of(record, rows)
    low, high = np.maximum(segments[:, 0], rows - reach), np.minimum(segments[:, 1], rows + reach + 1)
    result = np.empty((len(rows), _MECHANICAL))
    # All but the rows near a segment's edge see the same times.
    shapes, which = np.unique(np.column_stack((low - rows, high - rows)), axis=0, return_inverse=True)
    for number, (before, after) in enumerate(shapes):
        here = np.flatnonzero(which.ravel() == number)
        samples = record.angles_rad[rows[here, None] + np.arange(before, after)]
        seen = samples.transpose(1, 0, 2).reshape(after - before, -1)
        fit = np.polynomial.polynomial.polyfit(np.arange(before, after) * record.step_s, seen, 2)
        result[here] = fit[:2].reshape(2, len(here), 3).transpose(1, 0, 2).reshape(len(here), -1)
    return result
