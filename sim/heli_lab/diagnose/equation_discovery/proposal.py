"""A proposed law as a result: numbers, confidence, where it matters, what it gains, in JSON and in words."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from heli_host.arrays import Floats
from heli_sim.model.effects import EffectKind
from heli_sim.model.parts import AXES

from heli_lab.diagnose.effect_contribution import accelerations
from heli_lab.diagnose.equation_discovery.discover import discover
from heli_lab.diagnose.equation_discovery.discovery import Discovery
from heli_lab.diagnose.equation_discovery.equation import CHANNELS, Equation
from heli_lab.diagnose.equation_discovery.notation import effect_file, expression, latex, sentence
from heli_lab.diagnose.equation_discovery.scoring import Courses
from heli_lab.diagnose.equation_discovery.terms import QUANTITIES
from heli_lab.diagnose.error_reduction import ErrorReduction, judgement
from heli_lab.diagnose.free_run import FreeRun, free_runs
from heli_lab.diagnose.model_comparison import Hypothesis, ModelComparison
from heli_lab.diagnose.prediction import Prediction, predict
from heli_lab.diagnose.screening import Screening
from heli_lab.diagnose.thresholds import (
    CONFIDENCE_NATS,
    HELD_OUT_NATS,
    LAW_UNCONFIRMED,
    MAX_CONFIDENCE,
)

_MATTERS: Final = 0.5
"""Share of a law's largest value from which on a moment counts as one at which it matters."""


@dataclass(frozen=True)
class SupportedRange:
    """Where in the flights a law matters.

    Parameters
    ----------
    channel : str
        Where it acts.
    rms, largest : float
        Of what it adds about its mean in the flights fitted, in the channel's unit.
    ranges : Mapping[str, (float, float)]
        Of each quantity that it depends on, the values that it has in the nine tenths in the middle of those
        moments at which the law is at least half of its largest.
    share : float
        Share of the time that these moments are.
    """

    channel: str
    rms: float
    largest: float
    ranges: Mapping[str, tuple[float, float]]
    share: float


@dataclass(frozen=True)
class TermTrace:
    """A law along a flight, beside what the model without it lacks.

    Parameters
    ----------
    label, axis : str
        The flight, and the axis about which the law acts most.
    t_s : ndarray (n,)
        Times since the flight's first sample.
    law_Nm, missing_Nm, std_Nm : ndarray (n,)
        Torque that the law makes; torque that the model without it lacks, and its standard error; both about
        their means.
    on, unit : str
        The first quantity that the law depends on, and its unit.
    value : ndarray (n,)
        That quantity.
    """

    label: str
    axis: str
    t_s: Floats
    law_Nm: Floats
    missing_Nm: Floats
    std_Nm: Floats
    on: str
    unit: str
    value: Floats


