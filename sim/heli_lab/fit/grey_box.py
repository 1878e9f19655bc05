"""The interface of the estimation core: a grey-box model, its disturbances, and recordings.

A grey-box model is a set of stochastic differential equations with unknown parameters, measured at discrete
times. Its disturbances are random changes of parameters, as Gauss-Markov states of the filter.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, Protocol

import casadi as ca
import numpy as np
from heli_host.data.arrays import Floats

SLOW_CORRELATION_TIME_s: Final = 15.0
"""Correlation time of the slow disturbance. It is set, not estimated, because a recording of a minute
does not show it: a quarter of a minute. Longer: a constant torque of each flight has the same effect.
Shorter: the fast disturbance has the same effect."""

START_CORRELATION_TIME_s: Final = 0.5
START_QUANTISATION: Final = 0.6
"""Start of a search, set by judgement: the middle of the values of recorded flights."""


@dataclass(frozen=True)
class GainDisturbance:
    """A first-order Gauss-Markov disturbance that varies a gain by a share of it.

    The defaults are the start of a search: within the range of supplies and rotor wash.

    Parameters
    ----------
    std : float
        Stationary standard deviation, as a share of the gain.
    correlation_time_s : float
        Time over which the autocorrelation falls to 1/e.
    """

    std: float = 0.02
    correlation_time_s: float = 1.0


@dataclass(frozen=True)
class DisturbanceModel:
    """Random disturbances of a machine with m outputs and g gains, and the noise of its sensors.

    A fast and a slow first-order Gauss-Markov disturbance act on each output, and one on each gain.

    Parameters
    ----------
    fast_std : ndarray (m,)
        Stationary standard deviation of the fast disturbance, in the unit of the disturbed parameter.
    correlation_time_s : ndarray (m,)
        Time over which the autocorrelation of the fast disturbance falls to 1/e.
    slow_std : ndarray (m,)
        Stationary standard deviation of the slow disturbance, whose correlation time is
        `SLOW_CORRELATION_TIME_s`.
    quantisation : ndarray (m,)
        Variance of the errors of each output, divided by that of independent, uniform rounding errors.
    gains : tuple of GainDisturbance
        Disturbances of the gains, in the order of the model's inputs.
    curvature : ndarray (4 m + 2 g, 4 m + 2 g) or None
        Negative second derivatives of the log-likelihood to the property `logarithms`, at the estimate; 0
        between different disturbances. None if they are unknown.
    """

    fast_std: Floats
    correlation_time_s: Floats
    slow_std: Floats
    quantisation: Floats
    gains: tuple[GainDisturbance, ...] = ()
    curvature: Floats | None = None

    @classmethod
    def start(cls, fast_std: Sequence[float], slow_std: Sequence[float]) -> DisturbanceModel:
        """Return the disturbances from which a search starts.

        Parameters
        ----------
        fast_std, slow_std : sequence of float
            Standard deviations of the m disturbances, in the unit of the disturbed parameters.
        """
        size = len(fast_std)
        return cls(
            np.array(fast_std, float),
            np.full(size, START_CORRELATION_TIME_s),
            np.array(slow_std, float),
            np.full(size, START_QUANTISATION),
        )

    def with_gains(self, gains: int) -> DisturbanceModel:
        """Return the same disturbances with those of `gains` gains at the start of a search."""
        return replace(self, curvature=None, gains=(GainDisturbance(),) * gains)

    @property
    def logarithms(self) -> Floats:
        """Logarithms of all parameters: four for each output, then two for each gain."""
        outputs = np.stack((self.fast_std, self.correlation_time_s, self.slow_std, self.quantisation), axis=1)
        gains = [value for gain in self.gains for value in (gain.std, gain.correlation_time_s)]
        return np.log(np.concatenate((outputs.ravel(), gains)))

    def with_logarithms(self, logarithms: Floats, curvature: Floats | None = None) -> DisturbanceModel:
        """Return disturbances of the same outputs and gains with other parameters.

        Parameters
        ----------
        logarithms : ndarray (4 m + 2 g,)
            Logarithms of the parameters, in the order of the property `logarithms`.
        curvature : ndarray (4 m + 2 g, 4 m + 2 g), optional
            Curvature of the log-likelihood at these parameters.
        """
        values = np.exp(logarithms)
        outputs, gains = np.split(values, [4 * len(self.fast_std)])
        fast_std, correlation_time_s, slow_std, quantisation = outputs.reshape(-1, 4).T
        return DisturbanceModel(
            fast_std,
            correlation_time_s,
            slow_std,
            quantisation,
            tuple(GainDisturbance(*gain) for gain in gains.reshape(-1, 2).tolist()),
            curvature,
        )

    def autocorrelation(self, step_s: float) -> Floats:
        """Return the autocorrelation of each disturbance over a step of `step_s` [s].

        Returns
        -------
        ndarray (2 (m + g),)
            First the fast disturbances of the outputs and those of the gains, then the slow disturbances of
            the outputs. The filter has a slow disturbance of each gain, too, whose variance is 0.
        """
        gains_s = [gain.correlation_time_s for gain in self.gains]
        slow_s = np.full(len(self.fast_std) + len(gains_s), SLOW_CORRELATION_TIME_s)
        return np.exp(-step_s / np.concatenate((self.correlation_time_s, gains_s, slow_s)))

    @property
    def variance(self) -> Floats:
        """Stationary variance of each disturbance, in the order of `autocorrelation`."""
        gains = [gain.std for gain in self.gains]
        return np.concatenate((self.fast_std, gains, self.slow_std, np.zeros(len(gains)))) ** 2


Equations = Callable[[ca.SX, ca.SX, ca.SX, ca.SX], ca.SX]
"""Function of state, inputs, parameters and time since the recording's first sample (s), as columns."""


