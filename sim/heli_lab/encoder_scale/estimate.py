"""Estimates each encoder's scale from one flight: counts shown per count that the rig's model predicts.

Let s be the scale of an encoder, m the angle that it shows, m = r + s (q - r) with the angle r at which it
was zeroed. For a smooth test function w of compact support the model's acceleration f gives, without any
derivative of a measured angle,

    integral w'' m dt = s integral w f(q, dq/dt, u; p) dt + disturbances.

Gravity and the thrust enter f of elevation, and the lift times the sine of pitch that of travel: so each axis
has a separate scale. The numbers p of the rig are estimated together with s, with the rig file's tolerances
as their priors; a standard error of s contains what they leave open.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Final

import numpy as np
from heli_host.arrays import Floats
from heli_host.flight import Flight
from heli_host.flight.flown import flown_rows
from heli_sim.model.base import Model
from heli_sim.model.parts import AXES
from heli_sim.rig import Rig

from heli_lab.encoder_scale.weak_form import TestFunctions, gap_free_parts
from heli_lab.estimation import ModelFunctions, Trajectory
from heli_lab.estimation.levenberg_marquardt import DampedStep, minimise
from heli_lab.identify.flight_model import TORQUE_STD_Nm, model_functions
from heli_lab.identify.free import FLIGHT_CONSTANTS, free_parameters

MIN_s: Final = 5.0
"""Shortest flight that gives an estimate, s: some periods of the slowest test function."""
CLEAR_deg: Final = 8.0
"""Height above the table, deg, from which on neither it nor the air over it pushes. Lower: the table passes
for thrust. Higher: flights that stay low say nothing."""
_LAG_s: Final = 0.05
_LAG_STD_s: Final = 0.05
"""Prior of the lag of the rotors' thrust, of first order: what rotors of this size have, 0 to 0.15 s."""
_SCALE_LOG_STD: Final = 3.0
"""Prior of the logarithm of a scale: a factor of 20. It takes 0.03 nats off a scale of one half. It matters
only in flights that say nothing about a scale, such as a hover about travel: the search then stays finite."""
_LAG_STEP_s: Final = 1e-4
"""Step of the derivative by the lag, s."""
_NOISE_ROUNDS: Final = 3
_FIRST_rad_s2: Final = 0.03
"""Standard deviation of a residual to begin with, rad/s2: that of strong gusts."""
_MIN_rad_s2: Final = 1e-3
"""Least standard deviation of a residual, rad/s2: what smoothing and rounding leave without disturbances."""
_MAX_CORRELATION: Final = 0.9
"""Largest correlation of neighbouring residuals that is believed: beyond it an equation term is missing."""
_FEEDBACK: Final = 2.0
"""How far a scale may be wrong because the control law answers disturbances, see `_noise`, in shares of their
power. On 24 rigs in strong disturbances the estimates of sines were up to three shares too small. Smaller:
false warnings. Larger: half the counts unseen."""
_FIRST_DAMPING: Final = 1.0
"""Damping of the first step of a search: no scale then moves by more than its prior allows."""
_MAX_STEPS: Final = 60
"""Steps of a search after which its best point is taken."""


@dataclass(frozen=True)
class ScaleEstimate:
    """Estimated scale of one encoder; all other parameters of the rig vary within their tolerances.

    Parameters
    ----------
    axis : str
        Axis of the encoder: ``elevation``, ``pitch`` or ``travel``.
    scale : float
        Counts that the encoder shows per count that the model predicts; 1 for a correct encoder.
    standard_error : float
        Standard error of the scale.
    nats : float
        Log-likelihood ratio of this scale to a scale of 1, nats (6 nats: 400 times as likely).
    """

    axis: str
    scale: float
    standard_error: float
    nats: float

    @property
    def sigmas(self) -> float:
        """Distance of the scale from 1, in standard errors."""
        return abs(self.scale - 1.0) / self.standard_error


@cache
def _functions_of(kind: type[Model], free: tuple[str, ...]) -> ModelFunctions:
    """Functions of a plain model: to compile them takes as long as a second of simulated flight."""
    return model_functions(kind(), free)


