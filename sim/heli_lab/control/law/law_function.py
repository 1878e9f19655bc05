"""A control law as a function of symbols, with names and values of its states and parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import casadi as ca
from heli_host.board.law_program import check_number, divisor_of
from heli_host.declaration import CHANNELS, LAW_SIGNALS
from heli_host.errors import BadLaw

MAX_STATES: Final = 255
"""Largest number of states, and of parameters, that a board stores."""
LONGEST_NAME: Final = 63
"""Longest name that MATLAB accepts."""


@dataclass(frozen=True)
class LawFunction:
    """A control law as a function of symbols.

    Parameters
    ----------
    name : str
        Name of the law for readers.
    rate_Hz : float
        Calls per second [Hz]: 1000 divided by a whole number.
    function : casadi.Function
        Function of inputs (17), states (n) and parameters (m). It returns outputs (2 voltages, 3 setpoints,
        signals) and new states (n).
    states, parameters : dict of str to float
        Initial values of the states and present values of the parameters, by name.
    signals : tuple of str
        Names of the signals.
    """

    name: str
    rate_Hz: float
    function: ca.Function
    states: dict[str, float] = field(default_factory=dict)
    parameters: dict[str, float] = field(default_factory=dict)
    signals: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Raise a BadLaw if a board cannot have this rate, these signals, states or parameters."""
        divisor_of(self.rate_Hz)
        _check_signals(self.signals)
        _check_values("state", self.states, "reduce the order")
        _check_values("parameter", self.parameters, "write as numbers what is not changed in flight")

    @property
    def dt_s(self) -> float:
        """Time from one call to the next [s]."""
        return 1.0 / self.rate_Hz


def _check_signals(signals: Sequence[str]) -> None:
    """Raise a BadLaw if there are too many signals, or if a name cannot be that of a column in a log."""
    if len(signals) > LAW_SIGNALS:
        raise BadLaw(f"{len(signals)} signals are too many", f"give at most {LAW_SIGNALS}")
    reserved = {spec.column for spec in CHANNELS} | {"t_s", "tick"}
    for signal in signals:
        is_name = signal.isidentifier() and signal.isascii() and len(signal) <= LONGEST_NAME
        if not is_name or signal in reserved:
            raise BadLaw(
                f"a signal cannot be named {signal[:LONGEST_NAME]!r}",
                f"give letters, digits and _, at most {LONGEST_NAME}, and not the name of a channel",
            )


def _check_values(kind: str, values: Mapping[str, float], remedy: str) -> None:
    """Raise a BadLaw if there are too many states or parameters, or if a value is not a number of the
    board.
    """
    if len(values) > MAX_STATES:
        raise BadLaw(
            f"{len(values)} {kind}s are too many for a board", f"give at most {MAX_STATES}: {remedy}"
        )
    for name, value in values.items():
        check_number(f"{kind} {name}", value)


def casadi_function(
    inputs: ca.SX, states: ca.SX, parameters: ca.SX, outputs: Sequence[ca.SX], new_states: Sequence[ca.SX]
) -> ca.Function:
    """Return the CasADi function of a law, as `LawFunction` describes it, from its symbols and results."""
    return ca.Function(
        "law",
        [inputs, states, parameters],
        [ca.densify(column_of(outputs)), ca.densify(column_of(new_states))],
        ["inputs", "states", "parameters"],
        ["outputs", "new_states"],
    )


def column_of(scalars: Sequence[ca.SX]) -> ca.SX:
    """Return a column of `scalars`, shape (n, 1); n may be 0, which `casadi.vertcat` does not accept."""
    return ca.vertcat(*scalars) if scalars else ca.SX(0, 1)
