"""Calibrate a rig on its bench: first the encoders, then the motors; the result is a rig file and
parameters.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

from heli_host.board.heli import Heli
from heli_host.declaration import AXES, State
from heli_host.errors import HeliError, fault_text
from heli_sim.rig import Number, Rig
from heli_sim.rig.rig import counts_per_turn
from heli_sim.rig.schema import ENCODER_DIRECTIONS

from heli_lab.errors import CalibrationError
from heli_lab.setup.calibrate.encoders import EncoderResult, angles_deg, calibrate_encoders
from heli_lab.setup.calibrate.motors import (
    MOTOR_OUTPUTS,
    MotorResult,
    PulseLimits,
    ThrustLine,
    calibrate_motor,
    geometry_share,
)
from heli_lab.setup.calibrate.operator import HandAction, Operator

_HARD_MAX_V: Final = 6.0
"""Voltage that no pulse exceeds, whatever the options say [V]."""
_MAX_ANGLE_deg: Final = 20.0
"""Default of the angle by which an axis may move in a pulse [deg]."""
_ABOVE_DEAD_ZONE_V: Final = 1.0
"""Default of the highest voltage of a pulse, above the rig file's dead zone [V]."""
_FIRST_SHARE: Final = 0.5
"""Default of the first voltage, as a share of the rig file's dead zone."""
_MIN_FIRST_V: Final = 0.2
_MIN_BLOCKED_deg: Final = 3.0
"""Smallest elevation above the table during pulses [deg]: an arm on its table brakes pitch."""
_MAX_ATTEMPTS: Final = 3
_REST_TOLERANCE_deg: Final = 1.0
"""Tolerance of the measured rest angle [deg]: a person levels the arm with a spirit level."""
_MIN_DEAD_ZONE_TOLERANCE_V: Final = 0.02
_MAX_ROTOR_DIFFERENCE: Final = 0.1
"""Relative difference between two rotors that is normal: as in docs/how-to/first-power-up.md, step 9."""
SOURCE: Final = "heli-host calibrate"
"""Beginning of the source of each number that a calibration measured."""


@dataclass(frozen=True)
class BenchCalibration:
    """Result of a calibration."""

    encoders: EncoderResult  # Directions and rest angle
    motors: tuple[MotorResult, ...]
    """Results of the front output and the back output; empty if only the encoders were calibrated."""
    rig: Rig  # The rig with the measured numbers
    parameters: Mapping[str, float]  # Parameters that the board should have
    notes: tuple[str, ...]  # Reasons why something was not measured, and changes to make by hand

    @property
    def motors_exchanged(self) -> bool:
        """Whether the front output drives the back rotor, and the back output the front rotor."""
        return any(motor.rotor != motor.output for motor in self.motors)


def default_limits(rig: Rig) -> PulseLimits:
    """Return bounds of the pulses that suit the dead zone of a rig."""
    dead_zone_V = rig["dead_zone"].value
    return PulseLimits(
        start_V=max(_MIN_FIRST_V, _FIRST_SHARE * dead_zone_V),
        max_V=min(dead_zone_V + _ABOVE_DEAD_ZONE_V, _HARD_MAX_V),
        max_angle_deg=_MAX_ANGLE_deg,
    )


def calibrate(
    heli: Heli,
    operator: Operator,
    rig: Rig,
    limits: PulseLimits | None = None,
    *,
    name: str = "",
    motors: bool = True,
    mark: Callable[[str], None] = lambda _: None,
    check: Callable[[], None] = lambda: None,
) -> BenchCalibration:
    """Calibrate encoders and motors of a connected board.

    Parameters of the board change in its memory only, and are restored at the end. Before that, the motors
    are switched off, also after an error. `mark` is called with the name of each stage. `check` is called
    again and again, and raises an error that ends the calibration. Without `limits`, those of the rig apply.
    """
    _check_idle(heli)
    _check_counts(heli, rig)
    limits = limits or default_limits(rig)
    _check_voltages(heli, limits)
    mark("encoders")
    encoders = calibrate_encoders(heli, operator)
    check()
    encoder_values = _encoder_values(heli, encoders)
    if not motors:
        return _calibration(encoders, encoder_values, (), rig, name or rig.name)
    motor_signs = {f"motor_{output}_sign": heli.params[f"motor_{output}_sign"] for output in MOTOR_OUTPUTS}
    with _temporary_parameters(heli, encoder_values | motor_signs, operator.report):
        heli.zero()
        _block_arm(heli, operator)
        results = []
        board_limits = _pulse_limits(heli, max_V=limits.max_V, max_angle_deg=limits.max_angle_deg)
        with _temporary_parameters(heli, board_limits, operator.report):
            for output in MOTOR_OUTPUTS:
                mark(f"{output} output")
                results.append(calibrate_motor(heli, operator, output, rig, limits, check))
    mark("result")
    return _calibration(encoders, encoder_values, results, rig, name or rig.name)


