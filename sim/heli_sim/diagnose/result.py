"""What a diagnosis hands on: as JSON, and as an extended rig that can be flown."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from heli_sim.diagnose.curves import Curve, curve_of
from heli_sim.diagnose.gain import AxisGain
from heli_sim.diagnose.hypothesis import Errors, Hypothesis
from heli_sim.diagnose.leftover import Leftover, correlates
from heli_sim.diagnose.next_flight import NextFlight
from heli_sim.diagnose.pattern import Pattern
from heli_sim.diagnose.removed import Removed
from heli_sim.diagnose.search import Found, Search
from heli_sim.diagnose.unseen import unlearned_numbers
from heli_sim.diagnose.verdict import Verdict, ambiguous_with, confidence
from heli_sim.identify import Fit, check
from heli_sim.identify.record import AXES
from heli_sim.identify.result import Identification
from heli_sim.model.effects import EffectKind, effect_numbers
from heli_sim.rig import Number, Rig

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
    leftover : Leftover
        What the final model still lacks.
    extended : Hypothesis
        The model with the causes of the catalogue alone, as the extended rig flies it.
    gains : Mapping[str, AxisGain]
        Free-run errors before and after, by axis.
    curve_gains : Mapping[str, AxisGain]
        The same with the curves that stand for what is on no list; empty without any.
    removed : tuple of Removed
        Terms of the baseline whose numbers the fit found to be nothing.
    kinds : Mapping[str, EffectKind]
        The catalogue.
    unseen : tuple of str
        Effects that would not have been seen in these flights at a typical size.
    skipped : tuple of str
        Why each flight that shows nothing was left out.
    next_flight : NextFlight or None
        A flight that would tell more.
    seconds : float
        Time taken.
    """

    search: Search
    verdict: Verdict
    leftover: Leftover
    extended: Hypothesis
    gains: Mapping[str, AxisGain]
    curve_gains: Mapping[str, AxisGain]
    removed: tuple[Removed, ...]
    kinds: Mapping[str, EffectKind]
    unseen: tuple[str, ...]
    skipped: tuple[str, ...]
    next_flight: NextFlight | None
    seconds: float

    def values(self, found: Found) -> dict[str, tuple[float, float, str]]:
        """Numbers of a cause.

        Parameters
        ----------
        found : Found
            The cause.

        Returns
        -------
        dict of (float, float, str)
            Value, standard error and unit by full name.
        """
        kind, fit = self.kinds[found.trial.id], self.extended.fit
        std = stds(fit)
        return {
            q.name: (
                fit.values.get(q.name, found.trial.effect.values[q.name]),
                std.get(q.name, 0.0),
                q.unit,
            )
            for q in kind.parameters
        }

    def sentence(self, found: Found) -> str:
        """Say a cause with its numbers.

        Parameters
        ----------
        found : Found
            The cause.

        Returns
        -------
        str
            One sentence without its full stop.
        """
        numbers = self.values(found)
        return self.kinds[found.trial.id].sentence(
            {name: value for name, (value, _, _) in numbers.items()},
            {name: std for name, (_, std, _) in numbers.items()},
        )

    @property
    def word(self) -> str:
        """The verdict."""
        return self.verdict.word

    @property
    def curves(self) -> list[Curve]:
        """What stands in the place of what is on no list, the strongest first."""
        effects = (one.trial.effect for one in self.verdict.off_list)
        return [curve_of(one, self.search.final.fit) for one in effects if isinstance(one, Pattern)]

    @property
    def random_torque(self) -> dict[str, tuple[float, float, str]]:
        """Numbers of the random torque, value, standard error and unit; empty when there is none."""
        if not self.verdict.chance:
            return {}
        left = self.leftover
        fits = (self.search.baseline.fit, self.search.baseline.held_fit)
        seconds = sum(record.used_s for fit in fits if fit is not None for record in fit.problem.records)
        independent = max(seconds / (2.0 * left.memory_s), 2.0)
        prefix = f"random_torque_{left.axis}"
        relative = 1.0 / np.sqrt(2.0 * independent)
        return {
            f"{prefix}_Nm": (left.size_Nm, left.size_Nm * float(relative), "N m"),
            f"{prefix}_s": (left.memory_s, left.memory_s * float(2.0 * relative), "s"),
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
        said = [one["sentence"] for one in self._causes()]
        text = "; ".join(said)
        text = text[:1].upper() + text[1:]
        if word == "explained":
            return (
                f"Nothing is missing that these flights could show: the refitted baseline is off by "
                f"{normalised:.3g} times the encoders' rounding on {where}."
            )
        if word in ("cause_found", "ambiguous"):
            return f"{text}."
        missing = self._unexplained() or {}
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
        for cause in self._causes():
            rivals = cause["ambiguous_with"]
            unclear = f"; could as well be {', '.join(rivals)}" if rivals else ""
            lines.append(f"{cause['effect']} (confidence {cause['confidence']:.2f}{unclear})")
        lines.append(f"{self._metric}, before and after, and their ratio:")
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
            "causes": self._causes(),
            "residual": self._residual(),
            "gain": {
                "metric": self._metric,
                "axis": _gains(self.gains),
            },
            "unexplained": self._unexplained(),
            "next_flight": {"why": self.next_flight.why, "plan": self.next_flight.plan}
            if self.next_flight
            else None,
            "could_not_be_seen": list(self.unseen),
            "could_not_be_learned": list(unlearned_numbers(self.search.baseline.fit)),
            "cautions": self.cautions,
            "flights": self._flights(),
            "ranking": self._ranking(),
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
            effects[one.trial.id] = effect_numbers(
                self.kinds[one.trial.id],
                {key: value for key, (value, _, _) in numbers.items()},
                {key: 2.0 * std for key, (_, std, _) in numbers.items()},
                source,
            )
        if self.verdict.chance:
            numbers = self.random_torque
            id_ = f"random_torque.{self.leftover.axis}"
            effects[id_] = effect_numbers(
                self.kinds[id_],
                {key: value for key, (value, _, _) in numbers.items()},
                {key: 2.0 * std for key, (_, std, _) in numbers.items()},
                source,
            )
        return Rig(found.name, found.description, found.numbers, effects, found.model)

    @property
    def _metric(self) -> str:
        return METRIC if self.extended.held_fit else METRIC.replace("validation", "fitted")

    def _causes(self) -> list[dict[str, Any]]:
        causes: list[dict[str, Any]] = []
        for one in self.verdict.causes:
            causes.append(
                {
                    "effect": one.trial.id,
                    "parameters": _spelled(self.values(one)),
                    "confidence": round(confidence(one, self.search), 3),
                    "sentence": self.sentence(one),
                    "equation": self.kinds[one.trial.id].equation,
                    "evidence": {
                        "log_likelihood_ratio_train": one.evidence.train,
                        "log_likelihood_ratio_held_out": one.evidence.held,
                        "held_out_5_percent": one.evidence.held_low,
                        "price": one.price,
                        "variance_drop": one.evidence.drop,
                        "rivals": {rival.id: rival.behind for rival in one.rivals},
                    },
                    "ambiguous_with": ambiguous_with(one),
                }
            )
        if self.verdict.chance:
            id_ = f"random_torque.{self.leftover.axis}"
            causes.append(
                {
                    "effect": id_,
                    "parameters": _spelled(self.random_torque),
                    "confidence": 0.8,
                    "sentence": self.kinds[id_].sentence(
                        {key: value for key, (value, _, _) in self.random_torque.items()},
                        {key: std for key, (_, std, _) in self.random_torque.items()},
                    ),
                    "equation": self.kinds[id_].equation,
                    "evidence": {
                        "over_error": self.leftover.over_error,
                        "log_likelihood_ratio": self.leftover.gained,
                        "lost_against_all_axes": self.leftover.lost,
                    },
                    "ambiguous_with": [],
                }
            )
        for term in self.removed:
            kind = self.kinds[term.id]
            (name,) = kind.size
            causes.append(
                {
                    "effect": term.id,
                    "parameters": _spelled({name: (term.share, term.std, "1")}),
                    "confidence": round(term.confidence, 3),
                    "sentence": kind.sentence({name: term.share}, {name: term.std}),
                    "equation": kind.equation,
                    "evidence": {
                        "standard_errors_from_nothing": term.from_nothing,
                        "standard_errors_from_the_rig": term.from_rig,
                    },
                    "ambiguous_with": [],
                }
            )
        return causes

    def _residual(self) -> dict[str, Any]:
        before, after = self.search.baseline, self.extended
        white, correlation = {}, {}
        for role, before_fit, after_fit in (
            ("train", before.fit, after.fit),
            ("held_out", before.held_fit, after.held_fit),
        ):
            if before_fit is not None and after_fit is not None:
                checks = {"before": check(before_fit), "after": check(after_fit)}
                white[role] = {when: one.white for when, one in checks.items()}
                correlation[role] = {when: one.correlation for when, one in checks.items()}
        return {
            "axis": {
                axis: {
                    "before": float(before.train.axis_normalised[i]),
                    "after": float(after.train.axis_normalised[i]),
                }
                for i, axis in enumerate(AXES)
            },
            "normalised": {
                "before": before.train.normalised,
                "after": after.train.normalised,
                "held_out_before": before.held.normalised,
                "held_out_after": after.held.normalised,
            },
            "white": white,
            "correlation": correlation,
        }

    def _unexplained(self) -> dict[str, Any] | None:
        after = self.extended.train
        excess = float(1.0 - 1.0 / max(after.normalised**2, 1.0))
        if not self.verdict.off_list:
            if self.verdict.word in ("explained",) or excess < 0.1 or self.verdict.chance:
                return None
            named = [one.what for one in self.leftover.depends] or correlates(self.search.last.patterns())
            return {
                "axis": self.leftover.axis,
                "correlates_with": named,
                "share_of_variance": round(excess, 4),
                "size_Nm": self.leftover.size_Nm,
            }
        strongest = self.verdict.off_list[0]
        _, channel, on = strongest.trial.id.split(":")
        first = next(r for r in self.search.rounds if r.taken == strongest.trial.id)
        others = [name for name in correlates(first.patterns) if name != f"{channel} on {on}"]
        where = channel.rpartition(".")[2]
        axis = where if where in AXES else ("pitch" if where == "difference" else "elevation")
        base, final = self.search.baseline.train, self.search.final.train
        return {
            "axis": axis,
            "channel": channel,
            "correlates_with": [f"{channel} on {on}", *others],
            "share_of_variance": round(_share(base, final, axis), 4),
            "all": [one.trial.id.removeprefix("pattern:") for one in self.verdict.off_list],
            "gain_with_curves": _gains(self.curve_gains),
        }

    def _flights(self) -> list[dict[str, Any]]:
        flights = []
        held = self.search.baseline.held_fit
        for role, fit in (("train", self.search.baseline.fit), ("held_out", held)):
            for record in fit.problem.records if fit is not None else ():
                flights.append(
                    {
                        "flight": record.label,
                        "role": role,
                        "seconds_used": record.used_s,
                        "used": [
                            [float(record.t_s[a]), float(record.t_s[b - 1])] for a, b in record.segments
                        ],
                        "left_out": [
                            {"from_s": c.start_s, "to_s": c.stop_s, "why": c.why} for c in record.cuts
                        ],
                        "notes": list(record.notes),
                    }
                )
        return flights

    def _ranking(self) -> list[dict[str, Any]]:
        rows = []
        for number, one in enumerate(self.search.rounds, 1):
            tried = {step.trial.id: step for step in one.steps}
            for scored in (*one.screened[:8], *one.patterns[:3]):
                step = tried.get(scored.trial.id)
                rows.append(
                    {
                        "round": number,
                        "candidate": scored.trial.id,
                        "score": scored.answer.gain,
                        "train": step.evidence.train if step else None,
                        "held_out": step.evidence.held if step else None,
                        "price": step.price if step else None,
                        "taken": scored.trial.id == one.taken,
                    }
                )
        return rows


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


def _spelled(values: Mapping[str, tuple[float, float, str]]) -> dict[str, dict[str, float | str]]:
    return {name: {"value": value, "std": std, "unit": unit} for name, (value, std, unit) in values.items()}


def _gains(gains: Mapping[str, AxisGain]) -> dict[str, dict[str, Any]]:
    return {
        axis: {
            "before": one.before_deg,
            "after": one.after_deg,
            "ratio": one.ratio,
            "interval95": list(one.interval95),
        }
        for axis, one in gains.items()
    }


def _share(before: Errors, after: Errors, axis: str) -> float:
    i = AXES.index(axis)
    return float(max(0.0, 1.0 - after.variance[i] / before.variance[i]))
