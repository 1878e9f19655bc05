"""Identify the parameters of Table 2 from the bench tests with the multibody model, and compute inertias."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from heli_sim.bench.thrust_curve import Line
from heli_sim.model import MultibodyModel
from heli_sim.model.locked import Locked
from heli_sim.model.parts import AXES
from heli_sim.rig import Rig

from heli_lab.identify.fit import Fit
from heli_lab.identify.free import NOT_FREE
from heli_lab.identify.problem import Problem
from heli_lab.identify.record import Record
from heli_lab.identify.solve import solve
from heli_lab.paper.bench_tests import BenchTest
from heli_lab.paper.coefficients import printed_inertias_kg_m2
from heli_lab.paper.tables import TESTS_OF_TABLE, WINDOW_S, free_axes_normalised

_IDENTIFIED: Final = 0.5
"""A parameter is identified if half its interval is below this share of its tolerance."""

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
"""Table 2; its second L_h is named L_b here."""


@dataclass(frozen=True)
class RigRow:
    """Row of the reproduced Table 2: one parameter of the rig.

    Parameters
    ----------
    name, unit : str
        Name and unit as in the rig file.
    printed : float or None
        Value printed in Table 2; None if the table does not contain the parameter.
    value, tolerance : float
        Value and tolerance in the rig file.
    estimate, half : float or None
        Estimate from the tests that identify it best, and half its 95 % interval; None if no test does.
    note : str
        Source of the estimate, or a remark on the printed value.
    """

    name: str
    unit: str
    printed: float | None
    value: float
    tolerance: float
    estimate: float | None
    half: float | None
    note: str = ""


@dataclass(frozen=True)
class RigTable:
    """Table 2 with the estimates from the bench tests.

    Parameters
    ----------
    normalised : dict of float
        RMS error of the multibody model on the tests of each of Tables 3 to 5, over the free axes, in
        standard deviations of the quantisation.
    """

    rows: tuple[RigRow, ...]
    normalised: dict[int, float]


def fit_rig(
    rig: Rig,
    records: Mapping[int, Sequence[Record]],
    line: Line,
    on_progress: Callable[[float], None] | None = None,
) -> RigTable:
    """Fit the multibody model to the bench tests of each table.

    Each estimate is from the tests that identify the parameter best.

    Parameters
    ----------
    rig : Rig
        Prior values and tolerances.
    records : Mapping of int to sequence of Record
        Records of the tests in `TESTS_OF_TABLE`, by table.
    line : Line
        Line through the thrust curve of Fig. 15.
    on_progress : callable, optional
        Called with the completed share of the work, 0 to 1.

    Raises
    ------
    IdentifyError
        When the tests cannot be fitted.
    """
    best = {
        "thrust_gain": _Estimate(line.gain_N_per_V, line.gain_half, "Fig. 15"),
        "dead_zone": _Estimate(line.dead_zone_V, line.dead_zone_half, "Fig. 15"),
    }
    normalised = {}
    for done, (number, tests) in enumerate(TESTS_OF_TABLE.items()):
        if on_progress is not None:
            on_progress(done / len(TESTS_OF_TABLE))
        fit = _fit(rig, records[number], tests)
        normalised[number] = free_axes_normalised(fit, tests[0].locked)
        for name, std in fit.std.items():
            estimate = _Estimate(fit.values[name], 2.0 * std, f"Fig. {tests[0].panel[:2]}")
            if name in rig and (name not in best or estimate.half_width < best[name].half_width):
                best[name] = estimate
    rows = [_row(name, rig, best.get(name)) for name in (*_IN_TABLE, *_NOT_IN_TABLE)]
    return RigTable((*rows, *_inertia_rows(rig)), normalised)


@dataclass(frozen=True)
class _Estimate:
    """Estimate of a parameter from one group of tests.

    Parameters
    ----------
    value, half_width : float
        Estimate, and half its 95 % interval.
    source : str
        Figure of the tests.
    """

    value: float
    half_width: float
    source: str


def _fit(rig: Rig, records: Sequence[Record], tests: Sequence[BenchTest]) -> Fit:
    """Fit the parameters that some tests with the same locked axes excite."""
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
    """Rows of the moments of inertia, computed from the rig's masses and lengths."""
    inertia = printed_inertias_kg_m2(rig)
    at_90_deg = printed_inertias_kg_m2(rig, pitch_rad=math.pi / 2)["J_theta"]
    notes = {
        "J_theta": f"(27); at most {at_90_deg:.4f}, at 90 deg of pitch",
        "J_phi": "(28)",
        "J_psi": "(29)",
    }
    return [
        RigRow(name, "kg m2", PRINTED_TABLE_2[name], inertia[name], 0.0, None, None, notes[name])
        for name in inertia
    ]


_IN_TABLE: Final = tuple(name for name in PRINTED_TABLE_2 if not name.startswith("J_"))
_NOT_IN_TABLE: Final = ("dead_zone", "friction_elevation", "friction_pitch", "friction_travel")


def _is_excited(name: str, tests: Sequence[BenchTest]) -> bool:
    """Whether the tests excite a parameter: motors that are off have no thrust, locked axes no friction."""
    locked = dict(zip(AXES, tests[0].locked, strict=True))
    axis_locked = any(name.endswith(f"_{axis}") and is_locked for axis, is_locked in locked.items())
    motors_off = all(test.front_V == 0.0 and test.back_V == 0.0 for test in tests)
    return not axis_locked and not (motors_off and name in ("thrust_gain", "dead_zone"))


def _row(name: str, rig: Rig, estimate: _Estimate | None) -> RigRow:
    """Row of a parameter; an estimate that hardly narrows its tolerance is left out."""
    number = rig[name]
    notes = ["printed as a second L_h"] if name == "L_b" else []
    value = half = None
    if estimate is not None and estimate.half_width < _IDENTIFIED * number.tolerance:
        value, half = estimate.value, estimate.half_width
        notes.append(estimate.source)
    printed = PRINTED_TABLE_2.get(name)
    return RigRow(name, number.unit, printed, number.value, number.tolerance, value, half, ", ".join(notes))
