"""Table 2 from the bench tests, by the multibody model, and the inertias that its masses give."""

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

from heli_lab.identify.free import NOT_FREE
from heli_lab.identify.problem import Problem
from heli_lab.identify.record import Record
from heli_lab.identify.solve import solve
from heli_lab.paper.bench_tests import BenchTest
from heli_lab.paper.coefficients import printed_inertias_kg_m2
from heli_lab.paper.tables import TESTS_OF_TABLE, WINDOW_S, free_axes_normalised

_IDENTIFIED: Final = 0.5
"""A number counts as identified when the tests leave less than this share of its tolerance."""

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
"""Table 2, its second L_h under the name L_b."""


@dataclass(frozen=True)
class RigRow:
    """A number of the rig.

    Parameters
    ----------
    name, unit : str
        As in the rig file.
    printed : float or None
        As Table 2 prints it; None for what it does not hold.
    value, tolerance : float
        What the rig file says.
    estimate, half : float or None
        From the tests that identify it best, with half its 95 % interval; None when none does.
    note : str
        Which tests, or what the number should be.
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
    """Table 2 beside what the bench tests give; `normalised` is the root mean square error of the multibody
    model on the tests of Tables 3 to 5, free axes only, in standard deviations of the quantisation.
    """

    rows: tuple[RigRow, ...]
    normalised: dict[int, float]


def fit_rig(
    rig: Rig,
    records: Mapping[int, Sequence[Record]],
    line: Line,
    on_progress: Callable[[float], None] | None = None,
) -> RigTable:
    """Fit the multibody model's numbers to each table's bench tests; each number is from the tests that
    identify it best.

    Parameters
    ----------
    rig : Rig
        Values and tolerances before the tests.
    records : Mapping of int to sequence of Record
        The tests of each of `TESTS_OF_TABLE`.
    on_progress : callable, optional
        Told the share that is done.

    Raises
    ------
    IdentifyError
        When the tests cannot be fitted at all.
    """
    best: dict[str, tuple[float, float, str]] = {
        "thrust_gain": (line.gain_N_per_V, line.gain_half, "Fig. 15"),
        "dead_zone": (line.dead_zone_V, line.dead_zone_half, "Fig. 15"),
    }
    normalised = {}
    for done, (number, tests) in enumerate(TESTS_OF_TABLE.items()):
        if on_progress is not None:
            on_progress(done / len(TESTS_OF_TABLE))
        model = Locked(MultibodyModel(), tests[0].locked)
        free = [
            q.name
            for q in model.parameters
            if rig[q.name].tolerance > 0.0 and q.name not in NOT_FREE and _may_show(q.name, tests)
        ]
        problem = Problem(model, rig, records[number], free=free, window_s=WINDOW_S)
        fit = solve(problem)
        normalised[number] = free_axes_normalised(fit, tests[0].locked)
        for name, std in fit.std.items():
            if name in rig and (name not in best or 2.0 * std < best[name][1]):
                best[name] = fit.values[name], 2.0 * std, f"Fig. {tests[0].panel[:2]}"
    rows = [_row(name, rig, best) for name in (*_IN_TABLE, *_BESIDE)]
    inertia = printed_inertias_kg_m2(rig)
    upright = printed_inertias_kg_m2(rig, pitch_rad=math.pi / 2)["J_theta"]
    notes = {"J_theta": f"(27); at most {upright:.4f}, at 90 deg of pitch", "J_phi": "(28)", "J_psi": "(29)"}
    rows += [
        RigRow(name, "kg m2", PRINTED_TABLE_2[name], inertia[name], 0.0, None, None, notes[name])
        for name in inertia
    ]
    return RigTable(tuple(rows), normalised)


_IN_TABLE: Final = tuple(name for name in PRINTED_TABLE_2 if not name.startswith("J_"))
_BESIDE: Final = ("dead_zone", "friction_elevation", "friction_pitch", "friction_travel")


def _may_show(name: str, tests: Sequence[BenchTest]) -> bool:
    """Whether a number can matter at all: motors that are off have no thrust, locked axes no friction."""
    locked = dict(zip(AXES, tests[0].locked, strict=True))
    held = any(name.endswith(f"_{axis}") and on for axis, on in locked.items())
    off = all(test.front_V == 0.0 and test.back_V == 0.0 for test in tests)
    return not held and not (off and name in ("thrust_gain", "dead_zone"))


def _row(name: str, rig: Rig, best: Mapping[str, tuple[float, float, str]]) -> RigRow:
    number = rig[name]
    note = "printed as a second L_h" if name == "L_b" else ""
    if name in best and best[name][1] < _IDENTIFIED * number.tolerance:
        value, half, source = best[name]
        text = ", ".join(filter(None, (note, source)))
        return RigRow(
            name, number.unit, PRINTED_TABLE_2.get(name), number.value, number.tolerance, value, half, text
        )
    return RigRow(
        name, number.unit, PRINTED_TABLE_2.get(name), number.value, number.tolerance, None, None, note
    )
