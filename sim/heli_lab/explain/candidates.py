"""Candidates of the search: effects of the catalogue and spline terms, and their signals along flights.

A spline term lets a torque, the thrust or a measured angle depend on one quantity as a cubic B-spline. An
effect of the catalogue must predict at least as well as such a curve. If a curve is much better, the
catalogue lacks the cause, and the curve is reported instead.

The signals of a candidate are how a flight's rates and measured angles change if it joins the model. A score
test filters these signals, which makes them regressors of the innovations.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final, NamedTuple

import casadi as ca
import numpy as np
from heli_host.data.arrays import Floats
from heli_sim.evaluate.trajectories import EFFECT_SUBSTEPS, AlongTrajectory, EffectStates, Trajectory
from heli_sim.model.base import Effect, Model, Operands
from heli_sim.model.effect import AXES
from heli_sim.model.effect import thrust_N as static_thrust_N
from heli_sim.model.effects.spec import EffectSpec
from heli_sim.rig.schema import Prior, Quantity

from heli_lab.fit.flight_model import known_directions, model_along
from heli_lab.fit.linearised_flight import LinearisedFlight


class SplineDependence(NamedTuple):
    """A channel, such as ``torque.pitch``, and a quantity that it depends on, such as ``elevation``."""

    channel: str
    quantity: str


def channel_kind(channel: str) -> str:
    """Return the kind of a `channel`: ``torque``, ``thrust``, ``voltage`` or ``measurement``."""
    return channel.partition(".")[0]


def channel_place(channel: str) -> str:
    """Return the axis or the rotors of a `channel`: ``pitch`` of ``torque.pitch``."""
    return channel.partition(".")[2]


@dataclass(frozen=True)
class Candidate:
    """An effect or spline term that may be added to the model, at one point of its grid."""

    id: str  # Id of the effect, or ``spline:CHANNEL:QUANTITY``
    effect: Effect  # The effect with the parameter values at which its influence is computed
    linear_parameters: tuple[str, ...]
    """Parameters that enter linearly; each gives one regressor. If there is none, the only regressor is the
    difference between the effect at these values and no effect."""
    grid: Mapping[str, float] = field(default_factory=dict)
    """Values of the parameters in which the likelihood is multimodal, by full name."""

    @property
    def neutral(self) -> dict[str, float]:
        """Values of its sizes at which it has practically no influence, within the priors' bounds."""
        # Its sizes are the linear parameters, or, if there are none, the first parameter that has a prior.
        sizes = self.linear_parameters or tuple(self.effect.priors)[:1]
        values = {}
        for name in sizes:
            prior = self.effect.priors[name]
            values[name] = float(np.clip(0.0, prior.low + 1e-6 * prior.std, prior.high))
        return values

    @property
    def is_spline(self) -> bool:
        """Whether it is a spline term, not an effect of the catalogue."""
        return self.id.startswith("spline:")

    @property
    def dependence(self) -> SplineDependence:
        """Channel and quantity of a spline term."""
        _, channel, quantity = self.id.split(":")
        return SplineDependence(channel, quantity)

    def start_values(self, coefficients: Floats) -> dict[str, float]:
        """Start values of a fit, by full name, within the priors' bounds; `coefficients` are those that a
        score test estimates, shape (g,).
        """
        values = {**self.effect.values}
        if self.linear_parameters:
            for name, change in zip(self.linear_parameters, coefficients, strict=True):
                values[name] += float(change)
        for name, prior in self.effect.priors.items():
            margin = 1e-3 * prior.std
            values[name] = float(np.clip(values[name], prior.low + margin, prior.high - margin))
        return values


def typical_candidate(kind: EffectSpec) -> Candidate:
    """Make an effect of this `kind` with its typical size, as a start of a refit."""
    return Candidate(kind.id, kind.make(kind.typical), kind.size)


@dataclass(frozen=True)
class ScoredCandidate:
    """Score test of a candidate at the best point of its grid."""

    candidate: Candidate  # The candidate at that point
    log_likelihood_gain: float
    """Gain that the score test predicts, nats, with all other parameters refitted and the disturbances
    unchanged."""
    coefficients: Floats  # coefficients, std: (g,): Coefficients of its regressors, and their standard errors
    std: Floats
    grid_points: int  # Number of points of the grid that were tried