class FlightInWeakForm:
    """Residuals of a rig's equations of motion along a flight, in weak form.

    The unknowns are the encoders' scales, a lag, the encoders' zeros, and the rig parameters.

    Parameters
    ----------
    flight : Flight
        Any flight of a board, gaps allowed.
    rig : Rig
        Values and tolerances of the rig parameters.
    model : Model
        Equations; effects with states of their own, and those driven by chance, are left out.

    Attributes
    ----------
    seconds : float
        Duration of the free flight that is used, s.
    """

    def __init__(self, flight: Flight, rig: Rig, model: Model) -> None:
        plain = type(model)(tuple(e for e in model.effects if not e.states and not e.noise_inputs))
        self._parameters = plain.parameter_values(rig)
        parameters = free_parameters(plain, rig, None, {})
        free = [parameter for parameter in parameters if parameter.quantity not in FLIGHT_CONSTANTS]
        torques = {name: np.hypot(0.5 * rig[name].tolerance, std) for name, std in TORQUE_STD_Nm.items()}
        numbered = (*(parameter.quantity for parameter in free), *torques)
        self._places = [plain.parameter_names.index(name) for name in numbered]
        self._functions = (
            _functions_of(type(plain), numbered) if plain.is_plain else model_functions(plain, numbered)
        )
        rest_deg = flight.parameters.get("elevation_rest_deg", rig["elevation_min"].value)
        self._pivot: Floats = np.array([np.radians(rest_deg), 0.0, 0.0])
        tolerances_deg = [
            np.hypot(rig["offset_elevation"].tolerance, rig["elevation_min"].tolerance),
            rig["offset_pitch"].tolerance,
        ]
        zeros_rad = np.radians(0.5 * np.array(tolerances_deg))
        # Unknowns: logarithms of three scales, lag, two zeros, numbers of the rig, constant torques.
        numbers = self._parameters[self._places]
        self.mean: Floats = np.concatenate(([0.0] * 3, [_LAG_s, 0.0, 0.0], numbers))
        deviations = [parameter.prior.std for parameter in free] + list(torques.values())
        self.std: Floats = np.concatenate(
            ([_SCALE_LOG_STD] * 3, [_LAG_STD_s], np.maximum(zeros_rad, 1e-6), deviations)
        )
        rows = flown_rows(flight) & (flight.elevation_rad > self._pivot[0] + np.radians(CLEAR_deg))
        # The lag is one of the thrust: below its dead zone a motor gives none, however low its voltage is.
        dead_zone_V = plain.dead_zone_V(self._parameters)
        parts = gap_free_parts(flight, rows, -np.inf if dead_zone_V is None else dead_zone_V)
        self.seconds = sum(part.seconds for part in parts)
        self._parts = parts
        self._tests = [TestFunctions(part) for part in parts]
        self._shown = [
            test.second_derivative(part.angles_rad) for test, part in zip(self._tests, parts, strict=True)
        ]

    def shown(self, axis: int) -> Floats:
        """Mean accelerations of the angle that the encoder of an `axis` (0 to 2) shows [rad/s2]."""
        return np.concatenate([block[axis] for block in self._shown])

    def residuals(self, unknowns: Floats) -> tuple[list[Floats], list[Floats]]:
        """Residuals of each axis [rad/s2] and their derivatives by the `unknowns`, (rows, unknowns)."""
        scales, lag_s, zeros = np.exp(unknowns[:3]), unknowns[3], np.array([*unknowns[4:6], 0.0])
        parameters = self._parameters.copy()
        parameters[self._places] = unknowns[6:]
        values: list[list[Floats]] = [[], [], []]
        slopes: list[list[Floats]] = [[], [], []]
        for part, test, shown in zip(self._parts, self._tests, self._shown, strict=True):
            moved = (part.angles_rad - self._pivot - zeros) / scales
            rates = part.rates_rad_s / scales
            volts = part.lagged_V(lag_s)
            volts_by_lag = (part.lagged_V(lag_s + _LAG_STEP_s) - volts) / _LAG_STEP_s
            state = np.hstack((self._pivot + moved, rates))
            along = Trajectory(part.t_s, state, volts, part.step_s, parameters)
            value, by_state, _, by_volts, *_ = self._functions.along(along)
            for axis in range(3):
                row = 3 + axis
                pushed = test.mean(axis, value[:, row, 0])
                values[axis].append(shown[axis] - scales[axis] * pushed)
                by = by_state[:, row]
                by_scales = -by[:, :3] * moved - by[:, 3:6] * rates
                by_lag = np.sum(by_volts[:, row] * volts_by_lag, axis=1, keepdims=True)
                by_zeros = -by[:, :2] / scales[:2]
                # The functions give what a number takes off the rates.
                columns = np.hstack((by_scales, by_lag, by_zeros, -value[:, row, 1:]))
                slope = -scales[axis] * test.mean(axis, columns)
                slope[:, axis] -= scales[axis] * pushed
                slopes[axis].append(slope)
        return [np.concatenate(part) for part in values], [np.concatenate(part) for part in slopes]


