"""Hidden effects in the parameters of the catalogue, under the names that a diagnosis uses."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from heli_benchmark.cases.clean import Case

ParameterValues = Mapping[str, float]


@dataclass(frozen=True)
class TrueEffect:
    """A hidden effect in the catalogue's parameters."""

    id: str  # The effect
    start: ParameterValues  # Its known parameters by full name, to start a fit from
    scalars: ParameterValues
    """Parameters that the catalogue defines as the generator does: an estimate must agree with them."""
    amplitudes: Mapping[tuple[str, str], float] = field(default_factory=dict)
    """The same for amplitudes of pairs of parameters."""


def hidden_in(case: Case, motors_on_s: float) -> tuple[TrueEffect, ...]:
    """Translate the hidden effects of a case to the catalogue."""
    return tuple(translated(id_, numbers, motors_on_s) for id_, numbers in case.truth().items())


def translated(id_: str, of: ParameterValues, motors_on_s: float) -> TrueEffect:
    """Translate one effect."""
    kind, _, _ = id_.partition(".")
    prefix = id_.replace(".", "_")
    scalars = _SAME[kind](of) if kind in _SAME else {}
    if "at_s" in of:
        scalars |= {"at_s": of["at_s"] + motors_on_s}
    start = {f"{prefix}_{what}": value for what, value in scalars.items()}
    amplitudes: dict[tuple[str, str], float] = {}
    more: dict[str, float] = {}
    if kind == "inflow_damping":
        # A loss in N per m/s, independent of the thrust, in still air.
        scalars = {"s_per_m": of["size"]}
        more = {**scalars, "loaded": 0.0, "still": 1.0}
    elif kind == "ground_effect":
        # The generator uses the height of the end of the arm, independent of pitch.
        more = {"own": 0.0}
    elif kind == "rotor_reaction_torque":
        more = {"front_m": of["size"], "back_m": of["size"] * of["back_turns"]}
        start = {}
        scalars = more
    elif kind == "axis_tilt":
        lean = math.tan(math.radians(of["size"]))
        more = {"x_rad": -lean * math.cos(of["towards_rad"]), "y_rad": -lean * math.sin(of["towards_rad"])}
        scalars = more
    elif kind == "encoder_eccentricity":
        size_rad = math.radians(of["size"])
        more = {
            "sin_rad": size_rad * math.cos(of["phase_rad"]),
            "cos_rad": size_rad * math.sin(of["phase_rad"]),
            "order": of["order"],
        }
        amplitudes = {(f"{prefix}_sin_rad", f"{prefix}_cos_rad"): size_rad}
    elif kind == "periodic_torque":
        # Its phase is unknown: from a wrong phase a fit moves to another frequency.
        more = {"sin_Nm": 0.05 * of["size"]}
        amplitudes = {(f"{prefix}_sin_Nm", f"{prefix}_cos_Nm"): of["size"]}
    start |= {f"{prefix}_{what}": value for what, value in more.items()}
    return TrueEffect(id_, start, {f"{prefix}_{what}": value for what, value in scalars.items()}, amplitudes)


def _ground_effect_parameters(of: ParameterValues) -> dict[str, float]:
    # The table of the generator is at the end of the arm at -25 degrees. That of the catalogue is 0.25 m
    # below the axis, and the rotors are L_theta below the arm.
    lower_m = 0.64 * math.sin(math.radians(25.0)) - 0.25 + 0.03
    return {"share": of["size"] * math.exp(-lower_m / 0.15), "height_m": 0.15}


_SAME: Mapping[str, Callable[[ParameterValues], dict[str, float]]] = {
    "rotor_lag": lambda of: {"s": of["size"]},
    "input_delay": lambda of: {"s": of["size"]},
    # k e (1 + c e) = k (1 + c) e (1 + q (e - 1)) with q = c / (1 + c).
    "thrust_quadratic": lambda of: {"share": of["size"] / (1.0 + of["size"])},
    "thrust_asymmetry": lambda of: {"share": of["size"]},
    "thrust_fade": lambda of: {"per_s": of["size"] / 60.0},
    "thrust_step": lambda of: {"share": of["size"]},
    "supply_sag": lambda of: {"per_V": of["size"] / 2.0},
    "ground_effect": _ground_effect_parameters,
    "coulomb_friction": lambda of: {"Nm": of["size"]},
    **dict.fromkeys(
        ("pitch_drag_quadratic", "travel_drag_quadratic"),
        lambda of: {"Nms2": of["size"]},
    ),
    "rotor_speed_lag": lambda of: {"s": of["size"]},
    "flywheel": lambda of: {"Nms_per_V": of["size"]},
    "supply_fade": lambda of: {"per_s": of["size"] / 60.0},
    "cable_spring": lambda of: {"Nm_per_rad": of["size"], "rest_rad": of["rest_rad"]},
    "counterweight_shift": lambda of: {"m": of["size"]},
    "backlash": lambda of: {"rad": math.radians(of["size"])},
    # If the arm starts too high, the board measures too low an angle.
    "zero_offset": lambda of: {"rad": -math.radians(of["size"])},
    "periodic_torque": lambda of: {"Hz": of["frequency_Hz"]},
    "random_torque": lambda of: {"Nm": of["size"], "s": of["lasts_s"]},
    "edgewise_flow": lambda of: {"s_per_m": of["size"]},
    "gyroscopic_torque": lambda of: {"m_s": of["size"]},
    "removed": lambda of: {"share": of["size"]},
}
