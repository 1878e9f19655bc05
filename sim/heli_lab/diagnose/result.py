"""What a diagnosis hands on: as JSON, and as an extended rig that can be flown."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from heli_sim.model.effects import EffectKind, effect_numbers
from heli_sim.rig import Number, Rig

from heli_lab.diagnose import serialize
from heli_lab.diagnose.absent_terms import AbsentTerm
from heli_lab.diagnose.detectability import unidentifiable_parameters
from heli_lab.diagnose.error_reduction import ErrorReduction
from heli_lab.diagnose.experiment_design import ExperimentDesign
from heli_lab.diagnose.model_comparison import Hypothesis
from heli_lab.diagnose.residual_analysis import ResidualAnalysis
from heli_lab.diagnose.search_record import Cause, Search
from heli_lab.diagnose.spline_curve import SplineCurve, spline_curve_of
from heli_lab.diagnose.spline_term import SplineTerm
from heli_lab.diagnose.verdict import Verdict
from heli_lab.identify import Fit
from heli_lab.identify.result import Identification

_FEW_WINDOWS: Final = 5
_WORTH_A_LINE: Final = 0.9
METRIC: Final = "2 s free-run rms on the validation flights, deg"


@dataclass(frozen=True)
class Diagnosis:
    """Everything that a diagnosis found.

    Parameters
    ----------
    search : Search
        What was tried and what was found.
    verdict : Verdict
        What is said.
    residual_analysis : ResidualAnalysis
        What the final model still lacks.
    extended : Hypothesis
        The model with the causes of the catalogue alone, as the extended rig flies it.
    gains : Mapping[str, ErrorReduction]
        Free-run errors before and after, by axis.
    curve_gains : Mapping[str, ErrorReduction]
        The same with the curves that stand for what is on no list; empty without any.
    removed : tuple of AbsentTerm
        Terms of the baseline whose numbers the fit found to be nothing.
    kinds : Mapping[str, EffectKind]
        The catalogue.
    unseen : tuple of str
        Effects that would not have been seen in these flights at a typical size.
    skipped : tuple of str
        Why each flight that shows nothing was left out.
    next_flight : ExperimentDesign or None
        A flight that would tell more.
    seconds : float
        Time taken.
    """

    search: Search
    verdict: Verdict
    residual_analysis: ResidualAnalysis
    extended: Hypothesis
    gains: Mapping[str, ErrorReduction]
    curve_gains: Mapping[str, ErrorReduction]
    removed: tuple[AbsentTerm, ...]
    kinds: Mapping[str, EffectKind]
    unseen: tuple[str, ...]
    skipped: tuple[str, ...]
    next_flight: ExperimentDesign | None
    seconds: float

    def values(self, found: Cause) -> dict[str, tuple[float, float, str]]:
        """Numbers of a cause.

        Parameters
        ----------
        found : Cause
            The cause.

        Returns
        -------
        dict of (float, float, str)
            Value, standard error and unit by full name.
        """
        kind, fit = self.kinds[found.candidate.id], self.extended.fit
        std = stds(fit)
        return {
            q.name: (
                fit.values.get(q.name, found.candidate.effect.values[q.name]),
                std.get(q.name, 0.0),
                q.unit,
            )
            for q in kind.parameters
        }

    def sentence(self, found: Cause) -> str:
        """Say a cause with its numbers.

        Parameters
        ----------
        found : Cause
            The cause.

        Returns
        -------
        str
            One sentence without its full stop.
        """
        numbers = self.values(found)
        return self.kinds[found.candidate.id].describe(
            {name: value for name, (value, _, _) in numbers.items()},
            {name: std for name, (_, std, _) in numbers.items()},
        )

    @property
    def word(self) -> str:
        """The verdict."""
        return self.verdict.word

    @property
    def curves(self) -> list[SplineCurve]:
        """What stands in the place of what is on no list, the strongest first."""
        effects = (one.candidate.effect for one in self.verdict.off_list)
        return [spline_curve_of(one, self.search.final.fit) for one in effects if isinstance(one, SplineTerm)]

    @property
    def random_torque(self) -> dict[str, tuple[float, float, str]]:
        """Numbers of the random torque, value, standard error and unit; empty when there is none."""
        if not self.verdict.chance:
            return {}
        left = self.residual_analysis
        fits = (self.search.baseline.fit, self.search.baseline.held_fit)
        seconds = sum(record.used_s for fit in fits if fit is not None for record in fit.problem.records)
        independent = max(seconds / (2.0 * left.correlation_time_s), 2.0)
        prefix = f"random_torque_{left.axis}"
        relative = 1.0 / np.sqrt(2.0 * independent)
        return {
            f"{prefix}_Nm": (left.sigma_Nm, left.sigma_Nm * float(relative), "N m"),
            f"{prefix}_s": (left.correlation_time_s, left.correlation_time_s * float(2.0 * relative), "s"),
        }

    @property
    def summary(self) -> str:
        """What was found, in a sentence or two."""
        cut = "" if self.search.complete else " The time ran out before everything was tried."
        return self._found + cut

    @property
    def _found(self) -> str:
        word = self.verdict.word
        normalised = self.extended.held.normalised
        where = "flights that no fit saw" if self.extended.held_fit else "the flights that were fitted"
        said = [one["sentence"] for one in serialize.causes(self)]
        text = "; ".join(said)
        text = text[:1].upper() + text[1:]
        if word == "explained":
            return (
                f"Nothing is missing that these flights could show: the refitted baseline is off by "
                f"{normalised:.3g} times the encoders' rounding on {where}."
            )
        if word in ("cause_found", "ambiguous"):
            return f"{text}."
        missing = serialize.unexplained(self) or {}
        depends = ", ".join(missing.get("correlates_with", ())[:1]) or "nothing that was looked at"
        first = f"{text}. Besides, something" if text else "Something"
        share = (
            f"{missing['share_of_variance']:.0%} of the error about {missing['axis']}" if missing else "it"
        )
        return f"{first} is missing that no effect of the catalogue explains: {share} goes with {depends}."

    @property
    def cautions(self) -> list[str]:
        """What weakens the result, a line each; empty when nothing does."""
        cautions = [f"left out: {why}" for why in self.skipped]
        held = self.extended.held_fit
        if held is None:
            cautions.append("no flight was held out: nothing here is confirmed; give one to --validate")
        elif len(self.extended.held.rows) < _FEW_WINDOWS:
            seconds = sum(record.used_s for record in held.problem.records)
            cautions.append(f"only {seconds:.0f} s were held out: too few for the intervals of the ratios")
        if not self.search.complete:
            cautions.append("the time ran out before everything was tried; give more with --budget")
        return cautions

    @property
    def lines(self) -> list[str]:
        """Numbers behind the summary, a line each."""
        lines = []
        for cause in serialize.causes(self):
            rivals = cause["ambiguous_with"]
            unclear = f"; could as well be {', '.join(rivals)}" if rivals else ""
            lines.append(f"{cause['effect']} (confidence {cause['confidence']:.2f}{unclear})")
        lines.append(f"{self.metric}, before and after, and their ratio:")
        for axis, one in self.gains.items():
            low, high = one.interval95
            lines.append(
                f"  {axis:9}  {one.before_deg:<7.3g} {one.after_deg:<7.3g} {one.ratio:.2f} "
                f"({low:.2f} to {high:.2f})"
            )
        for curve in self.curves:
            lines.append(f"a curve in its place: {curve.what}")
        for axis, one in self.curve_gains.items():
            if one.ratio < _WORTH_A_LINE:
                lines.append(f"  with it {axis} is off by {one.after_deg:.3g} deg, ratio {one.ratio:.2f}")
        if self.next_flight is not None:
            lines.append(f"next flight: {self.next_flight.why}")
        elif self.unseen:
            lines.append(f"at a typical size these flights would not show: {', '.join(self.unseen)}")
        return lines + self.cautions

    def json(self) -> dict[str, Any]:
        """Spell the result for other programs, as docs/diagnosing.md describes it.

        Returns
        -------
        dict
            verdict, causes, residual, gain, unexplained, next_flight and more.
        """
        return {
            "verdict": self.verdict.word,
            "causes": serialize.causes(self),
            "residual": serialize.residual(self),
            "gain": {
                "metric": self.metric,
                "axis": serialize.gains(self.gains),
            },
            "unexplained": serialize.unexplained(self),
            "next_flight": {"why": self.next_flight.why, "plan": self.next_flight.plan}
            if self.next_flight
            else None,
            "could_not_be_seen": list(self.unseen),
            "could_not_be_learned": list(unidentifiable_parameters(self.search.baseline.fit)),
            "cautions": self.cautions,
            "flights": serialize.flights(self),
            "ranking": serialize.ranking(self),
            "seconds_taken": self.seconds,
            "complete": self.search.complete,
        }

    def rig(self, name: str) -> Rig:
        """Make the extended rig.

        Parameters
        ----------
        name : str
            Its name.

        Returns
        -------
        Rig
            The refitted numbers, and the causes with theirs; `heli-host sil|fly --rig` flies it.
        """
        found = Identification(self.extended.fit, (), (), (), ()).rig(name)
        labels = ", ".join(record.label for record in self.extended.fit.problem.records)
        source = f"found by heli-host diagnose from {labels}"
        effects: dict[str, Mapping[str, Number]] = dict(found.effects)
        for one in self.verdict.causes:
            numbers = self.values(one)
            effects[one.candidate.id] = effect_numbers(
                self.kinds[one.candidate.id],
                {key: value for key, (value, _, _) in numbers.items()},
                {key: 2.0 * std for key, (_, std, _) in numbers.items()},
                source,
            )
        if self.verdict.chance:
            numbers = self.random_torque
            id_ = f"random_torque.{self.residual_analysis.axis}"
            effects[id_] = effect_numbers(
                self.kinds[id_],
                {key: value for key, (value, _, _) in numbers.items()},
                {key: 2.0 * std for key, (_, std, _) in numbers.items()},
                source,
            )
        return Rig(found.name, found.description, found.numbers, effects, found.model)

    @property
    def metric(self) -> str:
        """What the gains measure, with its unit."""
        return METRIC if self.extended.held_fit else METRIC.replace("validation", "fitted")


def stds(fit: Fit) -> dict[str, float]:
    """Standard errors, none finer than what the log's sampling resolves.

    Voltages are held over a sample: a time constant or a delay is uncertain by a part of it, whichever way
    board and simulator count it.

    Parameters
    ----------
    fit : Fit
        The fit.

    Returns
    -------
    dict of float
        By name.
    """
    units = {one.name: one.unit for one in fit.problem.free}
    half_s = 0.5 * fit.problem.records[0].step_s
    return {
        name: float(np.hypot(std, half_s)) if units[name] == "s" else std for name, std in fit.std.items()
    }
