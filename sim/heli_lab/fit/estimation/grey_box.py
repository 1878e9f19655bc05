"""The interface of the estimation core: a grey-box model, and the recordings that it is estimated from.

A grey-box model is a set of stochastic differential equations with unknown parameters, measured at discrete
times (Kristensen, Madsen and Jorgensen, Automatica 40, 2004, eq. 1 and 2):

    dx/dt = f(x, u, p, t) + disturbances,    y_k = h(x_k, u_k, p, t_k) + e_k.

Each disturbance is added to one parameter of the model, such as a constant torque.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass
from typing import Any, Protocol

import casadi as ca
from heli_host.data.arrays import Floats

from heli_lab.fit.estimation.disturbances import DisturbanceModel

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
