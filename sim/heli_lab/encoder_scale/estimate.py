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
from typing import Final

import numpy as np
from heli_host.arrays import Floats
from heli_host.flight import Flight
from heli_host.flight.flown import flown_rows
from heli_sim.model.base import Model
from heli_sim.model.parts import AXES
from heli_sim.rig import Rig

from heli_lab.encoder_scale.weak_form import TestFunctions, parts_of
from heli_lab.estimation import Trajectory
from heli_lab.identify.flight_model import TORQUE_STD_Nm, model_functions
from heli_lab.identify.free import free_parameters

LEAST_s: Final = 5.0
"""Flight that is enough to say something, s: some periods of the slowest test function."""
CLEAR_deg: Final = 8.0
"""Height above the table, deg, from which on neither it nor the air over it pushes. Lower: the table passes
for thrust. Higher: flights that stay low say nothing."""
_LAG_s: Final = 0.05
_LAG_STD_s: Final = 0.05
"""Prior of the lag of the rotors' thrust, of first order: what rotors of this size have, 0 to 0.15 s."""
_LAG_STEP_s: Final = 1e-4
"""Step of the derivative by the lag, s."""
_ELEVATION, _PITCH, _TRAVEL = range(3)
_ROUNDS: Final = 12
_HALVINGS: Final = 8
_NOISE_ROUNDS: Final = 3
_FIRST_rad_s2: Final = 0.03
"""Standard deviation of a residual to begin with, rad/s2: that of strong gusts."""
_LEAST_rad_s2: Final = 1e-3
"""Least standard deviation of a residual, rad/s2: what smoothing and rounding leave without disturbances."""
_MOST_ALIKE: Final = 0.9
"""Largest correlation of neighbouring residuals that is believed: beyond it an equation term is missing."""
_MOST_FEEDBACK: Final = 0.15
"""Share of an axis' motion that disturbances may have, see `_feedback`. The shipped plans but hover have up
to 0.1 in strong disturbances, hover 0.07 to 0.6. Larger: hover gives pitch half its scale, 4 standard errors
off. Smaller: sines in strong disturbances give no scale."""
_WORST_FEEDBACK: Final = 2.0
"""Standard error of a scale by what `_feedback` gives, in shares of that. On 24 rigs in strong disturbances
the estimates of sines were up to three shares too small. Smaller: false warnings. Larger: half the counts
unseen."""
_SMALL: Final = 1e-3
"""A change of a scale's logarithm, and a tenth of a gain in cost, at which a search ends: below any standard
error."""


@dataclass(frozen=True)
class ScaleEstimate:
    """Scale of one encoder, with everything else of the rig within its tolerances.

    Parameters
    ----------
    axis : str
        Which encoder.
    scale : float
        Counts shown per count that the model predicts.
    standard_error : float
        Of the scale; infinite where the flight does not move the axis enough to tell disturbances apart.
    nats : float
        How much likelier the flight is with this scale than with 1, as the logarithm of the ratio.
    """

    axis: str
    scale: float
    standard_error: float
    nats: float

    @property
    def sigmas(self) -> float:
        """Distance of the scale from 1, in standard errors."""
        return abs(self.scale - 1.0) / self.standard_error


class FlightInWeakForm:
    """A flight and a rig's equations as residuals of unknowns: scales, lag, zeros, and the rig's numbers.

    Parameters
    ----------
    flight : Flight
        Any flight of a board, gaps allowed.
    rig : Rig
        Numbers and tolerances.
    model : Model
        Equations; effects with states of their own, and those driven by chance, are left out.

    Attributes
    ----------
    seconds : float
        Free flight that is used, s.
    """

    def __init__(self, flight: Flight, rig: Rig, model: Model) -> None:
        plain = type(model)(tuple(e for e in model.effects if not e.states and not e.noise_inputs))
        self._parameters = plain.parameter_values(rig)
        constants = set(TORQUE_STD_Nm) | {"offset_elevation", "offset_pitch"}
        free = [
            parameter
            for parameter in free_parameters(plain, rig, None, {})
            if parameter.quantity not in constants
        ]
        names = [quantity.name for quantity in plain.parameters]
        torques = {name: np.hypot(0.5 * rig[name].tolerance, std) for name, std in TORQUE_STD_Nm.items()}
        numbered = (*(parameter.quantity for parameter in free), *torques)
        self._places = [names.index(name) for name in numbered]
        self._functions = model_functions(plain, numbered)
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
            ([np.inf] * 3, [_LAG_STD_s], np.maximum(zeros_rad, 1e-6), deviations)
        )
        rows = flown_rows(flight) & (flight.elevation_rad > self._pivot[0] + np.radians(CLEAR_deg))
        # The lag is one of the thrust: below its dead zone a motor gives none, however low its voltage is.
        least_V = -np.inf if rig["reverse_thrust"].value else rig["dead_zone"].value
        parts = parts_of(flight, rows, least_V)
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
    known = FlightInWeakForm(flight, rig, model)
    if known.seconds < LEAST_s:
        return ()
    noise, joint = _noise(known)
    without = _fit(known, noise, (), known.mean)
    return tuple(_estimate(known, noise, axis, (joint, without)) for axis in range(3))