def effect_candidates(kind: EffectSpec, seconds: float) -> list[Candidate]:
    """Return one candidate per point of the grid of an effect of this `kind`, over a flight of so many
    `seconds`.
    """
    # At each point the effect has the size 0, or its typical values if it has no size.
    grid_values = kind.grid_values(seconds)
    values = kind.neutral if kind.size else kind.typical
    candidates = []
    for point in itertools.product(*grid_values.values()):
        grid = dict(zip(grid_values, point, strict=True))
        candidates.append(Candidate(kind.id, kind.make({**values, **grid}), kind.size, grid))
    return candidates


def may_join(id_: str, present: Iterable[str], kinds: Mapping[str, EffectSpec]) -> bool:
    """Whether a model with the effects `present` may have the effect `id_` too."""
    kind = kinds.get(id_)
    return kind is None or all(kind.compatible_with(kinds[other]) for other in present if other in kinds)


KNOTS: Final = 8
"""Basis functions of a curve: fewer do not follow a kink or bump, more have a higher penalty."""
_TAIL_SHARE: Final = 0.005
"""Share of the flight beyond each end of the curve, where it is constant, so that few samples do not stretch
it."""
# Prior standard deviations of a coefficient: about the torque that holds the arm up, a fifth of the thrust,
# and an encoder error of 1 degree. Smaller: large unlisted effects are not followed. Larger: coefficients
# with few samples diverge.
_TORQUE_STD_Nm: Final = 0.3
_THRUST_STD: Final = 0.2
_ANGLE_STD_rad: Final = 0.02

_UNIT_AND_STD: Final = {
    "torque": ("N m", _TORQUE_STD_Nm),
    "thrust": ("1", _THRUST_STD),
    "measurement": ("rad", _ANGLE_STD_rad),
}
"""Unit and prior standard deviation of a coefficient, by kind of channel."""

_Expression = Callable[[Operands], ca.SX]


def _state(name: str) -> _Expression:
    """Return the expression of a state of the model."""
    return lambda at: at.state[name]


def _static_thrust_N(at: Operands) -> ca.SX:
    """Return the thrusts of front and back rotor that follow from the voltages without any lag, (2, 1)."""
    p = at.parameter
    return static_thrust_N(at.volts_V, p["thrust_gain"], p["dead_zone"], p["reverse_thrust"])


class SplineQuantity(NamedTuple):
    """A quantity that a spline term may depend on."""

    expression: _Expression
    unit: str  # SI unit


QUANTITIES: Final[Mapping[str, SplineQuantity]] = {
    "elevation": SplineQuantity(_state("elevation_rad"), "rad"),
    "pitch": SplineQuantity(_state("pitch_rad"), "rad"),
    "travel": SplineQuantity(_state("travel_rad"), "rad"),
    "elevation_rate": SplineQuantity(_state("elevation_rate_rad_s"), "rad/s"),
    "pitch_rate": SplineQuantity(_state("pitch_rate_rad_s"), "rad/s"),
    "travel_rate": SplineQuantity(_state("travel_rate_rad_s"), "rad/s"),
    "thrust": SplineQuantity(lambda at: ca.sum1(_static_thrust_N(at)), "N"),
    "thrust_difference": SplineQuantity(lambda at: _static_thrust_N(at)[0] - _static_thrust_N(at)[1], "N"),
    "front_thrust": SplineQuantity(lambda at: _static_thrust_N(at)[0], "N"),
    "back_thrust": SplineQuantity(lambda at: _static_thrust_N(at)[1], "N"),
    "time": SplineQuantity(lambda at: at.time_s, "s"),
}
"""Quantities that a spline term may depend on, by name."""

SPLINE_CHANNELS: Final = (
    *(f"torque.{axis}" for axis in AXES),
    *("thrust.both", "thrust.difference"),
    *(f"measurement.{axis}" for axis in AXES),
)
"""Channels on which a spline term may act."""


