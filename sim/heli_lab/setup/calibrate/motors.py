"""Calibrate a motor output with voltage pulses.

The pulses show which rotor the output drives, and that rotor's direction, dead zone and thrust.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple

import numpy as np
import scipy.optimize
from heli_host.board.heli import Heli
from heli_host.board.samples import Samples
from heli_host.data.arrays import Floats
from heli_host.declaration import AXES, Axes, Excitation, Fault, State
from heli_host.errors import CommandRefused, FlightAborted, HeliError, fault_text
from heli_host.link.clock import TICK_S
from heli_sim.rig import Rig
from heli_sim.rig.schema import inertias_kg_m2

from heli_lab.errors import CalibrationError
from heli_lab.setup.calibrate.encoders import angles_deg, sample_angles_deg
from heli_lab.setup.calibrate.operator import HandAction, Operator
from heli_lab.state_space import matrix_exponentials

MOTOR_OUTPUTS: Final = ("front", "back")
_STEP_V: Final = 0.1
"""Increase of the voltage from pulse to pulse before pitch has moved [V]. More: the first pulse above the
dead zone turns a strong rotor too far. Less: more pulses are needed, each with a confirmation."""
_MIN_STEP_V: Final = 0.02
_MOVING_PULSES: Final = 8
"""Number of pulses that move pitch, after which a series ends."""
_MOVED_counts: Final = 4.0
"""Change of pitch that counts as a movement. Less: a swing that is still decaying counts. More: the estimated
dead zone is too high."""
_MOVED_STDS: Final = 4.0
"""The same in standard errors of the change; the larger one of both applies."""
_MAX_ANGLE_SHARE: Final = 0.5
"""Share of the largest angle at which the voltage is not increased any more."""
_STILL_counts: Final = 3.0
_STILL_s: Final = 1.0
"""Time over which pitch must be still [s]. Shorter: the turning point of a slow swing counts as still."""
_STILL_TIMEOUT_s: Final = 5.0
_SMOOTH_counts: Final = 1.5
"""Largest distance of a drifting pitch from a parabola. More: a hand or a draught looks like a drift. Less:
the rounding of the encoder does not."""
_MAX_DRIFT_SHARE: Final = 0.25
"""Share of the largest angle within which pitch must stay by its drift alone until the pulse has ended. More:
a pulse has too little room."""
_POLL_s: Final = 0.02
_MAX_ATTEMPTS: Final = 3
_MAX_ARM_ATTEMPTS: Final = 20
_ARM_RETRY_s: Final = 0.05


@dataclass(frozen=True)
class PulseLimits:
    """Bounds of the pulses."""

    start_V: float  # start_V, max_V: First and highest voltage of the pulses [V]
    max_V: float
    max_angle_deg: float
    """Angle by which an axis may move in a pulse [deg]. Beyond it, the motors are switched off and the
    calibration ends."""


@dataclass(frozen=True)
class MotorResult:
    """Rotor, direction, dead zone and thrust of one output, measured by pulses."""

    output: str  # ``front`` or ``back``
    rotor: str  # Rotor that the output drives
    sign: int  # Value of the board's sign parameter, 1 or -1, with which a positive voltage lifts this rotor
    begins_V: float  # Lowest voltage at which pitch moved [V]
    thrust: ThrustLine | str  # Line of thrust over voltage, or the reason why there is none


@dataclass
class _Series:
    """Result of pulses of rising voltage at one output, with one sign of the voltage."""

    pulses: list[Pulse] = field(default_factory=list)  # Pulses that moved pitch
    rotor: str = ""  # Rotor that turned, ``front`` or ``back``; empty before the first movement
    turn: int = 0  # Sign of the pitch change, 1 or -1
    begins_V: float = 0.0  # Lowest voltage at which pitch moved [V]


class _Peak(NamedTuple):
    """Largest change of pitch after a pulse, and the voltage of the pulse."""

    volts_V: float
    deg: float


def calibrate_motor(
    heli: Heli, operator: Operator, output: str, rig: Rig, limits: PulseLimits, check: Callable[[], None]
) -> MotorResult:
    """Drive one output with pulses until its rotor, direction, dead zone and thrust are known.

    If the rotor pushes down or does not move pitch, the pulses are repeated with the opposite sign. The
    board's sign parameter has its first value again when the function returns.
    """
    sign_parameter = f"motor_{output}_sign"
    first_sign = int(heli.params[sign_parameter])
    pulser = _Pulser(heli, operator, output, rig, limits, check)
    for sign in (first_sign, -first_sign):
        heli.params[sign_parameter] = sign
        series = pulser.series(limits.start_V)
        if series.pulses and series.turn == _lift_turn(series.rotor):
            heli.params[sign_parameter] = first_sign
            thrust = thrust_of(series.pulses, _lift_turn(series.rotor), rig)
            return MotorResult(output, series.rotor, sign, series.begins_V, thrust)
        reason = f"the {series.rotor} rotor pushes down" if series.pulses else "no pulse moved pitch"
        operator.report(f"{output} output with {sign_parameter} {sign}: {reason}")
    heli.params[sign_parameter] = first_sign
    raise CalibrationError(
        f"the {output} output lifts no rotor up to {limits.max_V:g} V, with either sign",
        "check supply, driver and plug of that motor, and its propeller, or raise --max-V",
    )


def _lift_turn(rotor: str) -> int:
    """Return the sign of the pitch that a `rotor`, ``front`` or ``back``, causes when it pushes up."""
    return 1 if rotor == "front" else -1


class _Pulser:
    """Gives voltage pulses to one output, and checks state and angles of the board meanwhile."""

    def __init__(
        self,
        heli: Heli,
        operator: Operator,
        output: str,
        rig: Rig,
        limits: PulseLimits,
        check: Callable[[], None],
    ) -> None:
        self._rig = rig
        self._drifts = False
        self._heli, self._operator, self._output = heli, operator, output
        self._limits, self._check = limits, check
        self._confirmed = False
        self._count_rad = 2.0 * np.pi / abs(heli.params["pitch_counts_per_rev"])

    def series(self, start_V: float) -> _Series:
        """Give pulses of rising voltage from `start_V` on; end the series if the rotor pushes down.

        The first pulse that moves pitch is also shown to the operator, who says which rotor turned.
        """
        series = _Series()
        volts_V, step_V = start_V, _STEP_V
        peaks: list[_Peak] = []
        rounding_V = 1e-9
        while volts_V <= self._limits.max_V + rounding_V and len(series.pulses) < _MOVING_PULSES:
            pulse = self.pulse(volts_V)
            response = _response_counts(pulse, self._count_rad, self._rig if self._drifts else None)
            if abs(response.change) > max(_MOVED_counts, _MOVED_STDS * response.std):
                turn = int(np.sign(response.change))
                # First motion: its voltage is where the dead zone ends.
                if not series.rotor:
                    series.rotor = self._confirm_rotor(volts_V)
                    series.turn, series.begins_V = turn, volts_V
                if turn != series.turn:
                    raise CalibrationError(
                        f"the {self._output} output turned pitch both ways",
                        "check its plug and its driver, and that the propeller is tight",
                    )
                series.pulses.append(pulse)
                # Reversed, or wired to push down: the caller repeats the series with the other sign.
                if turn != _lift_turn(series.rotor):
                    break
                peaks.append(_Peak(volts_V, float(np.degrees(abs(response.change) * self._count_rad))))
                step_V = self._next_step(peaks)
                if step_V < _MIN_STEP_V:
                    break
            volts_V = round(volts_V + step_V, 3)
        return series

    def _next_step(self, peaks: list[_Peak]) -> float:
        """Return the next increase of the voltage [V], small enough that pitch stays far below its limit."""
        last = peaks[-1]
        # The pulse before the first peak did not move pitch.
        previous = peaks[-2] if len(peaks) > 1 else _Peak(last.volts_V - _STEP_V, 0.0)
        deg_per_V = max((last.deg - previous.deg) / (last.volts_V - previous.volts_V), 1e-3)
        return min(_STEP_V, (_MAX_ANGLE_SHARE * self._limits.max_angle_deg - last.deg) / deg_per_V)

    def _confirm_rotor(self, volts_V: float) -> str:
        """Ask the operator which rotor turned, ``front`` or ``back``."""
        rotor = self._operator.choose(
            f"{self._output} output, {volts_V:g} V: which rotor turned?", ("front", "back", "neither")
        )
        if rotor == "neither":
            raise CalibrationError(
                f"pitch moved during the pulse of the {self._output} output, but neither rotor turned",
                "keep hands and draughts off the short arm, then calibrate again",
            )
        return rotor

    def pulse(self, volts_V: float) -> Pulse:
        """Ask the operator, wait until pitch is still, and give one pulse; return pitch around it."""
        if not self._confirmed:
            answer = self._operator.choose(
                f"pulse: {self._output} output, {volts_V:g} V for {_PULSE_s:g} s. "
                "Hands off, nobody in the arm's circle",
                ("pulse", "all", "stop"),
            )
            if answer == "stop":
                raise FlightAborted("the operator stopped the calibration; the motors are off")
            self._confirmed = answer == "all"
        self._wait_until_still()
        self._arm_when_still()
        try:
            samples = self._drive(volts_V)
        except BaseException:
            with contextlib.suppress(HeliError):
                self._heli.stop()
            raise
        self._heli.stop()
        return _pulse_of_samples(samples, self._output, volts_V)

    def _arm_when_still(self) -> None:
        """Arm the motors; repeat while the board sees motion."""
        for attempt in range(_MAX_ARM_ATTEMPTS):
            try:
                # Heli.arm would refuse a simulated board whose wires are wrong, and finding wrong wires is
                # what a calibration is for.
                self._heli.flying.arm()
            except CommandRefused as error:
                # A single count of a slow drift looks like 3 degrees per second for a moment.
                if error.detail != Fault.MOVING or attempt == _MAX_ARM_ATTEMPTS - 1:
                    raise
                self._heli.wait(_ARM_RETRY_s)
            else:
                return

    def _drive(self, volts_V: float) -> Samples:
        """Give one voltage pulse with the armed board, and return the samples around the pulse."""
        heli = self._heli
        start_deg = angles_deg(heli)
        heli.control(Axes(0))
        front_V, back_V = (volts_V if output == self._output else 0.0 for output in MOTOR_OUTPUTS)
        heli.excite(Excitation.STEP, front_V, back_V, duration_s=_PULSE_s)
        margin_s = 0.2  # for the message that starts the pulse
        end_s = heli.latest.t_s + _PULSE_s + _AFTER_s + margin_s
        while (sample := heli.latest).t_s < end_s:
            if sample.state is not State.OPEN_LOOP:
                if sample.fault:
                    raise FlightAborted(f"the board switched the motors off: {fault_text(sample.fault)}")
                raise FlightAborted(
                    "the board got no more messages from the host and switched the motors off",
                    "check the USB cable, then calibrate again",
                )
            moved_deg = np.abs(sample_angles_deg(sample) - start_deg)
            if moved_deg.max() > self._limits.max_angle_deg:
                raise FlightAborted(
                    f"{AXES[int(moved_deg.argmax())]} moved by {moved_deg.max():.1f} degrees, more than "
                    f"{self._limits.max_angle_deg:g}; the motors are off; block the arm, or lower --max-V"
                )
            if self._operator.wants_stop():
                raise FlightAborted("the stop key was pressed; the motors are off")
            self._check()
            heli.wait(_POLL_s)
        # 1 s more than needed: `_pulse_of_samples` finds the pulse by its voltages.
        return heli.samples(_BEFORE_s + _PULSE_s + _AFTER_s + 1.0)

    def _drifts_slowly(self, pitch_deg: Floats, count_deg: float) -> bool:
        """Whether the short arm drifts so smoothly and slowly that the model of a pulse includes the drift.

        A short arm whose rotors differ by a few grams is nowhere at rest near level.
        """
        t_s = np.arange(len(pitch_deg)) * TICK_S
        parabola = np.polynomial.Polynomial.fit(t_s, pitch_deg, 2)
        is_smooth = np.abs(parabola(t_s) - pitch_deg).max() <= _SMOOTH_counts * count_deg
        rate_deg_s = float(parabola.deriv()(t_s[-1]))
        at_end_deg = pitch_deg[-1] + rate_deg_s * (_PULSE_s + _AFTER_s)
        near_deg = _MAX_DRIFT_SHARE * self._limits.max_angle_deg
        return bool(is_smooth and max(abs(pitch_deg[-1]), abs(at_end_deg)) < near_deg)

    def _wait_until_still(self) -> None:
        """Wait until pitch is near level, and still for a second or in a slow drift; otherwise, ask the
        operator to steady it.
        """
        for attempt in range(_MAX_ATTEMPTS):
            end_s = self._heli.latest.t_s + _STILL_TIMEOUT_s
            while self._heli.latest.t_s < end_s:
                self._heli.wait(_STILL_s)
                pitch_deg = np.degrees(self._heli.samples(_STILL_s).pitch_rad)
                count_deg = float(np.degrees(self._count_rad))
                if np.ptp(pitch_deg) <= _STILL_counts * count_deg:
                    if abs(pitch_deg[-1]) < _MAX_ANGLE_SHARE * self._limits.max_angle_deg:
                        return
                    break
                # A swing that a hand has left comes to rest, and a steady drift does not.
                if (attempt > 0 or self._drifts) and self._drifts_slowly(pitch_deg, count_deg):
                    self._drifts = True
                    return
            self._operator.act(HandAction.STEADY)
        raise CalibrationError(
            "the short arm does not come to rest",
            "keep draughts away, check that the cables do not pull at the short arm, and balance its rotors",
        )


def _pulse_of_samples(samples: Samples, output: str, volts_V: float) -> Pulse:
    """Cut out pitch around the pulse of an output, in steps of `_PULSE_GRID_s`."""
    powered_rows = np.flatnonzero(getattr(samples, f"{output}_V"))
    if not len(powered_rows):
        raise CalibrationError(
            f"the board gave no voltage to the {output} output", "check the limits of its parameters"
        )
    ticks_per_step = round(_PULSE_GRID_s / TICK_S)
    first_row = powered_rows[0] - round(_BEFORE_s / TICK_S)
    count = round((_BEFORE_s + _PULSE_s + _AFTER_s) / _PULSE_GRID_s)
    rows = first_row + ticks_per_step * np.arange(count)
    if rows[0] < 0 or rows[-1] >= len(samples) or np.any(np.diff(samples.tick) != 1):
        raise CalibrationError("samples of a pulse are missing", "check the USB cable, then calibrate again")
    return Pulse(volts_V, samples.pitch_rad[rows])


_PULSE_GRID_s: Final = 0.005
"""Time step at which measured and modelled pitch are compared [s]."""
_BEFORE_s: Final = 0.3
"""Time before a pulse that is compared [s]."""
_PULSE_s: Final = 0.3
"""Length of a pulse [s]. Longer: a strong rotor turns pitch too far. Shorter: a slow rotor gives no
thrust."""
_AFTER_s: Final = 1.2
"""Time after a pulse that is compared [s]; long enough for the thrust of a slow rotor to act."""
_MIN_PULSES: Final = 3
"""Smallest number of pulses that move pitch: a straight line through fewer has no standard error."""
_MAX_SHARE: Final = 0.2
"""Largest standard error of a thrust gain, as a share of the gain. Above it, the rig file's value stays."""
_LOWER_BOUNDS: Final = (0.0, 0.0, 1e-3)
_UPPER_BOUNDS: Final = (100.0, 20.0, 0.5)
"""Bounds of stiffness, damping and lag: of any rig that a hand can carry, with rotors of up to 0.5 s."""
_GEOMETRY: Final = ("M_f", "M_b", "M_h", "L_h", "L_phi")
"""Rig parameters with which an acceleration of pitch is converted to thrust."""


