"""A proposed equation: its parameters and confidence, and where in the flights it matters."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from heli_host.data.arrays import Floats
from heli_sim.model.parts import AXES

from heli_lab.explain.discover.discovery import Discovery
from heli_lab.explain.discover.effect_contribution import accelerations
from heli_lab.explain.discover.equation import Equation
from heli_lab.explain.discover.notation import effect_file, sentence
from heli_lab.explain.discover.scoring import TermSignals
from heli_lab.explain.discover.terms import SYMBOLS
from heli_lab.explain.search.screening import Screening
from heli_lab.explain.thresholds import (
    CONFIDENCE_NATS,
    EQUATION_MAX_UNCONFIRMED,
    EQUATION_SUPPORT_SHARE,
    HELD_OUT_NATS,
    MAX_CONFIDENCE,
)
from heli_lab.fit.innovations import smoothed_disturbances


@dataclass(frozen=True)
class SupportedRange:
    """Part of the fitted flights in which an equation matters on one channel."""

    channel: str  # Channel on which it acts
    rms: float
    """rms, largest: Root mean square and largest value of its terms less their mean, in the channel's unit.
    """
    largest: float
    ranges: Mapping[str, tuple[float, float]]
    """Range of each quantity of the equation in which the terms are at least half of their largest value: 5 %
    and 95 % quantiles over time, SI units."""
    share: float  # Share of the flight time in which the terms are that large, 0 to 1


@dataclass(frozen=True)
class TermTrace:
    """Torque of an equation along a flight, and the torque that the model without it lacks."""

    label: str  # label, axis: Name of the flight, and axis about which the equation acts most
    axis: str
    t_s: Floats  # (n,): Times since the first sample of the flight
    term_Nm: Floats
    """term_Nm, missing_Nm, std_Nm: (n,): Torque of the equation; smoothed torque that the model without it
    lacks, and its standard error; both torques less their means."""
    missing_Nm: Floats
    std_Nm: Floats
    on: str  # on, unit: First quantity that the equation depends on, and its unit
    unit: str
    value: Floats  # (n,): Values of the quantity


@dataclass(frozen=True)
class ProposedTerm:
    """An equation proposed for what no effect of the catalogue explains."""

    discovery: Discovery  # The equation, its evidence and its rivals
    supported: tuple[SupportedRange, ...]  # Where in the fitted flights it matters, by channel
    trace: TermTrace
    """The equation along the first held-out flight, or along the first fitted flight if none is held out."""

    @property
    def equation(self) -> Equation:
        """The terms."""
        return self.discovery.equation

    @property
    def numbers(self) -> dict[str, float]:
        """Values of the parameters, by name without prefix."""
        return {name: parameter.value for name, parameter in self.discovery.values.items()}

    @property
    def confidence(self) -> float:
        """Probability, 0 to 1, that the form of the equation is right.

        It grows with the lead over the closest rival, which may be the model without an equation, and with
        the log-likelihood ratio on the held-out flights.
        """
        discovery = self.discovery
        rivals = [rival.log_likelihood_ratio for rival in discovery.rivals]
        margin = max(0.0, min([discovery.train - discovery.penalty, *rivals]))
        probability = 1.0 - 0.5 * math.exp(-margin / CONFIDENCE_NATS)
        if discovery.held_out is None:
            return min(EQUATION_MAX_UNCONFIRMED, probability)
        probability /= 1.0 + math.exp(-discovery.held_out / HELD_OUT_NATS)
        return float(min(MAX_CONFIDENCE, probability))

    def effect_file(self, head: str) -> str:
        """Write the equation as an effect file; `head` is its docstring."""
        return effect_file(self.discovery.effect, self.discovery.values, head)

    @property
    def sentence(self) -> str:
        """The equation with values and units, such as ``torque.pitch = 0.05*elevation N m``."""
        return sentence(self.equation, self.numbers)


def proposed_term(discovery: Discovery) -> ProposedTerm:
    """Propose the equation of a `discovery`: evaluate it along the flights."""
    return ProposedTerm(discovery, supported_ranges(discovery), term_trace(discovery))


def term_trace(discovery: Discovery) -> TermTrace:
    """Compare, along a flight, the torque of the equation of a `discovery` with the missing torque.

    The missing torque is the one that the model without the equation lacks. Both are about the axis on which
    the equation acts most. The flight is the first held-out flight, or the first fitted flight without one.
    """
    without_equation, with_equation = discovery.elsewhere or (
        discovery.base.estimate,
        discovery.hypothesis.estimate,
    )
    step_s, change_rad_s2 = accelerations(with_equation, discovery.effect.name)
    signals = TermSignals(Screening(with_equation))
    torque_Nm = signals.linearised_flights[0].disturbance_for(change_rad_s2)
    axis = int(np.argmax(torque_Nm.std(axis=0)))
    # The smoother has one row per measurement of the filter, the equation one per step.
    t_s, missing_Nm, std_Nm = smoothed_disturbances(
        without_equation.filtered(), without_equation.disturbances
    )[0]
    term_Nm = np.interp(t_s, step_s, torque_Nm[:, axis])
    quantity = discovery.equation.terms[0].term.quantities[-1]
    return TermTrace(
        label=with_equation.references[0].record.label,
        axis=AXES[axis],
        t_s=t_s,
        term_Nm=term_Nm - term_Nm.mean(),
        missing_Nm=missing_Nm[:, axis] - missing_Nm[:, axis].mean(),
        std_Nm=std_Nm[:, axis],
        on=quantity,
        unit=str(SYMBOLS[quantity].unit),
        value=np.interp(t_s, step_s, _rotor_mean(signals.quantity(0, quantity))),
    )


def supported_ranges(discovery: Discovery) -> tuple[SupportedRange, ...]:
    """Find where in the fitted flights the equation of a `discovery` matters, by channel."""
    signals = TermSignals(Screening(discovery.hypothesis.estimate))
    flights = range(len(signals.linearised_flights))
    result = []
    for channel in discovery.equation.channels:
        magnitude = np.concatenate(
            [np.abs(_channel_sum_along(discovery, signals, i, channel)).max(axis=1) for i in flights]
        )
        largest = float(np.quantile(magnitude, 0.99))
        is_active = magnitude >= EQUATION_SUPPORT_SHARE * largest
        channel_terms = [term.term for term in discovery.equation.terms if term.channel == channel]
        names = dict.fromkeys(name for term in channel_terms for name in term.quantities)
        ranges = {}
        for name in names:
            values = np.concatenate([_rotor_mean(signals.quantity(i, name)) for i in flights])
            low, high = np.quantile(values[is_active], [0.05, 0.95])
            ranges[name] = (float(low), float(high))
        rms = float(np.sqrt(np.mean(magnitude**2)))
        result.append(
            SupportedRange(channel, rms, largest=largest, ranges=ranges, share=float(is_active.mean()))
        )
    return tuple(result)


def _rotor_mean(values: Floats) -> Floats:
    """Return values of a quantity, shape (n,); if each rotor has its own, (n, 2), their mean."""
    return values if values.ndim == 1 else np.asarray(values.mean(axis=1))


def _channel_sum_along(discovery: Discovery, signals: TermSignals, index: int, channel: str) -> Floats:
    """Return the sum of the terms on a channel along a flight, less its mean.

    The shape is (n, 1), or (n, 2) if each rotor has its own values.
    """
    total: Floats = np.zeros((1, 1))
    values = discovery.values
    for i, term in enumerate(discovery.equation.terms):
        if term.channel == channel:
            signal = signals.values(index, discovery.with_estimated_parameters(i))
            total = total + values[discovery.equation.coefficient(i)].value * signal
    return np.asarray(total - total.mean(axis=0), float)
