"""Lower the limits of the board while its motors are calibrated, and restore them afterwards."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping
from typing import Final

from heli_host.declaration import State
from heli_host.errors import HeliError
from heli_host.fly.heli import Heli

from heli_lab.setup.calibrate.errors import CalibrationError


@contextlib.contextmanager
def temporary_parameters(
    heli: Heli, values: Mapping[str, float], warn: Callable[[str], None]
) -> Iterator[None]:
    """Set parameters in the board's memory, and restore the previous values when the block ends.

    Before that, the motors are switched off, also after an error. If the board refuses a previous value, the
    new value stays until the board is restarted.
    """
    previous_values = {name: heli.params[name] for name in values}
    try:
        for name, value in values.items():
            heli.params[name] = value
        yield
    except BaseException:
        try:
            _stop_and_restore(heli, previous_values)
        except HeliError as error:
            warn(f"warning: {error}")
        raise
    _stop_and_restore(heli, previous_values)


def _stop_and_restore(heli: Heli, previous_values: Mapping[str, float]) -> None:
    """Stop the motors, clear a fault, and restore parameters."""
    if heli.motors_may_run:
        heli.stop()
    if heli.state is State.FAULT:
        # Only an idle board accepts some parameters. If the stop switch is still pressed, the fault stays.
        with contextlib.suppress(HeliError):
            heli.clear_fault()
    refused: list[str] = []
    for name, value in previous_values.items():
        try:
            heli.params[name] = value
        except HeliError:
            refused.append(name)
    if refused:
        raise CalibrationError(
            f"the board still has the limits of the calibration in {', '.join(refused)}",
            "restart the board to get its saved limits back",
        )


_PITCH_SETPOINT_MARGIN_deg: Final = 1.0
"""The board accepts a limit of pitch only above the limit of its setpoint."""


def pulse_limits(heli: Heli, *, max_V: float, max_angle_deg: float) -> dict[str, float]:
    """Return the parameters by which the board itself bounds voltage and motion of the pulses."""
    spec_of = heli.params.spec
    values = {
        "excitation_max_V": max_V,
        # The arm is blocked above its table, where the board would refuse to arm.
        "arm_elevation_tolerance_deg": spec_of("arm_elevation_tolerance_deg").max,
        "pitch_setpoint_max_deg": min(
            heli.params["pitch_setpoint_max_deg"], max_angle_deg - _PITCH_SETPOINT_MARGIN_deg
        ),
        "pitch_max_deg": max_angle_deg,
        "travel_max_deg": abs(heli.latest.travel_deg) + max_angle_deg,
        "elevation_max_deg": heli.latest.elevation_deg + max_angle_deg,
    }
    return {name: min(max(value, spec_of(name).min), spec_of(name).max) for name, value in values.items()}