def _estimate(known: FlightInWeakForm, noise: Floats, axis: int, fits: tuple[_Fit, _Fit]) -> ScaleEstimate:
    """Free the scale of one axis, from where all were free and from where none was."""
    joint, without = fits
    start = joint.unknowns.copy()
    start[[other for other in range(3) if other != axis]] = 0.0
    best = min(
        (_fit(known, noise, (axis,), initial) for initial in (start, without.unknowns)), key=lambda f: f.cost
    )
    scale = float(np.exp(best.unknowns[axis]))
    share = _feedback(known, joint, axis)
    error = float(np.hypot(scale * np.sqrt(best.covariance[0, 0]), _WORST_FEEDBACK * max(scale, 1.0) * share))
    if share > _MOST_FEEDBACK:
        error = np.inf
    return ScaleEstimate(AXES[axis], scale, error, 0.5 * (without.cost - best.cost))


def _feedback(known: FlightInWeakForm, joint: _Fit, axis: int) -> float:
    """How far, as a share of it, a scale may be wrong because the control law answers disturbances.

    Least squares take what drives an axis for independent of the disturbances, and a law makes it depend on
    them. The error is of the order of the mean square of the disturbances over that of what drives the axis.
    In hover nothing else moves pitch, and travel shows a quarter of its scale.

    Travel shows in its own equation only, pitch in that of travel too. Elevation's scale comes from the
    weight of the arm, which no law answers.
    """
    if axis == _ELEVATION:
        return 0.0
    shares = []
    for driver in (_TRAVEL,) if axis == _TRAVEL else (_PITCH, _TRAVEL):
        residual = joint.residuals[driver]
        pushed = known.shown(driver) - residual
        shares.append(float(np.mean(residual**2)) / max(float(np.mean(pushed**2)), 1e-12))
    return min(shares)


def _noise(known: FlightInWeakForm) -> tuple[Floats, _Fit]:
    """Standard deviation of each axis' residuals, (3,), and the last fit: with all scales free, so that
    a wrong scale is no part of it. Neighbours that are alike count as fewer.
    """
    noise, unknowns = np.full(3, _FIRST_rad_s2), known.mean
    for _ in range(_NOISE_ROUNDS):
        fit = _fit(known, noise, (0, 1, 2), unknowns)
        unknowns = fit.unknowns
        for axis, residual in enumerate(fit.residuals):
            variance = float(np.mean(residual**2))
            alike = float(np.mean(residual[1:] * residual[:-1])) / max(variance, 1e-30)
            alike = min(max(alike, 0.0), _MOST_ALIKE)
            noise[axis] = max(np.sqrt(variance * (1.0 + alike) / (1.0 - alike)), _LEAST_rad_s2)
    return noise, fit


def _fit(known: FlightInWeakForm, noise: Floats, axes: Sequence[int], start: Floats) -> _Fit:
    """Gauss-Newton over the scales of some axes and everything else, with priors, from `start` on; steps are
    halved until the cost falls.
    """
    free = np.array([*axes, *range(3, len(known.mean))], int)
    weight = np.where(np.isfinite(known.std[free]), 1.0 / known.std[free], 0.0)
    unknowns = start.copy()

    def cost_of(at: Floats, residuals: list[Floats]) -> float:
        data = sum(float(np.sum((r / n) ** 2)) for r, n in zip(residuals, noise, strict=True))
        return data + float(np.sum((weight * (at[free] - known.mean[free])) ** 2))

    residuals, derivatives = known.residuals(unknowns)
    cost = cost_of(unknowns, residuals)
    for _ in range(_ROUNDS):
        rows = np.vstack([d[:, free] / n for d, n in zip(derivatives, noise, strict=True)])
        errors = np.concatenate([r / n for r, n in zip(residuals, noise, strict=True)])
        information = rows.T @ rows + np.diag(weight**2)
        gradient = rows.T @ errors + weight**2 * (unknowns[free] - known.mean[free])
        step = -np.linalg.solve(information, gradient)
        # A scale moves by at most a factor e at a time.
        if len(axes):
            step *= min(1.0, 1.0 / max(1e-12, float(np.abs(step[: len(axes)]).max())))
        for _ in range(_HALVINGS):
            after = unknowns.copy()
            after[free] += step
            new, slopes = known.residuals(after)
            new_cost = cost_of(after, new)
            if new_cost <= cost or not np.any(step):
                break
            step = 0.5 * step
        if new_cost > cost:
            break
        gained, moved = cost - new_cost, step
        unknowns, cost, residuals, derivatives = after, new_cost, new, slopes
        if gained < 10.0 * _SMALL and (not len(axes) or float(np.abs(moved[: len(axes)]).max()) < _SMALL):
            break
    rows = np.vstack([d[:, free] / n for d, n in zip(derivatives, noise, strict=True)])
    information = rows.T @ rows + np.diag(weight**2)
    return _Fit(unknowns, np.linalg.inv(information), cost, residuals)
