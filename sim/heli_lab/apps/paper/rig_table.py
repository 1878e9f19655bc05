"""Identify the parameters of Table 2 from the bench tests with the multibody model, and compute inertias."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

from heli_sim.bench.thrust_curve import Line
from heli_sim.model import MultibodyModel
from heli_sim.model.locked import Locked
from heli_sim.model.parts import AXES
from heli_sim.rig import Rig

from heli_lab.apps.paper.bench_tests import BenchTest
from heli_lab.apps.paper.coefficients import printed_inertias_kg_m2
from heli_lab.apps.paper.tables import TESTS_OF_TABLE, WINDOW_S, free_axes_normalised
from heli_lab.fit.identify.estimation_problem import Fit, Problem
from heli_lab.fit.identify.free import NOT_FREE
from heli_lab.fit.identify.record import Record
from heli_lab.fit.identify.shooting import solve

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
    """Fit the multibody model to the bench tests of each table.

    Each estimate is from the tests that identify the parameter best.
    """
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
                source = f"Fig. {tests[0].panel[:2]}"
                best[name] = _ParameterEstimate(fit.values[name], half_interval, source)
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
