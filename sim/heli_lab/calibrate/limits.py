"""Low limits of the board while the motors are calibrated, put back afterwards."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping

from heli_host.declaration import State
from heli_host.errors import HeliError
from heli_host.heli import Heli

from heli_lab.calibrate.errors import CalibrationError


@contextlib.contextmanager
def temporary_parameters(
    heli: Heli, values: Mapping[str, float], warn: Callable[[str], None]
) -> Iterator[None]:
    """Set parameters, `values` by name, in the board's memory, and put the former values back at the end.

    At an ending of any kind the motors go off first. If the board does not take the former values then, the
    new ones stay until its restart, because they were not saved; `warn` gets a line about it.
    """
    before = {name: heli.params[name] for name in values}
    try:
        for name, value in values.items():
            heli.params[name] = value
        yield
    except BaseException:
        try:
            _off_and_back(heli, before)
        except HeliError as error:
            warn(f"warning: {error}")
        raise
    _off_and_back(heli, before)


def _off_and_back(heli: Heli, before: Mapping[str, float]) -> None:
    """Switch the motors off, and give the board the parameters that it had `before`."""
    if heli.motors_may_run:
        heli.stop()
    if heli.state is State.FAULT:
        # Parameters that only an idle board takes. A stop switch that is still pressed keeps the fault.
        with contextlib.suppress(HeliError):
            heli.clear_fault()
    refused: list[str] = []
    for name, value in before.items():
        try:
            heli.params[name] = value
        except HeliError:
            refused.append(name)
    if refused:
        raise CalibrationError(
            f"the board still has the calibration's {', '.join(refused)}",
            "restart the board: they were not saved",
        )


def pulse_limits(heli: Heli, *, max_V: float, max_angle_deg: float) -> dict[str, float]:
    """Return the parameters by which the board itself bounds the pulses.

    Parameters
    ----------
    heli : Heli
        Connected, with the arm blocked above its table.
    max_V : float
        Highest voltage of a pulse [V].
    max_angle_deg : float
        Angle by which pitch, travel and elevation may differ from level, zero and the present angle [deg].
    """
    specs = heli.params.spec
    needed = {
        "excitation_max_V": max_V,
        "arm_elevation_tolerance_deg": specs("arm_elevation_tolerance_deg").max,
        "pitch_setpoint_max_deg": min(heli.params["pitch_setpoint_max_deg"], max_angle_deg - 1.0),
        "pitch_max_deg": max_angle_deg,
        "travel_max_deg": abs(heli.latest.travel_deg) + max_angle_deg,
        "elevation_max_deg": heli.latest.elevation_deg + max_angle_deg,
    }
    return {name: min(max(value, specs(name).min), specs(name).max) for name, value in needed.items()}