@dataclass(frozen=True)
class SplineTerm(Effect):
    """Effect of a cubic B-spline: a smooth dependence of one channel on one quantity."""

    channel: str = ""
    """Channel, one of `SPLINE_CHANNELS`: ``torque`` in N m, ``thrust`` as a share, ``measurement`` in rad."""
    on: str = ""  # Quantity, a key of `QUANTITIES`

    @property
    def knots(self) -> tuple[float, float]:
        """Second knot, where the curve begins, and distance of the knots, in the unit of the quantity."""
        return self.values[f"{self.name}_low"], self.values[f"{self.name}_step"]

    def _curve(self, at: Operands) -> ca.SX:
        """Return the value of the curve: the sum of coefficients times basis functions."""
        p = at.parameter
        quantity = QUANTITIES[self.on].expression(at)
        # Position along the curve in units of the knots' distance; basis function i has its centre at i.
        position = 1.0 + (quantity - p[f"{self.name}_low"]) / p[f"{self.name}_step"]
        # Beyond its ends, the curve is constant.
        position = ca.fmin(ca.fmax(position, 1.0), KNOTS - 2.0)
        return sum((p[f"{self.name}_{i}"] * bspline(position - i) for i in range(KNOTS)), ca.SX(0))

    def torque_Nm(self, at: Operands) -> ca.SX:
        """Torque of the curve about its axis [N m], shape (3, 1); see `Effect.torque_Nm`."""
        kind, channel_axis = self.channel.split(".")
        return ca.vertcat(
            *(self._curve(at) if kind == "torque" and channel_axis == axis else 0 for axis in AXES)
        )

    def thrust_N(self, at: Operands, thrust_N: ca.SX) -> ca.SX:
        """Thrust scaled by the curve [N], shape (2, 1); see `Effect.thrust_N`."""
        kind, rotors = self.channel.split(".")
        if kind != "thrust":
            return thrust_N
        share = self._curve(at)
        front, back = 1 + share, 1 + share if rotors == "both" else 1 - share
        return thrust_N * ca.vertcat(front, back)

    def measured_rad(self, at: Operands, angles_rad: ca.SX) -> ca.SX:
        """Measured angles with the curve added [rad], shape (3, 1); see `Effect.measured_rad`."""
        kind, channel_axis = self.channel.split(".")
        if kind != "measurement":
            return angles_rad
        return angles_rad + ca.vertcat(*(self._curve(at) if channel_axis == axis else 0 for axis in AXES))


def bspline(distance: ca.SX) -> ca.SX:
    """Return a cubic B-spline with knots at distance 1 (de Boor 1978), as a function of a `distance`."""
    # The distance is that from its centre. The value is 2/3 at the centre, and 0 beyond distance 2.
    outer = ca.fmax(2.0 - ca.fabs(distance), 0.0)
    inner = ca.fmax(1.0 - ca.fabs(distance), 0.0)
    return (outer**3 - 4.0 * inner**3) / 6.0


def spline_term(channel: str, on: str, low: float, step: float, number: int = 0) -> SplineTerm:
    """Make a spline term with all coefficients at 0."""
    name = f"spline{number}"
    unit, std = _UNIT_AND_STD[channel_kind(channel)]
    quantity_unit = QUANTITIES[on].unit
    coefficients = [Quantity(f"{name}_{i}", unit, f"coefficient {i} of the curve") for i in range(KNOTS)]
    knots = [
        Quantity(f"{name}_low", quantity_unit, "second knot of the curve, where it begins"),
        Quantity(f"{name}_step", quantity_unit, "distance of its knots"),
    ]
    return SplineTerm(
        name,
        parameters=(*coefficients, *knots),
        values={q.name: 0.0 for q in coefficients} | {f"{name}_low": low, f"{name}_step": step},
        priors={q.name: Prior(0.0, std) for q in coefficients},
        channel=channel,
        on=on,
    )


def knot_span(values: Floats) -> tuple[float, float]:
    """Place the knots of a curve over the range of a quantity's `values`, shape (n,); return the second knot,
    where the curve begins, and the distance of the knots.
    """
    low, high = np.quantile(values, [_TAIL_SHARE, 1.0 - _TAIL_SHARE])
    # The curve runs from the second knot to the last but one.
    step = max(float(high - low), 1e-9) / (KNOTS - 3)
    return float(low), step


def bspline_basis(values: Floats, low: float, step: float) -> Floats:
    """Evaluate the B-spline basis of a curve, as `SplineTerm` does. Shapes: `values` (n,); returns (n,
    KNOTS).
    """
    position = np.clip(1.0 + (values - low) / step, 1.0, KNOTS - 2.0)
    distance = np.abs(position[:, None] - np.arange(KNOTS))
    basis: Floats = (np.maximum(2.0 - distance, 0.0) ** 3 - 4.0 * np.maximum(1.0 - distance, 0.0) ** 3) / 6.0
    return basis


