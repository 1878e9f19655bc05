"""First guesses of the windows' initial states, from the angles around their beginnings."""

from __future__ import annotations

from typing import Final

import numpy as np
from heli_sim.model.parts import AXES

from heli_lab.identify.functions import Floats, Integers
from heli_lab.identify.grid import make_grid
from heli_lab.identify.problem import Problem
from heli_lab.identify.record import Record
from heli_lab.identify.thresholds import RUN_IN_S, SHORT_FIT_S, STATE_FIT_S

_MECHANICAL: Final = 6
"""Three angles and their rates; the states of effects follow."""


def first_states(problem: Problem, theta: Floats) -> list[Floats]:
    """Initial states of all windows with free parameters `theta`, shape (f,), as the angles around their
    beginnings suggest: shape (w, states) for each record, see `states_at`.
    """
    return [
        states_at(problem, index, _beginnings(problem, index, theta), theta)
        for index in range(len(problem.records))
    ]


def states_at(problem: Problem, index: int, rows: Integers, theta: Floats) -> Floats:
    """States at given rows, shape (w, states): angles and rates of parabolas through the samples around each
    row; states of effects after a free run that ends there, or the measured angle where that is what they
    are.

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
    states[:, :_MECHANICAL] = [_parabola(record, int(row), STATE_FIT_S) for row in rows]
    if problem.state_count == _MECHANICAL:
        return states
    states[:, _MECHANICAL:] = _after_run_in(problem, index, rows, states, theta)
    measured = {state: axis for effect in problem.model.effects for state, axis in effect.measured_as.items()}
    for place, state in enumerate(problem.model.states):
        if state.name in measured:
            states[:, place] = record.angles_rad[rows, AXES.index(measured[state.name])]
    return states


def alternative_states(problem: Problem, index: int, theta: Floats, states: Floats) -> list[Floats]:
    """Other initial states of a record's windows, each of shape (w, states), for those whose own lie in a
    wrong basin of attraction. Where the window before ends, as long as nothing lies between: friction and
    backlash remember how the arm came there. Then rates of a few samples alone, which no jump of the torque
    nearby bends. Then the alternatives that effects know.

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
    before, near = states.copy(), states.copy()
    for number, (first, _) in enumerate(windows):
        if number and sum(windows[number - 1]) == first and np.isfinite(ends[number - 1]).all():
            before[number] = ends[number - 1]
        near[number, :_MECHANICAL] = _parabola(record, first, SHORT_FIT_S)
    places = {state.name: place for place, state in enumerate(problem.model.states)}
    values = dict(zip((one.name for one in problem.model.parameters), parameters, strict=True))
    shifted = []
    for effect in problem.model.effects:
        for offsets in effect.alternative_starts(values):
            other = states_at(problem, index, _beginnings(problem, index, theta), theta)
            for name, offset in offsets.items():
                other[:, places[name]] += offset
            shifted.append(other)
    return [before, near, *shifted]


def _beginnings(problem: Problem, index: int, theta: Floats) -> Integers:
    grid = problem.grid(index, False, theta)
    return grid.rows[grid.inputs.first]


def _after_run_in(problem: Problem, index: int, rows: Integers, states: Floats, theta: Floats) -> Floats:
    """States of effects after a free run that ends at each row, shape (w, states - 6).

    Voltages count from before the free segment too: there the arm may stand on its table, but the rotors that
    they drive are the same. Such a run starts with the angles of its end.
    """
    record, parameters = problem.records[index], problem.parameters(theta, index)
    found = np.zeros((len(rows), problem.state_count - _MECHANICAL))
    begun = np.array([0, *(gap + 1 for gap in record.gaps)])
    first = begun[np.searchsorted(begun, rows, side="right") - 1]
    back = np.minimum(rows - first, round(RUN_IN_S / record.step_s))
    some = np.flatnonzero(back > 0)
    if len(some):
        windows = [(int(rows[i] - back[i]), int(back[i])) for i in some]
        grid = make_grid(record, windows, 1, delay=problem.input_shape(parameters)[0])
        start = np.zeros((len(some), problem.state_count))
        for number, i in enumerate(some):
            free_from = next(low for low, high in record.segments if low <= rows[i] < high)
            begin = windows[number][0]
            start[number, :_MECHANICAL] = (
                _parabola(record, begin, STATE_FIT_S) if begin >= free_from else states[i, :_MECHANICAL]
            )
        found[some] = problem.kernel.end(grid.inputs, start, parameters)[:, _MECHANICAL:]
    return np.where(np.isfinite(found), found, 0.0)


def _parabola(record: Record, row: int, reach_s: float) -> Floats:
    """Angles and rates at a row, from the samples around it in the same segment."""
    start, stop = next(segment for segment in record.segments if segment[0] <= row < segment[1])
    reach = max(3, round(reach_s / record.step_s))
    low, high = max(start, row - reach), min(stop, row + reach + 1)
    time_s = (np.arange(low, high) - row) * record.step_s
    fit: Floats = np.polynomial.polynomial.polyfit(time_s, record.angles_rad[low:high], 2)
    result: Floats = np.concatenate((fit[0], fit[1]))
    return result