@dataclass(frozen=True)
class Pulse:
    """Pitch around one pulse."""

    volts_V: float  # Voltage of the output during the pulse
    pitch_rad: Floats  # Pitch from _BEFORE_s before the pulse to _AFTER_s after it, in steps of _PULSE_GRID_s


@dataclass(frozen=True)
class ThrustLine:
    """Straight line of thrust over voltage: gain (V - dead zone)."""

    gain_N_per_V: float
    """gain_N_per_V, gain_std: Slope, and its standard error by the jackknife over the pulses."""
    gain_std: float
    dead_zone_V: float
    """dead_zone_V, dead_zone_std: Voltage at which the line is zero, and its standard error."""
    dead_zone_std: float
    pulses: int  # Pulses that the line is fitted to


def response_design(stiffness: float, damping: float, lag_s: float) -> Floats:
    """Compute the design matrix of pitch around a pulse, of which measured pitch is a linear combination.
    Returns shape (times, 4).

    Pitch obeys phi'' = -stiffness phi - damping phi' + a, where the acceleration a by the thrust follows the
    voltage with a first-order lag.
    """
    lag_s = max(lag_s, 1e-3)  # the matrix contains 1 / lag_s
    state_matrix = np.array(
        [
            [0.0, 1.0, 0.0, 0.0],
            [-stiffness, -damping, 1.0, 0.0],
            [0.0, 0.0, -1.0 / lag_s, 1.0 / lag_s],
            [0.0, 0.0, 0.0, 0.0],
        ]
    )
    before, during, after = (
        round(duration_s / _PULSE_GRID_s) for duration_s in (_BEFORE_s, _PULSE_s, _AFTER_s)
    )
    count = before + during + after
    (step_transition,) = matrix_exponentials(state_matrix[np.newaxis] * _PULSE_GRID_s)
    # Transitions over 0, 1, 2, ... steps. States are angle, rate, acceleration by thrust, and the voltage,
    # which only the pulse sets.
    transitions = _matrix_powers(step_transition, count)
    angle, rate, _, voltage = range(4)
    state_after_pulse = transitions[during, :, voltage].copy()
    state_after_pulse[voltage] = 0.0
    # Columns: the response to a pulse of 1, a constant, and free motion from an initial angle or rate of 1.
    design = np.zeros((count, 4))
    pulse_response = design[:, 0]
    pulse_response[before : before + during] = transitions[:during, angle, voltage]
    pulse_response[before + during :] = transitions[:after, angle] @ state_after_pulse
    design[:, 1] = 1.0
    design[:, 2:] = transitions[:, angle, [angle, rate]]
    return design