def quantity_values(model: Model, trajectory: Trajectory) -> dict[str, Floats]:
    """Evaluate all `QUANTITIES` of a `model` along a `trajectory`; shape (n,) each, by name."""

    def quantities(x: ca.SX, u: ca.SX, p: ca.SX, t: ca.SX) -> list[ca.SX]:
        operands = model.operands(x, u, p, t)
        return [ca.vertcat(*(quantity.expression(operands) for quantity in QUANTITIES.values()))]

    (values,) = model_along(model, quantities)(trajectory)
    return dict(zip(QUANTITIES, values[:, :, 0].T, strict=True))


def channel_quantity_pairs() -> list[tuple[str, str]]:
    """List the spline terms that are tried, as pairs of channel and quantity."""
    return [pair for pair in itertools.product(SPLINE_CHANNELS, QUANTITIES) if _is_testable(*pair)]


def _is_testable(channel: str, quantity: str) -> bool:
    """Whether a dependence of a channel on a quantity would show a cause, and not a property of every log."""
    # The controller feeds the quantisation error back, so in every log a measured angle depends on thrust. A
    # measured angle that depends on the rate of its axis was read late or early. Every log has such a shift
    # of up to half a sample.
    _, _, measured_axis = channel.partition("measurement.")
    if not measured_axis:
        return True
    return "thrust" not in quantity and quantity != f"{measured_axis}_rate"


_MIN_RANGE: Final = 1e-6
"""Range of a quantity, in its SI unit, below which it is constant and no curve over it is tried."""


class CandidateSignals(NamedTuple):
    """Changes of a flight by one unit of each coefficient of a candidate, or of several candidates."""

    rates: Floats  # (n, states, g): Change of the rate of each state; g counts the coefficients
    measured_rad: Floats | None  # (n, 3, g): Direct change of the measured angles; None if there is none


class ChangeAlongTrajectory(NamedTuple):
    """Changes that an effect makes along a trajectory."""

    # `rates` has the shape (n, states, g), and `measured_rad` the shape (n, 3, g), where g counts
    # coefficients. Entries are zero if the effect does not change them.

    rates: Floats
    measured_rad: Floats


class ChangeFunctions:
    """Cache of the functions that compute how candidates change a `model`."""

    # All flights share them, because compiling one takes longer than evaluating it along a flight of one
    # minute.

    def __init__(self, model: Model) -> None:
        self.model = model
        self._extended_models: dict[str, ExtendedModel] = {}

    def extended(self, name: str, effect: Effect, linear_parameters: Sequence[str]) -> ExtendedModel:
        """Return the model extended by an effect."""
        if name not in self._extended_models:
            self._extended_models[name] = ExtendedModel(self.model, effect, linear_parameters)
        return self._extended_models[name]

    @cached_property
    def rates(self) -> AlongTrajectory:
        """Rates of the model without any candidate."""
        return model_along(self.model, lambda x, u, p, t: [self.model.dynamics(x, u, p, t)])