class Recording(Protocol):
    """Inputs and outputs of a machine, sampled at even times."""

    @property
    def label(self) -> str:
        """Name for messages."""

    @property
    def t_s(self) -> Floats:
        """Times, shape (n,)."""

    @property
    def step_s(self) -> float:
        """Time from one row to the next."""

    @property
    def outputs(self) -> Floats:
        """Measured outputs, shape (n, m)."""

    @property
    def inputs(self) -> Floats:
        """Inputs that act from each row to the next, shape (n, inputs)."""

    @property
    def resolution(self) -> Floats:
        """One count of each sensor, in the unit of its output, shape (m,)."""

    @property
    def segments(self) -> tuple[tuple[int, int], ...]:
        """First row and last row plus one of each part to use."""


@dataclass(frozen=True)
class ActingInputs:
    """Inputs as they act in each step of a reference trajectory.

    Parameters
    ----------
    mean : ndarray (n, inputs)
        Mean over each step.
    input_derivatives : tuple of (str, ndarray (n, inputs))
        Parameters that change the inputs before they act, such as a delay: name, and derivative of `mean` by
        the parameter.
    """

    mean: Floats
    input_derivatives: tuple[tuple[str, Floats], ...] = ()


def mean_inputs(
    recording: Recording, every: int, count: int, parameters: Floats, free: Collection[str]
) -> ActingInputs:
    """Average the recorded inputs over each step, for a model whose inputs act without delay. Shapes:
    `parameters` (p,).
    """
    rows = recording.inputs[: every * count]
    return ActingInputs(rows.reshape(count, every, rows.shape[1]).mean(axis=1))


@dataclass(frozen=True)
class GreyBoxModel:
    """A stochastic state-space model with unknown parameters.

    Parameters
    ----------
    states : tuple of str
        Positions first, one for each output, then their rates in the same order, then any others. An output
        measures its position, up to what the `measurement` adds.
    inputs, outputs, parameters : tuple of str
        Names; `m` is the number of outputs.
    disturbed : tuple of str
        First, for each output, the parameter to which its disturbance is added; this output must respond most
        to it. Then any number of gains: parameters with the value 0 whose disturbances are relative and may
        change all outputs.
    dynamics : callable
        Rates of the states, shape (states, 1).
    measurement : callable
        Outputs, shape (m, 1).
    reset_map : callable
        State after the jump at the end of each step, shape (states, 1). Positions and rates must not jump.
    initial_std : ndarray (states,)
        Standard deviation of the state at the beginning of a window, about the reference trajectory.
    disturbance_start : DisturbanceModel
        Start of the search for the disturbances.
    disturbance_std_range : (float, float)
        Smallest and largest standard deviation of that search, in the unit of the disturbed parameters.
    acting_inputs : callable
        Computes the inputs that act from the recorded ones, like `mean_inputs`.
    known_directions : tuple of (int, int)
        States that hold the direction in which an output moved last: number of the state, counted from the
        first one after the rates, and number of the output.
    source : object
        Description of the machine for the caller, not used here.
    """

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    parameters: tuple[str, ...]
    disturbed: tuple[str, ...]
    dynamics: Equations
    measurement: Equations
    reset_map: Equations
    initial_std: Floats
    disturbance_start: DisturbanceModel
    disturbance_std_range: tuple[float, float]
    acting_inputs: Callable[[Recording, int, int, Floats, Collection[str]], ActingInputs] = mean_inputs
    known_directions: tuple[tuple[int, int], ...] = ()
    source: Any = None

    def __post_init__(self) -> None:
        if len(self.states) < self.followed or len(self.disturbed) < len(self.outputs):
            raise ValueError("a model needs a position, a rate and a disturbance for each of its outputs")

    @property
    def followed(self) -> int:
        """Number of states in a reference trajectory: positions and rates."""
        return 2 * len(self.outputs)

    @property
    def extra_states(self) -> int:
        """Number of states after positions and rates."""
        return len(self.states) - self.followed


def no_reset(x: ca.SX, u: ca.SX, p: ca.SX, t: ca.SX) -> ca.SX:
    """Return the state `x` unchanged, as the reset map of models without jumps; inputs `u`, parameters `p`
    and time `t` have no effect.
    """
    return x


def quantisation_std(recording: Recording) -> Floats:
    """Return the standard deviation of each output's rounding to counts, shape (m,): a count / sqrt(12)
    (Widrow and Kollar, Quantization Noise, 2008).
    """
    return recording.resolution / math.sqrt(12.0)
