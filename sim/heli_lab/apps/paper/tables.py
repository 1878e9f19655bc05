"""Identify the coefficients of Tables 3 to 5 by a fit of (30) to the bench tests, with intervals.

The fit of a table includes only the coefficients that its tests can identify. In Table 3, the motors are off,
so that P_11 has no effect. In Table 4, pitch is locked at 0 and cos phi is 1, so that only the sum P_1 + P_5
can be identified. In Table 5, two travel tests at constant voltages give two factors of sin phi, which do not
determine the three coefficients P_15, P_17 and P_18.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from heli_sim.model.locked import Locked
from heli_sim.model.parts import AXES
from heli_sim.rig import Rig

from heli_lab.apps.paper.bench_tests import ELEVATION_STEPS, PITCH_RELEASES, TRAVEL_STEPS, BenchTest
from heli_lab.apps.paper.coefficients import PRINTED, Printed, analytic
from heli_lab.apps.paper.lumped import Coefficients, LumpedModel
from heli_lab.fit.identify.estimation_problem import Fit, Problem
from heli_lab.fit.identify.record import Record
from heli_lab.fit.identify.results import check
from heli_lab.fit.identify.shooting import solve

_PRIOR_STD: Final = {
    **dict.fromkeys(("P_1", "P_2", "P_3", "P_7", "P_8", "P_10", "P_14", "P_15"), 20.0),
    **dict.fromkeys(("P_4", "P_9", "P_12"), 5.0),
    **dict.fromkeys(("P_6", "P_11"), 10.0),
    **dict.fromkeys(("P_13", "P_16"), 2.0),
}
"""Prior standard deviations in rad, s and V: far wider than any plausible coefficient, so that the tests
decide."""
WINDOW_S: Final = 4.0
"""Length of the open-loop windows of each fit [s]."""

TESTS_OF_TABLE: Final[Mapping[int, tuple[BenchTest, ...]]] = {
    3: PITCH_RELEASES,
    4: ELEVATION_STEPS,
    5: TRAVEL_STEPS,
}
"""Bench tests of section IV, by the table that they identify."""


@dataclass(frozen=True)
class _FitPlan:
    """Coefficients of (30) in the fit of a table."""

    free: tuple[str, ...]  # Estimated coefficients
    absorbed: tuple[str, ...]
    """Coefficients that are set to 0, because a free coefficient contains their terms in these tests."""
    offset: str  # Angle zero that is also estimated
    unidentified: Mapping[str, str]  # Reasons why coefficients of the table have no estimate, by name
    per_test: tuple[str, ...] = ()  # Coefficients with one value per test


_PLANS: Final[Mapping[int, _FitPlan]] = {
    3: _FitPlan(
        ("P_7", "P_8", "P_9", "P_10"), (), "offset_pitch", {"P_11": "not identified: the motors are off"}
    ),
    4: _FitPlan(
        ("P_1", "P_2", "P_3", "P_4", "P_6"),
        ("P_5",),
        "offset_elevation",
        dict.fromkeys(("P_1", "P_5"), "identified only as P_1 + P_5: pitch is locked at 0"),
    ),
    5: _FitPlan(
        ("P_12", "P_13", "P_14", "P_16", "P_15", "P_8", "P_9", "P_10", "P_11"),
        ("P_7", "P_17", "P_18"),
        "offset_pitch",
        dict.fromkeys(("P_15", "P_17", "P_18"), "not identified: two tests, three unknowns"),
        ("P_15",),
    ),
}


@dataclass(frozen=True)
class TableRow:
    """Coefficient, or sum of coefficients, in the unit of its table."""

    name: str  # Name, such as P_3, or P_1 + P_5
    unit: str  # Unit of all values
    printed: float | None
    """printed, tolerance: Printed value and tolerance; None if the table does not contain it."""
    tolerance: float | None
    analytic: float  # Value from the rig's masses, lengths and friction, by the formulas below (30)
    estimate: float | None
    """estimate, half: Estimate from the bench tests and half its 95 % interval; None if the tests do not
    identify it."""
    half: float | None
    note: str = ""  # Reason why it is not identified, or the source of the estimate


@dataclass(frozen=True)
class Table:
    """One of Tables 3 to 5 with the estimates from the bench tests."""

    number: int  # Number of the table: 3, 4 or 5
    rows: tuple[TableRow, ...]  # Coefficients of the table, then identifiable combinations of the others
    normalised: float
    """RMS error of (30) over windows of 4 s, over the free axes, in standard deviations of the quantisation;
    1 is the smallest possible value."""
    fit: Fit  # The fit of the coefficients


def fit_table(
    number: int, rig: Rig, records: Sequence[Record], on_progress: Callable[[float], None] | None = None
) -> Table:
    """Fit (30) to the bench tests of a table."""
    from_masses, plan = analytic(rig), _PLANS[number]
    # A coefficient that contains the terms of absorbed ones starts at their sum.
    start = from_masses | dict.fromkeys(plan.absorbed, 0.0)
    if number == 4:
        start["P_1"] = from_masses["P_1"] + from_masses["P_5"]
    if number == 5:
        start["P_15"] = _sine_factor(from_masses, TRAVEL_STEPS[0])
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
    rows = tuple(_table_rows(number, fit, from_masses))
    return Table(number, rows, free_axes_normalised(fit, locked), fit)


def free_axes_normalised(fit: Fit, locked: tuple[bool, bool, bool]) -> float:
    """Return the RMS error of a fit over the free axes, in standard deviations of the quantisation."""
    free_axes = [axis for axis, is_locked in zip(AXES, locked, strict=True) if not is_locked]
    flights = [check(fit, index) for index in range(len(fit.problem.records))]
    squares = [flight.axis_normalised[axis] ** 2 for flight in flights for axis in free_axes]
    return math.sqrt(float(np.mean(squares)))


def _table_rows(number: int, fit: Fit, from_masses: Mapping[str, float]) -> list[TableRow]:
    """Make the rows of a table: first the coefficients that the paper prints, then the combinations that the
    tests identify. Table 5 also has P_11 of Table 3, because its tests identify it.
    """
    unidentified = _PLANS[number].unidentified
    rows = [
        _coefficient_row(printed, None if printed.name in unidentified else fit, from_masses)
        for printed in PRINTED
        if printed.table == number
    ]
    rows = [replace(row, note=unidentified.get(row.name, "")) for row in rows]
    if number == 4:
        rows.append(_elevation_constant_row(fit, from_masses))
    if number == 5:
        rows += [_sine_factor_row(test, fit, from_masses) for test in TRAVEL_STEPS]
        p_11 = _coefficient_row(_PRINTED_BY_NAME["P_11"], fit, from_masses)
        rows.append(replace(p_11, note="of Table 3; here the motors run"))
    return rows


def _coefficient_row(printed: Printed, fit: Fit | None, from_masses: Mapping[str, float]) -> TableRow:
    """Return the row of a coefficient; without a fit, the row has no estimate."""
    estimate, half = (
        (None, None) if fit is None else _estimate_and_interval(fit, printed.name, printed.per_si)
    )
    return TableRow(
        printed.name,
        printed.unit,
        printed=printed.value,
        tolerance=printed.tolerance,
        analytic=printed.per_si * from_masses[printed.name],
        estimate=estimate,
        half=half,
    )


def _elevation_constant_row(fit: Fit, from_masses: Mapping[str, float]) -> TableRow:
    """Return the row of P_1 + P_5, which are indistinguishable while pitch is locked at 0."""
    p_1, p_5 = _PRINTED_BY_NAME["P_1"], _PRINTED_BY_NAME["P_5"]
    return replace(
        _coefficient_row(p_1, fit, from_masses),
        name="P_1 + P_5",
        printed=p_1.value + p_5.value,
        tolerance=math.hypot(p_1.tolerance, p_5.tolerance),
        analytic=p_1.per_si * (from_masses["P_1"] + from_masses["P_5"]),
    )


def _sine_factor_row(test: BenchTest, fit: Fit, from_masses: Mapping[str, float]) -> TableRow:
    """Return the row of the factor of sin phi at the voltages of a test."""
    printed = {name: coefficient.value for name, coefficient in _PRINTED_BY_NAME.items()}
    estimate, half = _estimate_and_interval(fit, f"P_15[{test.name}]", 1.0)
    return TableRow(
        f"sin phi at {test.front_V:g}, {test.back_V:g} V",
        "rad/s2",
        printed=_sine_factor(printed, test),
        tolerance=None,
        analytic=_sine_factor(from_masses, test),
        estimate=estimate,
        half=half,
        note="P_15 + P_17 U+ + P_18 U-",
    )


_PRINTED_BY_NAME: Final = {coefficient.name: coefficient for coefficient in PRINTED}


def _sine_factor(values: Mapping[str, float], test: BenchTest) -> float:
    """Return the factor of sin phi in (30) at the voltages of a test [rad/s2]: P_15 + P_17 U+ + P_18 U-."""
    sum_V, difference_V = test.front_V + test.back_V, test.front_V - test.back_V
    return values["P_15"] + values["P_17"] * sum_V + values["P_18"] * difference_V


def _estimate_and_interval(fit: Fit, name: str, per_si: float) -> tuple[float, float]:
    """Return an estimate and half its 95 % interval, which is two standard errors; `per_si` converts both to
    the unit of the table.
    """
    return per_si * fit.values[name], 2.0 * per_si * fit.std[name]