@dataclass(frozen=True)
class _PitchDynamics:
    """Dynamics of pitch that all pulses share: stiffness [1/s^2], damping [1/s] and lag of the thrust [s]."""

    stiffness: float
    damping: float
    lag_s: float

    def design(self) -> Floats:
        """Compute the design matrix of `response_design`, shape (times, 4)."""
        return response_design(self.stiffness, self.damping, self.lag_s)

    def accelerations(self, measured: Floats) -> Floats:
        """Estimate the pitch acceleration that each pulse caused [rad/s^2], shape (n,). Shapes: `measured`
        (times, n).
        """
        pulse_response, *_ = _least_squares(self.design(), measured)
        return np.asarray(pulse_response)


def _pitch_dynamics_of_rig(rig: Rig) -> _PitchDynamics:
    """Compute the pitch dynamics from the rig file's masses and friction, with a lag of 0.02 s, as the start
    of a fit.
    """
    inertia_kg_m2 = _pitch_inertia(rig)
    tilting_kg = rig["M_f"].value + rig["M_b"].value + rig["M_h"].value
    stiffness = tilting_kg * rig["g"].value * rig["L_phi"].value / inertia_kg_m2
    # A rig file may state no stiffness or no friction: the fit starts from small ones.
    return _PitchDynamics(max(stiffness, 0.1), max(rig["friction_pitch"].value / inertia_kg_m2, 0.05), 0.02)


