"""Tables 3 to 5 from the bench tests: (30) fitted to them, coefficient by coefficient, with intervals.

Only what a table's tests can identify is fitted. With pitch locked at 0, cos phi is 1, and P_1 and P_5 are
one constant; with the motors off, P_11 moves nothing; two travel tests at constant voltages give one factor
of sin phi each, for the three unknowns P_15, P_17 and P_18.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from heli_sim.model.locked import Locked
from heli_sim.model.parts import AXES
from heli_sim.rig import Rig

from heli_lab.identify.check import check
from heli_lab.identify.fit import Fit
from heli_lab.identify.problem import Problem
from heli_lab.identify.record import Record
from heli_lab.identify.solve import solve
from heli_lab.paper.bench_tests import ELEVATION_STEPS, PITCH_RELEASES, TRAVEL_STEPS, BenchTest
from heli_lab.paper.coefficients import PRINTED, analytic
from heli_lab.paper.lumped import Coefficients, LumpedModel

# Far wider than any coefficient that a rig of this size can have: what is found comes from the tests.
_PRIOR_STD: Final = {
    **dict.fromkeys(("P_1", "P_2", "P_3", "P_7", "P_8", "P_10", "P_14", "P_15"), 20.0),
    **dict.fromkeys(("P_4", "P_9", "P_12"), 5.0),
    **dict.fromkeys(("P_6", "P_11"), 10.0),
    **dict.fromkeys(("P_13", "P_16"), 2.0),
}
WINDOW_S: Final = 4.0
"""Length of the windows that each fit predicts freely."""

TESTS_OF_TABLE: Final[Mapping[int, tuple[BenchTest, ...]]] = {
    3: PITCH_RELEASES,
    4: ELEVATION_STEPS,
    5: TRAVEL_STEPS,
}
"""The bench tests that section IV takes each table from."""


@dataclass(frozen=True)
class _Plan:
    """What is fitted for a table: free coefficients, those that they stand for, why some cannot be."""

    free: tuple[str, ...]
    absorbed: tuple[str, ...]
    offset: str
    unidentified: Mapping[str, str]
    per_test: tuple[str, ...] = ()


_PLANS: Final[Mapping[int, _Plan]] = {
    3: _Plan(
        ("P_7", "P_8", "P_9", "P_10"), (), "offset_pitch", {"P_11": "not identified: the motors are off"}
    ),
    4: _Plan(
        ("P_1", "P_2", "P_3", "P_4", "P_6"),
        ("P_5",),
        "offset_elevation",
        dict.fromkeys(("P_1", "P_5"), "identified only as P_1 + P_5: pitch is locked at 0"),
    ),
    5: _Plan(
        ("P_12", "P_13", "P_14", "P_16", "P_15", "P_8", "P_9", "P_10", "P_11"),
        ("P_7", "P_17", "P_18"),
        "offset_pitch",
        dict.fromkeys(("P_15", "P_17", "P_18"), "not identified: two tests, three unknowns"),
        ("P_15",),
    ),
}


@dataclass(frozen=True)
class TableRow:
    """A coefficient, or a sum of some, in the unit of its table.

    Parameters
    ----------
    name : str
        For example P_3, or P_1 + P_5.
    unit : str
        How the table's numbers read.
    printed, tolerance : float or None
        As printed; None for what the table does not hold.
    analytic : float
        From the rig's masses, lengths and friction, by the formulas below (30).
    estimate, half : float or None
        From the bench tests, with half its 95 % interval; None where they cannot identify it.
    note : str
        Why not, or where it comes from.
    """

    name: str
    unit: str
    printed: float | None
    tolerance: float | None
    analytic: float
    estimate: float | None
    half: float | None
    note: str = ""


@dataclass(frozen=True)
class Table:
    """One of Tables 3 to 5 beside what the bench tests give.

    Parameters
    ----------
    number : int
        3, 4 or 5.
    rows : tuple of TableRow
        Its coefficients, then what is identified instead of those that are not.
    normalised : float
        Root mean square error of (30) over windows of four seconds, free axes only, in standard deviations of
        the quantisation; 1 when nothing else is left.
    """

    number: int
    rows: tuple[TableRow, ...]
    normalised: float
    fit: Fit


def fit_table(
    number: int, rig: Rig, records: Sequence[Record], on_progress: Callable[[float], None] | None = None
) -> Table:
    """Fit (30) to the bench tests of a table.

    Parameters
    ----------
    number : int
        3, 4 or 5.
    rig : Rig
        Gives the analytic values, from which the fit starts.
    on_progress : callable, optional
        Told the share that is done.

    Raises
    ------
    IdentifyError
        When the tests cannot be fitted at all.
    """
    by_masses, plan = analytic(rig), _PLANS[number]
    start = by_masses | dict.fromkeys(plan.absorbed, 0.0)
    if number == 4:
        start["P_1"] = by_masses["P_1"] + by_masses["P_5"]
    if number == 5:
        start["P_15"] = _sine_factor(by_masses, TRAVEL_STEPS[0])
    locked = TESTS_OF_TABLE[number][0].locked
    prior_std = {name: _PRIOR_STD[name] for name in plan.free}
    problem = Problem(
        Locked(LumpedModel(Coefficients(start, prior_std)), locked),
        rig,
        records,
        free=[*plan.free, plan.offset],
        per_flight=(plan.offset, *plan.per_test),
        window_s=WINDOW_S,
    )
    fit = solve(problem, on_progress=lambda p: on_progress(p.done) if on_progress is not None else None)
    rows = [*_printed_rows(number, plan, fit, by_masses), *_extra_rows(number, fit, by_masses)]
    return Table(number, tuple(rows), free_axes_normalised(fit, locked), fit)


def free_axes_normalised(fit: Fit, locked: tuple[bool, bool, bool]) -> float:
    """Root mean square error of a fit over the axes (elevation, pitch, travel) that are not `locked`, in
    standard deviations of the quantisation.
    """
    free = [axis for axis, held in zip(AXES, locked, strict=True) if not held]
    checks = [check(fit, index) for index in range(len(fit.problem.records))]
    return math.sqrt(
        float(np.mean([check_.axis_normalised[axis] ** 2 for check_ in checks for axis in free]))
    )


def _printed_rows(number: int, plan: _Plan, fit: Fit, by_masses: Mapping[str, float]) -> list[TableRow]:
    rows = []
    for coefficient in PRINTED:
        if coefficient.table != number:
            continue
        value, half = (
            (None, None)
            if coefficient.name in plan.unidentified
            else _found(fit, coefficient.name, coefficient.per_si)
        )
        rows.append(
            TableRow(
                coefficient.name,
                coefficient.unit,
                coefficient.value,
                coefficient.tolerance,
                coefficient.per_si * by_masses[coefficient.name],
                value,
                half,
                plan.unidentified.get(coefficient.name, ""),
            )
        )
    return rows


def _extra_rows(number: int, fit: Fit, by_masses: Mapping[str, float]) -> list[TableRow]:
    printed = {coefficient.name: coefficient for coefficient in PRINTED}
    if number == 4:
        first, other = printed["P_1"], printed["P_5"]
        total = first.per_si * (by_masses["P_1"] + by_masses["P_5"])
        spread = math.hypot(first.tolerance, other.tolerance)
        value = _found(fit, "P_1", first.per_si)
        return [TableRow("P_1 + P_5", first.unit, first.value + other.value, spread, total, *value)]
    if number == 5:
        rows = [
            TableRow(
                f"sin phi at {test.front_V:g}, {test.back_V:g} V",
                "rad/s2",
                _sine_factor({name: coefficient.value for name, coefficient in printed.items()}, test),
                None,
                _sine_factor(by_masses, test),
                *_found(fit, f"P_15[{test.name}]", 1.0),
                "P_15 + P_17 U+ + P_18 U-",
            )
            for test in TRAVEL_STEPS
        ]
        first = printed["P_11"]
        note = "of Table 3; here the motors run"
        gain = _found(fit, "P_11", first.per_si)
        return [
            *rows,
            TableRow(
                "P_11",
                first.unit,
                first.value,
                first.tolerance,
                first.per_si * by_masses["P_11"],
                *gain,
                note,
            ),
        ]
    return []


def _sine_factor(values: Mapping[str, float], test: BenchTest) -> float:
    both_V, difference_V = test.front_V + test.back_V, test.front_V - test.back_V
    return values["P_15"] + values["P_17"] * both_V + values["P_18"] * difference_V


def _found(fit: Fit, name: str, per_si: float) -> tuple[float, float]:
    return per_si * fit.values[name], 2.0 * per_si * fit.std[name]