def set_parameters(heli: Heli, operator: Operator, values: Mapping[str, float]) -> None:
    """Set parameters on the board with the arm at rest, zero its encoders, and save."""
    operator.act(HandAction.REST)
    heli.params.restore(values)
    heli.zero()
    heli.params.save()


def _check_idle(heli: Heli) -> None:
    """Raise a CalibrationError unless the board is idle."""
    if heli.state is State.FAULT:
        raise CalibrationError(
            f"the board has a fault: {fault_text(heli.fault)}", "add --clear-fault when its cause is gone"
        )
    if heli.state is not State.IDLE:
        raise CalibrationError(f"the board is {heli.state.name.lower()}, not idle", "stop it first")


def _check_counts(heli: Heli, rig: Rig) -> None:
    """Raise a CalibrationError if board and rig have different counts per turn."""
    for axis, counts in zip(AXES, counts_per_turn(rig), strict=True):
        board_counts = abs(heli.params[f"{axis}_counts_per_rev"])
        if board_counts != counts:
            raise CalibrationError(
                f"{axis}_counts_per_rev is {board_counts:g}, but rig {rig.name} has {counts:g} counts per "
                "turn",
                "correct the wrong one with params set or rig new: counts per turn are not measured",
            )


def _check_voltages(heli: Heli, limits: PulseLimits) -> None:
    """Raise a CalibrationError unless 0 < first voltage < highest voltage <= limit of the board."""
    highest_V = min(_HARD_MAX_V, heli.params["motor_max_V"])
    if not 0.0 < limits.start_V < limits.max_V <= highest_V:
        raise CalibrationError(
            f"pulses from {limits.start_V:g} to {limits.max_V:g} V are not possible",
            f"give a --max-V above {limits.start_V:g} and up to {highest_V:g} V",
        )


def _encoder_values(heli: Heli, encoders: EncoderResult) -> dict[str, float]:
    """Return the board parameters that the encoders determine: signed counts per turn, and the rest angle
    [deg].
    """
    spec = heli.params.spec("elevation_rest_deg")
    rest_deg = round(encoders.rest_deg, 2)
    if not spec.min <= rest_deg <= spec.max:
        raise CalibrationError(
            f"the arm rests at {rest_deg:g} degrees, and the board takes {spec.min:g} to {spec.max:g}",
            "lift the arm only until it is level, and check the counts per turn of the elevation encoder",
        )
    values = {
        f"{axis}_counts_per_rev": direction * abs(heli.params[f"{axis}_counts_per_rev"])
        for axis, direction in encoders.direction.items()
    }
    return values | {"elevation_rest_deg": rest_deg}


def _block_arm(heli: Heli, operator: Operator) -> None:
    """Let the operator block the arm above its table, and check its elevation."""
    rest_deg = heli.params["elevation_rest_deg"]
    for _ in range(_MAX_ATTEMPTS):
        operator.act(HandAction.TIE)
        elevation_deg, *_ = angles_deg(heli)
        lifted_deg = elevation_deg - rest_deg
        if lifted_deg >= _MIN_BLOCKED_deg:
            return
        operator.report(
            f"the arm is {lifted_deg:.1f} degrees above its table; it needs {_MIN_BLOCKED_deg:g} or more"
        )
    raise CalibrationError(
        "the arm is still on its table", "put a block below the long arm: the table brakes the short arm"
    )