def _fit_pitch_dynamics(measured: Floats, start: _PitchDynamics) -> _PitchDynamics:
    """Fit the dynamics to pitch around all pulses, shape (times, n), by separable least squares.

    The residual eliminates the four linear coefficients of each pulse, see `response_design`, so that the
    search has three unknowns only.
    """

    def residual(parameters: Floats) -> Floats:
        """Measured minus modelled pitch, shape (times n,), for stiffness, damping and lag."""
        design = response_design(*parameters)
        return np.asarray((measured - design @ _least_squares(design, measured)).ravel())

    first = np.clip([start.stiffness, start.damping, start.lag_s], _LOWER_BOUNDS, _UPPER_BOUNDS)
    fit = scipy.optimize.least_squares(
        residual, first, bounds=(_LOWER_BOUNDS, _UPPER_BOUNDS), x_scale=[1.0, 1.0, 0.05], xtol=1e-4
    )
    return _PitchDynamics(*map(float, fit.x))


class _Response(NamedTuple):
    """Largest change of pitch after a pulse, and its standard error, in encoder counts."""

    change: float
    std: float


def _response_counts(pulse: Pulse, count_rad: float, drifting: Rig | None = None) -> _Response:
    """Measure how much a pulse moves pitch, in encoder counts of `count_rad` [rad].

    If the short arm drifts, because its rotors differ by a few grams, the drift is estimated together with
    the response, with the dynamics of the rig file `drifting`.
    """
    before, during = round(_BEFORE_s / _PULSE_GRID_s), round(_PULSE_s / _PULSE_GRID_s)
    before_rad = pulse.pitch_rad[:before]
    if drifting is None:
        # Pitch still moves after a pulse: it is largest within another length of the pulse.
        change_rad = pulse.pitch_rad[before : before + 2 * during] - before_rad.mean()
        largest_rad = change_rad[np.argmax(np.abs(change_rad))]
        return _Response(float(largest_rad / count_rad), float(before_rad.std() / count_rad))
    design = _pitch_dynamics_of_rig(drifting).design()
    coefficients = _least_squares(design, pulse.pitch_rad)
    residual_rad = pulse.pitch_rad - design @ coefficients
    # Neighbouring residuals are alike, so that a fit has as many observations as the pulse has lengths.
    observations = len(residual_rad) * _PULSE_GRID_s / _PULSE_s
    covariance = np.linalg.pinv(design.T @ design) * len(residual_rad) / max(observations, 1.0)
    # The first coefficient is that of the response to the pulse.
    std = float(np.sqrt(covariance[0, 0]) * residual_rad.std())
    peak_counts = float(np.abs(design[:, 0]).max() / count_rad)
    return _Response(float(coefficients[0]) * peak_counts, std * peak_counts)