@dataclass(frozen=True)
class _Iterate:
    """Free unknowns, residuals of each axis [rad/s2], residuals and derivatives in standard deviations."""

    free: Floats
    residuals: list[Floats]
    errors: Floats
    jacobian: Floats
    cost: float


class _ScaleProblem:
    """Scales of some axes and everything else, with priors: a `LeastSquares` problem.

    Parameters
    ----------
    weak_form : FlightInWeakForm
        The flight.
    noise : ndarray (3,)
        Standard deviation of the residuals of each axis [rad/s2].
    axes : sequence of int
        Axes whose scales are free.
    start : ndarray
        All unknowns; those that are not free keep these values.
    """

    def __init__(
        self, weak_form: FlightInWeakForm, noise: Floats, axes: Sequence[int], start: Floats
    ) -> None:
        self._weak_form, self._noise, self._start = weak_form, noise, start
        self._free = np.array([*axes, *range(3, len(weak_form.mean))], int)
        self._mean, self._precision = weak_form.mean[self._free], weak_form.std[self._free] ** -2

    def unknowns(self, free: Floats) -> Floats:
        """Return all unknowns."""
        result = self._start.copy()
        result[self._free] = free
        return result

    def first(self) -> _Iterate:
        """Return the iterate at the start."""
        return self._evaluate(self._start[self._free])

    def covariance(self, iterate: _Iterate) -> Floats:
        """Return the covariance of the free unknowns."""
        return np.asarray(np.linalg.inv(self._information(iterate, 0.0)), np.float64)

    def step(self, iterate: _Iterate, damping: float) -> DampedStep[_Iterate]:
        """See `LeastSquares.step`; the damping is in units of the priors' precision."""
        matrix = self._information(iterate, damping)
        slope = -iterate.jacobian.T @ iterate.errors + self._precision * (self._mean - iterate.free)
        move = np.linalg.solve(matrix, slope)
        std = np.sqrt(np.diag(np.linalg.inv(matrix)))
        promised = float(move @ (2.0 * slope - matrix @ move))
        return DampedStep(move, std, promised, lambda: self._evaluate(iterate.free + move))

    def with_states_refined(self, iterate: _Iterate) -> None:
        """No unknown is eliminated."""

    def is_out_of_budget(self) -> bool:
        """The number of steps is the only limit."""
        return False

    def _information(self, iterate: _Iterate, damping: float) -> Floats:
        return iterate.jacobian.T @ iterate.jacobian + np.diag((1.0 + damping) * self._precision)

    def _evaluate(self, free: Floats) -> _Iterate:
        residuals, slopes = self._weak_form.residuals(self.unknowns(free))
        errors = np.concatenate([values / std for values, std in zip(residuals, self._noise, strict=True)])
        rows = [values[:, self._free] / std for values, std in zip(slopes, self._noise, strict=True)]
        away = self._precision @ (free - self._mean) ** 2
        return _Iterate(free, residuals, errors, np.vstack(rows), float(errors @ errors + away))


@dataclass(frozen=True)
class _Fit:
    unknowns: Floats
    covariance: Floats
    cost: float
    residuals: list[Floats]


