"""Laws for the page's tests: one that flies and sends its setpoint, and one that does so for a second."""

from __future__ import annotations

from typing import Any

from heli_lab.law import Command, Law, control_law, if_else, motor_volts, saturated

STATES = {"integral_V": 0.0, "flown_s": 0.0}


def _command(now: Any, state: Any, kp: Any, more_V: Any = 0.0) -> Command:
    error_rad = now.elevation_setpoint_rad - now.elevation_rad
    collective_V = 1.4 + kp * error_rad - 12.0 * now.elevation_rad_s + state.integral_V + more_V
    pitch_rad = saturated(
        0.5 * (now.travel_setpoint_rad - now.travel_rad) - 2.5 * now.travel_rad_s, -0.4, 0.4
    )
    differential_V = 5.0 * (pitch_rad - now.pitch_rad) - 1.6 * now.pitch_rad_s
    return Command(
        *motor_volts(collective_V, saturated(differential_V, -1.4, 1.4)),
        states={
            "integral_V": saturated(state.integral_V + 0.02 * error_rad, -2.0, 2.0),
            "flown_s": state.flown_s + 1e-3,
        },
        signals={"wanted_pitch": pitch_rad, "kp": kp},
        pitch_setpoint_rad=pitch_rad,
    )


def steady() -> Law:
    """A law that flies."""

    @control_law(rate_Hz=1000, name="steady", states=STATES, parameters={"kp": 16.0})
    def law(now: Any, state: Any, parameter: Any) -> Command:
        return _command(now, state, parameter.kp)

    return law


def tired() -> Law:
    """A law that wants 8 V more after a second: a jump that the board does not let through."""

    @control_law(rate_Hz=1000, name="tired", states=STATES, parameters={"kp": 16.0})
    def law(now: Any, state: Any, parameter: Any) -> Command:
        return _command(now, state, parameter.kp, if_else(state.flown_s > 1.0, 8.0, 0.0))

    return law