def thrust_of(pulses: Sequence[Pulse], sign: int, rig: Rig) -> ThrustLine | str:
    """Estimate thrust gain and dead zone of a rotor from the pulses that moved pitch.

    Standard errors are those of the jackknife: the estimate is repeated without each pulse.
    """
    if len(pulses) < _MIN_PULSES:
        return f"{len(pulses)} pulses moved pitch, and a line needs {_MIN_PULSES}"
    volts_V = np.array([pulse.volts_V for pulse in pulses])
    # Thrust per acceleration of pitch: inertia over lever arm.
    newton_per_acceleration = sign * _pitch_inertia(rig) / rig["L_h"].value
    measured = np.column_stack([pulse.pitch_rad for pulse in pulses])
    dynamics = _fit_pitch_dynamics(measured, _pitch_dynamics_of_rig(rig))
    gain_N_per_V, dead_zone_V = _gain_and_zero(
        volts_V, newton_per_acceleration * dynamics.accelerations(measured)
    )
    estimates = []
    for index in range(len(pulses)):
        other_pulses = np.delete(measured, index, axis=1)
        refit = _fit_pitch_dynamics(other_pulses, dynamics)
        thrust_N = newton_per_acceleration * refit.accelerations(other_pulses)
        estimates.append(_gain_and_zero(np.delete(volts_V, index), thrust_N))
    # Variance of the jackknife with n estimates: (n - 1) / n times the sum of the squared deviations.
    deviations = np.array(estimates) - np.mean(estimates, axis=0)
    factor = (len(estimates) - 1) / len(estimates)
    gain_std, dead_zone_std = np.sqrt(factor * np.sum(deviations**2, axis=0))
    if not gain_N_per_V > 0.0:
        return f"thrust does not grow with the voltage ({gain_N_per_V:.3g} N/V)"
    if gain_std > _MAX_SHARE * gain_N_per_V:
        return f"the pulses scatter: {gain_N_per_V:.3g} N/V with a standard error of {gain_std:.2g} N/V"
    return ThrustLine(gain_N_per_V, float(gain_std), dead_zone_V, float(dead_zone_std), len(pulses))