@dataclass(frozen=True)
class ProposedTerm:
    """The law of what is on no list, proposed.

    Parameters
    ----------
    discovery : Discovery
        The law, its evidence and its rivals.
    prediction : Prediction
        Free runs of the model with it.
    gains : Mapping[str, ErrorReduction]
        Errors over 2 s of the baseline and with the law, by axis, on the flights held out.
    matters : tuple of SupportedRange
        Where it matters, for each channel.
    reference : TermTrace
        The law along the first flight held out, or where none was the first one fitted.
    """

    discovery: Discovery
    prediction: Prediction
    gains: Mapping[str, ErrorReduction]
    matters: tuple[SupportedRange, ...]
    reference: TermTrace

    @property
    def equation(self) -> Equation:
        """Its terms."""
        return self.discovery.equation

    @property
    def numbers(self) -> dict[str, float]:
        """Values of its numbers."""
        return {name: value for name, (value, _, _) in self.discovery.values.items()}

    @property
    def confidence(self) -> float:
        """How sure the form is, 0 to 1: how far the law is ahead of nothing and of its closest rival, and
        whether the flights held out confirm it.
        """
        discovery = self.discovery
        rivals = [rival.log_likelihood_ratio for rival in discovery.rivals]
        margin = max(0.0, min([discovery.train - discovery.penalty, *rivals]))
        sure = 1.0 - 0.5 * math.exp(-margin / CONFIDENCE_NATS)
        if discovery.held_out is None:
            return min(LAW_UNCONFIRMED, sure)
        sure /= 1.0 + math.exp(-discovery.held_out / HELD_OUT_NATS)
        return float(min(MAX_CONFIDENCE, sure))

    def effect_file(self, head: str) -> str:
        """The law as an effect file; `head` says where it comes from."""
        return effect_file(self.discovery.effect, self.discovery.values, head)

    @property
    def sentence(self) -> str:
        """What it adds to each channel, with its numbers."""
        return sentence(self.equation, self.numbers)

    def lines(self) -> list[str]:
        """The law for a terminal, a line each."""
        discovery = self.discovery
        confirmed = (
            "no other flight confirms it"
            if discovery.held_out is None
            else f"{discovery.held_out:.0f} held out"
        )
        lines = [
            f"proposed law: {self.sentence} (confidence {self.confidence:.2f}; "
            f"{discovery.train:.0f} nats on the flights fitted, {confirmed})"
        ]
        for name, (value, std, unit) in discovery.values.items():
            error = f" +- {std:.2g}" if std else ""
            lines.append(f"  {name} = {value:.4g}{error} {'' if unit == '1' else unit}".rstrip())
        close = [rival.key for rival in discovery.rivals if rival.log_likelihood_ratio < CONFIDENCE_NATS]
        if close:
            lines.append(f"  nearly as likely on these flights: {'; '.join(close)}")
        for axis, gain in self.gains.items():
            if gain.ratio < 0.9:
                lines.append(f"  with it {axis} is off by {gain.after_deg:.3g} deg, ratio {gain.ratio:.2f}")
        if discovery.superfluous:
            lines.append(f"  beside it nothing needs {', '.join(discovery.superfluous)}")
        return lines

    def to_json(self) -> dict[str, Any]:
        """The law for other programs; docs/diagnosing.md describes the keys."""
        discovery, equation = self.discovery, self.equation
        symbols = {q for term in equation.terms for q in term.term.quantities}
        channel = equation.channels[0]
        return {
            "effect": discovery.effect.name,
            "channel": channel,
            "unit": CHANNELS[channel][0],
            "expression": expression(equation, channel),
            "expression_with_numbers": expression(equation, channel, self.numbers),
            "further_channels": [
                {
                    "channel": further,
                    "unit": CHANNELS[further][0],
                    "expression": expression(equation, further),
                    "expression_with_numbers": expression(equation, further, self.numbers),
                }
                for further in equation.channels[1:]
            ],
            "symbols": {name: str(QUANTITIES[name].unit) for name in sorted(symbols)},
            "latex": latex(equation),
            "numbers": {
                name: {"value": value, "std": std, "unit": unit}
                for name, (value, std, unit) in discovery.values.items()
            },
            "confidence": round(self.confidence, 3),
            "sentence": self.sentence,
            "evidence": {
                "log_likelihood_ratio_train": discovery.train,
                "log_likelihood_ratio_held_out": discovery.held_out,
                "log_likelihood_ratio_of_curves": discovery.curve,
                "penalty": discovery.penalty,
                "terms_tried": discovery.tried,
            },
            "rivals": [
                {"term": rival.key, "log_likelihood_ratio": rival.log_likelihood_ratio}
                for rival in discovery.rivals
            ],
            "superfluous": list(discovery.superfluous),
            "matters": [
                {
                    "channel": supported.channel,
                    "rms": supported.rms,
                    "largest": supported.largest,
                    "share_of_time": supported.share,
                    "ranges": {name: list(span) for name, span in supported.ranges.items()},
                }
                for supported in self.matters
            ],
            "gain": {
                axis: {
                    "before": gain.before_deg,
                    "after": gain.after_deg,
                    "ratio": gain.ratio,
                    "interval95": list(gain.interval95),
                }
                for axis, gain in self.gains.items()
            },
        }