def scales_of(flight: Flight, rig: Rig, model: Model) -> tuple[ScaleEstimate, ...]:
    """Estimate the scale of each encoder, the other two taken as right; empty where too little was flown.

    Parameters
    ----------
    flight : Flight
        Any flight of a board, gaps allowed.
    rig : Rig
        Numbers and tolerances: what is known beforehand.
    model : Model
        Its equations.

    Returns
    -------
    tuple of ScaleEstimate
        For elevation, pitch and travel.
    """
    weak_form = FlightInWeakForm(flight, rig, model)
    if weak_form.seconds < MIN_s:
        return ()
    noise, joint = _noise(weak_form)
    without = _fit(weak_form, noise, (), weak_form.mean)
    return tuple(_estimate(weak_form, noise, axis, joint, without) for axis in range(3))


def _estimate(
    weak_form: FlightInWeakForm, noise: Floats, axis: int, joint: _Fit, without: _Fit
) -> ScaleEstimate:
    """Fit with the scale of one axis free. The search starts from the fit with all scales free, `joint`, and
    from that with none, `without`; the lower cost counts.
    """
    start = joint.unknowns.copy()
    start[[other for other in range(3) if other != axis]] = 0.0
    fits = [_fit(weak_form, noise, (axis,), initial) for initial in (start, without.unknowns)]
    best = min(fits, key=lambda fit: fit.cost)
    scale = float(np.exp(best.unknowns[axis]))
    error = scale * float(np.sqrt(best.covariance[0, 0]))
    return ScaleEstimate(AXES[axis], scale, error, 0.5 * (without.cost - best.cost))


def _noise(weak_form: FlightInWeakForm) -> tuple[Floats, _Fit]:
    """Standard deviation of each axis' residuals, shape (3,), for the weights of a fit; and the fit that gave
    it.

    All scales are free in this fit, so that a wrong scale does not count as noise. The standard deviations
    follow from its residuals by three rules.

    1. Neighbouring residuals are correlated. As for a first-order autoregression, their long-run variance is
       the variance times (1 + rho) / (1 - rho), with the correlation rho of neighbours.
    2. Least squares assume that what drives an axis is independent of the disturbances, but a control law
       responds to disturbances (Ljung, chapter 13). This gives the scale a relative error of the order of r,
       the power of the residuals over that of the predicted accelerations: in a hover, travel shows a quarter
       of its scale. From n independent residuals alone the standard error would be sqrt(r / n). The noise is
       therefore multiplied by sqrt(1 + (c r)^2 n / r), with c of `_FEEDBACK`.
    3. If only disturbances move an axis, a small scale explains its angles as well as any, and makes its
       residuals small. They are therefore divided by a scale below 1.
    """
    noise, unknowns = np.full(3, _FIRST_rad_s2), weak_form.mean
    for _ in range(_NOISE_ROUNDS):
        fit = _fit(weak_form, noise, (0, 1, 2), unknowns)
        unknowns = fit.unknowns
        for axis, residual in enumerate(fit.residuals):
            variance = float(np.mean(residual**2))
            rho = float(np.mean(residual[1:] * residual[:-1])) / max(variance, 1e-30)
            rho = min(max(rho, 0.0), _MAX_CORRELATION)
            noise[axis] = max(np.sqrt(variance * (1.0 + rho) / (1.0 - rho)), _MIN_rad_s2)
    for axis, residual in enumerate(fit.residuals):
        predicted = weak_form.shown(axis) - residual
        ratio = float(np.mean(residual**2)) / max(float(np.mean(predicted**2)), 1e-12)
        noise[axis] *= np.sqrt(1.0 + _FEEDBACK**2 * ratio * len(residual))
        noise[axis] /= min(1.0, float(np.exp(unknowns[axis])))
    return noise, fit


def _fit(weak_form: FlightInWeakForm, noise: Floats, axes: Sequence[int], start: Floats) -> _Fit:
    """Fit the scales of some axes and everything else, with priors, from `start` on."""
    problem = _ScaleProblem(weak_form, noise, axes, start)
    best = minimise(problem, problem.first(), damping=_FIRST_DAMPING, max_steps=_MAX_STEPS).iterate
    return _Fit(problem.unknowns(best.free), problem.covariance(best), best.cost, best.residuals)