def geometry_share(rig: Rig) -> float:
    """Compute the relative uncertainty of a thrust gain because of the tolerances of masses and lengths."""
    nominal_ratio = _pitch_inertia(rig) / rig["L_h"].value
    relative_changes = []
    for name in _GEOMETRY:
        changed_rig = rig.replace(**{name: rig[name].value + rig[name].tolerance})
        relative_changes.append(_pitch_inertia(changed_rig) / changed_rig["L_h"].value / nominal_ratio - 1.0)
    return float(np.sqrt(np.sum(np.square(relative_changes))))


def _gain_and_zero(volts: Floats, thrust_N: Floats) -> tuple[float, float]:
    """Fit a straight line; return its slope [N/V] and the voltage at which it is zero [V]."""
    slope, constant = np.polyfit(volts, thrust_N, 1)
    return float(slope), float(-constant / slope) if slope else 0.0  # `thrust_of` refuses a level line


def _pitch_inertia(rig: Rig) -> float:
    """Moment of inertia about the pitch axis [kg m^2]."""
    return inertias_kg_m2({name: number.value for name, number in rig.items()})["J_phi"]


def _least_squares(design: Floats, measured: Floats) -> Floats:
    """Coefficients of the columns of `design`, shape (k, n), that fit each column of `measured`, (times,
    n).
    """
    return np.asarray(np.linalg.lstsq(design, measured, rcond=1e-10)[0])


def _matrix_powers(matrix: Floats, count: int) -> Floats:
    """Compute the powers 0 to `count` - 1 of a matrix, shape (count, n, n), by doubling their number."""
    powers = np.eye(len(matrix))[np.newaxis]
    while len(powers) < count:
        powers = np.concatenate((powers, powers @ matrix))
        matrix = matrix @ matrix
    return powers[:count]