def propose_term(
    comparison: ModelComparison,
    base: Hypothesis,
    curve: Hypothesis | None,
    kinds: Mapping[str, EffectKind],
    runs_before: Sequence[FreeRun],
    calibrate_s: float | None,
    seed: int,
    refits: float,
    say: Callable[[str, float], None],
) -> ProposedTerm | None:
    """Look for a law, and measure what it gains on the flights held out; None where there is none.

    Parameters
    ----------
    comparison : ModelComparison
        The flights.
    base : Hypothesis
        The model with the causes that were named.
    curve : Hypothesis, optional
        The same with curves in the place of what is missing.
    kinds : Mapping[str, EffectKind]
        The catalogue.
    runs_before : sequence of FreeRun
        Of the baseline.
    calibrate_s : float, optional
        Free flight of each validation flight to calibrate on.
    seed : int
        Seed of the bootstrap behind the intervals.
    refits : float
        Refits after which no further term is looked for.
    say : callable
        Called with what is being done, and the share of the work that is done.
    """
    discovery = discover(
        comparison, base, curve=curve, kinds=kinds, refits=refits, say=lambda what: say(what, 0.94)
    )
    if discovery is None:
        return None
    estimate = discovery.hypothesis.estimate
    prediction = predict(discovery.hypothesis.candidates, estimate, comparison.train, comparison.held_out)
    runs = free_runs(prediction.fit, comparison.held_out, calibrate_s)
    gains = judgement(runs_before, runs, seed).horizons["2"]
    return ProposedTerm(discovery, prediction, gains, where(discovery), course_of(discovery))


def course_of(discovery: Discovery) -> TermTrace:
    """Follow a law along a flight."""
    without, beside = discovery.elsewhere or (discovery.base.estimate, discovery.hypothesis.estimate)
    label = beside.references[0].record.label
    law_s, change = accelerations(beside, discovery.effect.name)
    references = Courses(Screening(beside))
    linear = references.linearised_flights[0]
    torque = linear.disturbance_for(change)
    axis = int(np.argmax(torque.std(axis=0)))
    t_s, missing, std = without.filtered().smoothed_disturbances(
        without.disturbances, np.zeros(len(without.theta))
    )[0]
    equation = np.interp(t_s, law_s, torque[:, axis])
    on = discovery.equation.terms[0].term.quantities[-1]
    value = references.quantity(0, on)
    value = value if value.ndim == 1 else value.mean(axis=1)
    return TermTrace(
        label,
        AXES[axis],
        t_s,
        equation - equation.mean(),
        missing[:, axis] - missing[:, axis].mean(),
        std[:, axis],
        on,
        str(QUANTITIES[on].unit),
        np.interp(t_s, law_s, value),
    )


def where(discovery: Discovery) -> tuple[SupportedRange, ...]:
    """Where in the flights fitted a law matters, channel by channel."""
    references = Courses(Screening(discovery.hypothesis.estimate))
    flights = range(len(references.linearised_flights))
    result = []
    for channel in discovery.equation.channels:
        size = np.concatenate([np.abs(along(discovery, references, i, channel)).max(axis=1) for i in flights])
        largest = float(np.quantile(size, 0.99))
        there = size >= _MATTERS * largest
        names = dict.fromkeys(
            q for term in discovery.equation.terms if term.channel == channel for q in term.term.quantities
        )
        ranges = {}
        for name in names:
            every = [references.quantity(i, name) for i in flights]
            values = np.concatenate([value if value.ndim == 1 else value.mean(axis=1) for value in every])
            low, high = np.quantile(values[there], [0.05, 0.95])
            ranges[name] = (float(low), float(high))
        result.append(
            SupportedRange(channel, float(np.sqrt(np.mean(size**2))), largest, ranges, float(there.mean()))
        )
    return tuple(result)


def along(discovery: Discovery, references: Courses, index: int, channel: str) -> Floats:
    """What a law adds to a `channel` along the flight of number `index` of the `references`, about its mean,
    (n, 1), or (n, 2) rotor by rotor.
    """
    total: Floats = np.zeros((1, 1))
    values = discovery.values
    for i, law_term in enumerate(discovery.equation.terms):
        if law_term.channel == channel:
            term = references.values(index, discovery.with_numbers(i))
            total = total + values[discovery.equation.coefficient(i)][0] * term
    return np.asarray(total - total.mean(axis=0), float)
