"""Fit the paper's Tables 2 to 5 to the bench tests, compare models on a flight, and format the results.

Tables 3 to 5 have the coefficients of (30), Table 2 the parameters of the multibody model.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from heli_host.data.flight import Flight
from heli_sim.bench import Line
from heli_sim.model import MultibodyModel
from heli_sim.model.base import Locked, Model
from heli_sim.model.effect import AXES
from heli_sim.rig import Rig

from heli_lab.apps.paper.experiments import ELEVATION_STEPS, PITCH_RELEASES, TRAVEL_STEPS, BenchTest
from heli_lab.apps.paper.lumped import (
    PRINTED,
    Coefficients,
    LumpedModel,
    Printed,
    analytic,
    printed_inertias_kg_m2,
)
from heli_lab.fit.identification import check
from heli_lab.fit.problem import NOT_FREE, Fit, Problem
from heli_lab.fit.records import Record, prepare
from heli_lab.fit.shooting import solve

if TYPE_CHECKING:
    from heli_sim.model.plant import Plant


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
        free=("P_7", "P_8", "P_9", "P_10"),
        absorbed=(),
        offset="offset_pitch",
        unidentified={"P_11": "not identified: the motors are off"},
    ),
    4: _FitPlan(
        free=("P_1", "P_2", "P_3", "P_4", "P_6"),
        absorbed=("P_5",),
        offset="offset_elevation",
        unidentified=dict.fromkeys(("P_1", "P_5"), "identified only as P_1 + P_5: pitch is locked at 0"),
    ),
    5: _FitPlan(
        free=("P_12", "P_13", "P_14", "P_16", "P_15", "P_8", "P_9", "P_10", "P_11"),
        absorbed=("P_7", "P_17", "P_18"),
        offset="offset_pitch",
        unidentified=dict.fromkeys(("P_15", "P_17", "P_18"), "not identified: two tests, three unknowns"),
        per_test=("P_15",),
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
    """Fit (30) to the bench tests of a table; `on_progress` takes the completed share."""
    from_masses, plan = analytic(rig), _PLANS[number]
    # A coefficient that contains the terms of absorbed ones starts at their sum.
    start = from_masses | dict.fromkeys(plan.absorbed, 0.0)
    if number == 4:
        # Pitch is locked at 0, where P_1 and P_5 act alike.
        start["P_1"] = from_masses["P_1"] + from_masses["P_5"]
    if number == 5:
        # Each test has constant voltages, so that P_15 stands for the whole factor of the sine of pitch.
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
    return per_si * fit.params[name], 2.0 * per_si * fit.std[name]


_IDENTIFIED: Final = 0.5
"""A parameter is identified if half its interval is below this share of its tolerance."""
_STD_PER_HALF_INTERVAL: Final = 2.0
"""Number of standard errors in half a 95 % interval."""

PRINTED_TABLE_2: Final[Mapping[str, float]] = {
    "L_h": 0.275,
    "L_a": 0.64,
    "L_b": 0.45,
    "L_phi": 0.03,
    "L_theta": 0.03,
    "L_x": 0.1,
    "M_f": 0.355,
    "M_b": 0.355,
    "M_w": 1.565,
    "M_h": 0.3678,
    "M_l": 0.68,
    "thrust_gain": 0.5839,
    "J_phi": 0.0546,
    "J_theta": 0.8496,
    "J_psi": 0.8195,
}
"""Values of Table 2; its second L_h is named L_b here."""
_IN_TABLE: Final = tuple(name for name in PRINTED_TABLE_2 if not name.startswith("J_"))
_NOT_IN_TABLE: Final = ("dead_zone", "friction_elevation", "friction_pitch", "friction_travel")
"""Parameters that the bench tests identify, and that Table 2 prints or does not print."""


@dataclass(frozen=True)
class RigRow:
    """Row of the reproduced Table 2: one parameter of the rig."""

    name: str  # name, unit: Name and unit as in the rig file
    unit: str
    printed: float | None  # Value printed in Table 2; None if the table does not contain the parameter
    value: float  # value, tolerance: Value and tolerance in the rig file
    tolerance: float
    estimate: float | None = None
    """estimate, half: Estimate from the tests that identify it best, and half its 95 % interval; None if no
    test does."""
    half: float | None = None
    note: str = ""  # Source of the estimate, or a remark on the printed value


@dataclass(frozen=True)
class RigTable:
    """Table 2 with the estimates from the bench tests."""

    rows: tuple[RigRow, ...]  # One row per parameter, then the moments of inertia
    normalised: dict[int, float]
    """RMS error of the multibody model on the tests of each of Tables 3 to 5, over the free axes, in standard
    deviations of the quantisation."""


class _ParameterEstimate(NamedTuple):
    """Estimate of a rig parameter in its unit, half its 95 % interval, and the tests behind it."""

    value: float
    half_interval: float
    source: str


def fit_rig(
    rig: Rig,
    records: Mapping[int, Sequence[Record]],
    line: Line,
    on_progress: Callable[[float], None] | None = None,
) -> RigTable:
    """Fit the multibody model to the bench tests of each table; `on_progress` takes the completed share."""
    best = {
        "thrust_gain": _ParameterEstimate(line.gain_N_per_V, line.gain_half, "Fig. 15"),
        "dead_zone": _ParameterEstimate(line.dead_zone_V, line.dead_zone_half, "Fig. 15"),
    }
    normalised = {}
    for completed, (number, tests) in enumerate(TESTS_OF_TABLE.items()):
        if on_progress is not None:
            on_progress(completed / len(TESTS_OF_TABLE))
        fit = _fit_tests(rig, tests, records[number])
        normalised[number] = free_axes_normalised(fit, tests[0].locked)
        for name, std in fit.std.items():
            half_interval = _STD_PER_HALF_INTERVAL * std
            if name in rig and (name not in best or half_interval < best[name].half_interval):
                source = f"Fig. {tests[0].figure}"
                best[name] = _ParameterEstimate(fit.params[name], half_interval, source)
    parameter_rows = [_parameter_row(name, rig, best) for name in (*_IN_TABLE, *_NOT_IN_TABLE)]
    return RigTable((*parameter_rows, *_inertia_rows(rig)), normalised)


def _fit_tests(rig: Rig, tests: Sequence[BenchTest], records: Sequence[Record]) -> Fit:
    """Fit the parameters that bench tests with the same locked axes excite."""
    model = Locked(MultibodyModel(), tests[0].locked)
    free = [
        quantity.name
        for quantity in model.parameters
        if rig[quantity.name].tolerance > 0.0
        and quantity.name not in NOT_FREE
        and _is_excited(quantity.name, tests)
    ]
    return solve(Problem(model, rig, records, free=free, window_s=WINDOW_S))


def _inertia_rows(rig: Rig) -> list[RigRow]:
    """Return the rows of J_theta, J_phi and J_psi, which (27) to (29) compute from the rig file."""
    inertia_kg_m2 = printed_inertias_kg_m2(rig)
    at_90_deg = printed_inertias_kg_m2(rig, pitch_rad=math.pi / 2)["J_theta"]
    notes = {
        "J_theta": f"(27); at most {at_90_deg:.4f}, at 90 deg of pitch",
        "J_phi": "(28)",
        "J_psi": "(29)",
    }
    return [
        RigRow(name, "kg m2", printed=PRINTED_TABLE_2[name], value=value, tolerance=0.0, note=notes[name])
        for name, value in inertia_kg_m2.items()
    ]


def _is_excited(name: str, tests: Sequence[BenchTest]) -> bool:
    """Whether bench tests show a parameter: a locked axis does not show its friction, and motors that are off
    do not show thrust gain and dead zone.
    """
    locked = dict(zip(AXES, tests[0].locked, strict=True))
    axis_locked = any(name.endswith(f"_{axis}") and is_locked for axis, is_locked in locked.items())
    motors_off = all(test.front_V == 0.0 and test.back_V == 0.0 for test in tests)
    return not axis_locked and not (motors_off and name in ("thrust_gain", "dead_zone"))


def _parameter_row(name: str, rig: Rig, estimates: Mapping[str, _ParameterEstimate]) -> RigRow:
    """Return the row of a parameter, with its estimate if the parameter is identified; see `_IDENTIFIED`."""
    parameter, estimate = rig[name], estimates.get(name)
    note = "printed as a second L_h" if name == "L_b" else ""
    row = RigRow(
        name, parameter.unit, PRINTED_TABLE_2.get(name), parameter.value, parameter.tolerance, note=note
    )
    if estimate is None or estimate.half_interval >= _IDENTIFIED * parameter.tolerance:
        return row
    notes = ", ".join(filter(None, (note, estimate.source)))
    return replace(row, estimate=estimate.value, half=estimate.half_interval, note=notes)


@dataclass(frozen=True)
class ModelError:
    """Error of open-loop simulations of a model on a flight."""

    model: str  # Name of the model
    rms_deg: dict[str, float]
    """RMS error of each axis, by its name [deg]; the initial state of each window is fitted."""
    normalised: float
    """RMS error of all axes in standard deviations of the quantisation; 1 is the smallest possible value."""


def model_errors(models: Sequence[Model], rig: Rig, flight: Flight) -> list[ModelError]:
    """Simulate a flight open loop with each model, in windows of 2 s."""
    record = prepare(flight, rig)
    errors = []
    for model in models:
        error = check(solve(Problem(model, rig, [record], free=[])))
        errors.append(ModelError(model.name, error.rms_deg, error.normalised))
    return errors


def table_lines(line: Line, by_rig: RigTable, tables: Sequence[Table]) -> list[str]:
    """Format Tables 2 to 5 for a terminal."""
    lines = [
        f"Fig. 15: F = {line.gain_N_per_V:.4f} within {line.gain_half:.4f} N/V "
        f"(V - {line.dead_zone_V:.3f} within {line.dead_zone_half:.3f} V); printed: 0.5839 (V - 1)",
        "",
        "'within': the printed tolerance, or half of an estimate's 95 % interval",
        "",
        "Table 2 (the multibody model is fitted to the bench tests)",
        f"  {'':19} {'printed':>8} {'rig file':>22} {'bench tests':>27}",
    ]
    for row in by_rig.rows:
        estimate = _estimate_text(row.estimate, row.half)
        printed = "-" if row.printed is None else f"{row.printed:g}"
        rig_file = f"{row.value:.4g} within {row.tolerance:g}" if row.tolerance else f"{row.value:.4f}"
        lines.append(
            f"  {row.name:19} {printed:>8} {rig_file:>22} {estimate:>27} {row.unit:9} {row.note}".rstrip()
        )
    for table in tables:
        multibody_error = by_rig.normalised[table.number]
        lines += [
            "",
            f"Table {table.number} (by masses: the formulas below (30), drag and P_18 corrected; "
            "bench tests: by (30))",
            f"  {'':22} {'printed':>22} {'by masses':>10} {'bench tests':>27}",
        ]
        for term in table.rows:
            tolerance = "" if term.tolerance is None else f" within {term.tolerance:.3g}"
            printed = "-" if term.printed is None else f"{term.printed:.5g}{tolerance}"
            estimate = _estimate_text(term.estimate, term.half)
            numbers = f"{printed:>22} {term.analytic:>10.4g} {estimate:>27}"
            lines.append(f"  {term.name:22} {numbers} {term.unit:14} {term.note}".rstrip())
        lines.append(
            f"  error of a 4 s prediction over the encoder's quantisation: (30) {table.normalised:.2f}, "
            f"multibody {multibody_error:.2f}"
        )
    return lines


def model_lines(model_errors: Sequence[ModelError]) -> list[str]:
    """Format the open-loop errors of the models for a terminal."""
    lines = [
        "Open-loop RMS error over 2 s, on sines of a multibody rig, with the parameters of the rig file",
        f"  {'model':14} {' '.join(f'{axis:>10}' for axis in AXES)}      over the encoder's quantisation",
    ]
    for model_error in model_errors:
        axis_errors_deg = " ".join(f"{model_error.rms_deg[axis]:>10.3f}" for axis in AXES)
        lines.append(f"  {model_error.model:14} {axis_errors_deg} deg  {model_error.normalised:.2f}")
    return lines


def tables_json(plant: Plant, line: Line, by_rig: RigTable, tables: Sequence[Table]) -> dict[str, Any]:
    """Return Tables 2 to 5 with their errors as a JSON object."""
    return {
        "rig": plant.rig.name,
        "model": plant.model.name,
        "thrust": asdict(line),
        "table_2": {"rows": [asdict(row) for row in by_rig.rows]},
        **{
            f"table_{table.number}": {
                "rows": [asdict(row) for row in table.rows],
                "normalised_residual": {
                    "lumped": table.normalised,
                    "multibody": by_rig.normalised[table.number],
                },
            }
            for table in tables
        },
    }


def _estimate_text(value: float | None, half: float | None) -> str:
    """Format an estimate with half its interval, to two significant digits of the latter; a dash if there is
    no estimate.
    """
    if value is None or half is None:
        return "-"
    digits = max(0, 1 - math.floor(math.log10(half))) if half > 0.0 else 4
    return f"{value:.{digits}f} within {half:.{digits}f}"