def _calibration(
    encoders: EncoderResult,
    encoder_values: Mapping[str, float],
    motors: Sequence[MotorResult],
    rig: Rig,
    name: str,
) -> BenchCalibration:
    """Assemble the calibrated rig, the board's parameters and the notes from all measurements."""
    sign_parameters, sign_notes = _motor_signs(motors)
    thrust_numbers, thrust_notes = _thrust_numbers(motors, rig)
    numbers = dict(rig) | thrust_numbers
    for axis, quantity in zip(AXES, ENCODER_DIRECTIONS, strict=True):
        numbers[quantity] = Number(float(encoders.direction[axis]), "1", 0.0, f"{SOURCE}: turned by hand")
    numbers["elevation_min"] = Number(
        encoder_values["elevation_rest_deg"], "deg", _REST_TOLERANCE_deg, f"{SOURCE}: lifted to level by hand"
    )
    parameters = dict(encoder_values) | sign_parameters
    if thrust_numbers:
        parameters["dead_zone_V"] = round(thrust_numbers["dead_zone"].value, 3)
    calibrated_rig = replace(
        rig, name=name, description=f"calibrated on the bench, the rest as {rig.name}", numbers=numbers
    )
    return BenchCalibration(
        encoders, tuple(motors), calibrated_rig, parameters, notes=(*sign_notes, *thrust_notes)
    )


def _motor_signs(motors: Sequence[MotorResult]) -> tuple[dict[str, float], list[str]]:
    """Return the signs of the motors as board parameters. Returns `parameters`, `notes`."""
    rotors = [motor.rotor for motor in motors]
    if len(set(rotors)) < len(rotors):
        raise CalibrationError(
            f"both outputs drive the {rotors[0]} rotor, as the operator saw it",
            "look at the rotors during a pulse, and calibrate again",
        )
    if any(motor.rotor != motor.output for motor in motors):
        note = (
            "the motors are exchanged: swap the plugs of the two motors, then calibrate again; their signs "
            "were not put into the parameters"
        )
        return {}, [note]
    return {f"motor_{motor.output}_sign": float(motor.sign) for motor in motors}, []


def _thrust_numbers(motors: Sequence[MotorResult], rig: Rig) -> tuple[dict[str, Number], list[str]]:
    """Return thrust gain and dead zone of the rig: the mean of both rotors. Returns `numbers`, `notes`."""
    lines = {motor.rotor: motor.thrust for motor in motors if isinstance(motor.thrust, ThrustLine)}
    notes = [
        f"thrust of the {motor.rotor} rotor is not known: {motor.thrust}; the rig's values stay"
        for motor in motors
        if isinstance(motor.thrust, str)
    ]
    if len(lines) < len(MOTOR_OUTPUTS):
        return {}, notes
    front, back = lines["front"], lines["back"]
    gain_N_per_V = 0.5 * (front.gain_N_per_V + back.gain_N_per_V)
    dead_zone_V = max(0.5 * (front.dead_zone_V + back.dead_zone_V), 0.0)
    # A tolerance is two standard errors. The mean of two rotors has half the root of the sum of squares.
    gain_tolerance = math.sqrt(front.gain_std**2 + back.gain_std**2)
    gain_tolerance = math.hypot(gain_tolerance, gain_N_per_V * geometry_share(rig))
    dead_zone_tolerance = math.sqrt(front.dead_zone_std**2 + back.dead_zone_std**2)
    dead_zone_tolerance = max(dead_zone_tolerance, _MIN_DEAD_ZONE_TOLERANCE_V)
    source = f"{SOURCE}: pitch after short pulses"
    numbers = {
        "thrust_gain": Number(gain_N_per_V, "N/V", gain_tolerance, source),
        "dead_zone": Number(dead_zone_V, "V", dead_zone_tolerance, source),
    }
    ratio = front.gain_N_per_V / back.gain_N_per_V
    if abs(ratio - 1.0) > _MAX_ROTOR_DIFFERENCE:
        notes.append(
            f"the front rotor pushes {ratio:.2f} times as much per volt as the back rotor: check the "
            "propellers, or describe it with the effect thrust_asymmetry"
        )
    return numbers, notes


@contextlib.contextmanager
def _temporary_parameters(
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
        except HeliError:  # restore the others first, then report all
            refused.append(name)
    if refused:
        raise CalibrationError(
            f"the board still has the limits of the calibration in {', '.join(refused)}",
            "restart the board to get its saved limits back",
        )


_PITCH_SETPOINT_MARGIN_deg: Final = 1.0
"""The board accepts a limit of pitch only above the limit of its setpoint."""


def _pulse_limits(heli: Heli, *, max_V: float, max_angle_deg: float) -> dict[str, float]:
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