class Regressors:
    """Computes the signals of candidates along one flight."""

    def __init__(self, linear: LinearisedFlight, functions: ChangeFunctions) -> None:
        self.linear = linear
        self.model = linear.model.source
        self._functions = functions
        # Change by one unit on a channel of spline terms, by channel; each has one column (g = 1).
        self._channel_changes: dict[str, ChangeAlongTrajectory] = {}
        # Quantities of spline terms by name, shape (n,) each: at the "nodes" and in the "middle" of steps.
        self._quantities: dict[str, dict[str, Floats]] = {}
        # Direction in which each axis was last seen to turn, (n, 3).
        self._directions: Floats = linear.reference.directions[linear.reference.rows]

    def release(self) -> None:
        """Free the memory of cached channels and quantities; they are computed again when needed."""
        self._channel_changes.clear()
        self._quantities.clear()

    def signals(self, candidate: Candidate) -> CandidateSignals:
        """Compute the change of the flight by one unit of each coefficient of a candidate."""
        if candidate.is_spline:
            return self.spline_signals(candidate)
        if candidate.effect.delay:
            return CandidateSignals(self._delayed_rates(candidate), None)
        extended_model = self._functions.extended(candidate.id, candidate.effect, candidate.linear_parameters)
        values = candidate.effect.values_in(self.linear.reference.record.label, candidate.effect.values)
        rates, measured_rad = extended_model.run(self.linear.trajectory, values, self._directions)
        if not np.any(measured_rad):
            return CandidateSignals(rates, None)
        # Encoders are read at the beginning of a step, rates change in its middle.
        at_nodes = extended_model.run(self.linear.nodes, values, self._directions)
        return CandidateSignals(rates, at_nodes.measured_rad)

    def spline_signals(self, candidate: Candidate) -> CandidateSignals:
        """Compute the change of the flight by one unit of each coefficient of a spline term."""
        term = candidate.effect
        assert isinstance(term, SplineTerm)
        rates, measured_rad = self.influence(term)
        instant = "nodes" if term.channel.startswith("measurement") else "middle"
        if instant not in self._quantities:
            trajectory = self.linear.nodes if instant == "nodes" else self.linear.trajectory
            self._quantities[instant] = quantity_values(self.model, trajectory)
        basis = bspline_basis(self._quantities[instant][term.on], *term.knots)[:, None, :]  # (n, 1, KNOTS)
        return CandidateSignals(rates * basis, measured_rad * basis if np.any(measured_rad) else None)

    def influence(self, term: SplineTerm) -> ChangeAlongTrajectory:
        """Return the change of the flight by one unit on a channel, such as 1 N m about pitch."""
        if term.channel not in self._channel_changes:
            extended_model = self._functions.extended(f"spline:{term.channel}", term, ())
            # The basis functions add up to 1: with all coefficients 1 the term is 1, whatever its quantity.
            values = {**extended_model.effect.values, **dict.fromkeys(extended_model.effect.priors, 1.0)}
            self._channel_changes[term.channel] = extended_model.run(
                self.linear.trajectory, values, self._directions
            )
        return self._channel_changes[term.channel]

    def _delayed_rates(self, candidate: Candidate) -> Floats:
        """Return the changes of the rates by delayed voltages, shape (n, states, 1)."""
        # The logged voltages are averaged over a step of the trajectory, then interpolated at delayed times.
        # The change is taken between two interpolations, so that averaging itself changes nothing.
        trajectory, record = self.linear.trajectory, self.linear.reference.record
        # A logged voltage is held over its row, so it counts at the middle of the row.
        row_middle_s = record.t_s - record.t_s[0] + 0.5 * record.step_s
        rows_per_step = max(1, round(trajectory.step_s / record.step_s))
        moving_mean = np.ones(rows_per_step) / rows_per_step
        mean_inputs = [np.convolve(column, moving_mean, mode="same") for column in record.inputs.T]

        def rates_with_delay(delay_s: float) -> Floats:
            """Return the rates if the voltages act later by `delay_s`."""
            times_s = trajectory.t_s - delay_s
            inputs = np.column_stack([np.interp(times_s, row_middle_s, column) for column in mean_inputs])
            (rates,) = self._functions.rates(replace(trajectory, inputs=inputs))
            return rates

        delay_s = candidate.effect.values[candidate.effect.delay]
        return rates_with_delay(delay_s) - rates_with_delay(0.0)


class _Symbols(NamedTuple):
    """CasADi symbols on which the equations of an extended model depend."""

    # The states of the model, `x`, and those of the effect, `z`, are separate symbols. Trajectories contain
    # `x` only; `z` is integrated along them. `extended_x` has the symbols of both, in the order of the
    # extended model. `u` are the voltages, `p` the parameters of the extended model, and `t` is the time.

    x: ca.SX
    z: ca.SX
    u: ca.SX
    p: ca.SX
    t: ca.SX
    extended_x: ca.SX


class ExtendedModel:
    """A model with one more effect, which computes how the effect changes rates and measured angles."""

    # An effect that is linear in some parameters is described by derivatives: the change by one unit of each.
    # Any other effect is described by a difference: the model with it less the model without it.

    def __init__(self, model: Model, effect: Effect, linear_parameters: Sequence[str]) -> None:
        self.model, self.linear_parameters = model, linear_parameters
        self.effect = effect = effect.with_measured_angles()
        self.extended_model = type(model)((*model.effects, effect))
        # Places of parameters and states of the model and of the effect among those of the extended model.
        names = self.extended_model.parameter_names
        self._model_parameters = [names.index(quantity.name) for quantity in model.parameters]
        self._effect_parameters = {
            quantity.name: names.index(quantity.name) for quantity in effect.parameters
        }
        state_names = [state.name for state in self.extended_model.states]
        self._model_states = [state_names.index(state.name) for state in model.states]
        self._effect_states = [state_names.index(state.name) for state in effect.states]
        symbols = self._symbols()
        self._change = self._compiled_change(symbols)
        self.effect_states = self._compiled_effect_states(symbols) if effect.states else None

    def _symbols(self) -> _Symbols:
        """Return symbols for states, voltages, parameters and time."""
        x, z = ca.SX.sym("x", len(self._model_states)), ca.SX.sym("z", len(self._effect_states))
        extended_x = ca.SX(len(self.extended_model.states), 1)
        for symbol, places in ((x, self._model_states), (z, self._effect_states)):
            for i, place in enumerate(places):
                extended_x[place] = symbol[i]
        p = ca.SX.sym("p", len(self.extended_model.parameters))
        return _Symbols(x, z, ca.SX.sym("u", 2), p, ca.SX.sym("t"), extended_x)

    def _compiled_change(self, symbols: _Symbols) -> AlongTrajectory:
        """Compile the changes of the rates of the model's states, and of the measured angles."""
        x, z, u, p, t, extended_x = symbols
        rates = _rows(self.extended_model.dynamics(extended_x, u, p, t), self._model_states)
        angles = self.extended_model.measurement(extended_x, u, p, t)
        if self.linear_parameters:
            coefficients = _rows(p, [self._effect_parameters[name] for name in self.linear_parameters])
            changes = [ca.jacobian(rates, coefficients), ca.jacobian(angles, coefficients)]
        else:
            model_p = _rows(p, self._model_parameters)
            changes = [
                rates - self.model.dynamics(x, u, model_p, t),
                angles - self.model.measurement(x, u, model_p, t),
            ]
        arguments = [ca.vertcat(x, z), u, t, p]
        return AlongTrajectory(ca.Function("change", arguments, [ca.densify(change) for change in changes]))

    def _compiled_effect_states(self, symbols: _Symbols) -> EffectStates:
        """Compile the rates of the effect's states, and their jumps at the end of a step."""
        x, z, u, p, t, extended_x = symbols
        rates = _rows(self.extended_model.dynamics(extended_x, u, p, t), self._effect_states)
        resets = _rows(self.extended_model.reset_map(extended_x, u, p, t), self._effect_states)
        arguments = [z, t, x, u, p]
        return EffectStates(
            ca.Function("rates", arguments, [ca.densify(rates)]),
            ca.Function("resets", arguments, [ca.densify(resets)]),
        )

    def run(
        self, trajectory: Trajectory, values: Mapping[str, float], directions: Floats | None = None
    ) -> ChangeAlongTrajectory:
        """Evaluate the changes by the effect along a trajectory. Shapes: `directions` (n, 3)."""
        parameters = np.empty(len(self.extended_model.parameters))
        parameters[self._model_parameters] = trajectory.parameters
        for name, place in self._effect_parameters.items():
            parameters[place] = values[name]
        state = trajectory.state
        if self.effect_states is not None:
            # States in the middle of each step, (n, effect states), from rest at the beginning of the flight.
            middle_substep = EFFECT_SUBSTEPS // 2 - 1
            effect_states = self.effect_states.integrate(
                replace(trajectory, parameters=parameters), middle_substep
            )
            for column, axis in known_directions([self.effect]):
                if directions is not None:
                    effect_states[:, column] = directions[:, axis]
            state = np.column_stack((state, effect_states))
        rates, measured_rad = self._change(
            Trajectory(trajectory.t_s, state, trajectory.inputs, trajectory.step_s, parameters)
        )
        return ChangeAlongTrajectory(rates, measured_rad)


def _rows(column: ca.SX, rows: Sequence[int]) -> ca.SX:
    """Return some rows of a column of symbols, in the order of `rows`."""
    return ca.vertcat(*(column[row] for row in rows))


def spline_candidates(linearised_flights: Sequence[LinearisedFlight], number: int = 0) -> list[Candidate]:
    """Make the spline terms of all channels on all quantities."""
    model = linearised_flights[0].model.source
    quantities_by_flight = [quantity_values(model, linear.trajectory) for linear in linearised_flights]
    candidates = []
    for channel, quantity in channel_quantity_pairs():
        low, step = knot_span(np.concatenate([values[quantity] for values in quantities_by_flight]))
        if step * (KNOTS - 1) < _MIN_RANGE:
            continue
        candidates.append(spline_candidate(spline_term(channel, quantity, low, step, number)))
    return candidates


def spline_candidate(term: SplineTerm) -> Candidate:
    """Make a candidate of a spline `term`."""
    return Candidate(f"spline:{term.channel}:{term.on}", term, tuple(term.priors))
