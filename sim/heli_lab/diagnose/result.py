"""The result of a diagnosis as data, and the extended rig that can be flown.

`summary.py` puts it in sentences, `serialize.py` in JSON, `report.py` on a page.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Final

from heli_sim.model.effects import EffectKind, effect_numbers
from heli_sim.model.parts import AXES
from heli_sim.rig import Number, Rig

from heli_lab.diagnose.absent_terms import AbsentTerm
from heli_lab.diagnose.equation_discovery import ProposedTerm
from heli_lab.diagnose.error_reduction import ErrorReduction, HeldOutComparison
from heli_lab.diagnose.experiment_design import ExperimentDesign
from heli_lab.diagnose.failing_regimes import FailingRegimes, failing_regimes
from heli_lab.diagnose.model_comparison import Hypothesis
from heli_lab.diagnose.prediction import Prediction
from heli_lab.diagnose.prior_conflict import PriorConflict, prior_conflicts, tried_without
from heli_lab.diagnose.residual_analysis import ResidualAnalysis
from heli_lab.diagnose.search_record import Cause, Search
from heli_lab.diagnose.spline_curve import SplineCurve, spline_curve_of
from heli_lab.diagnose.spline_term import SplineTerm
from heli_lab.diagnose.thresholds import (
    FEW_WINDOWS,
    LEAST_COUNTS,
    LEAST_STD_SHARE,
    WITHIN_STEP_STD,
    CALIBRATE_s,
)
from heli_lab.diagnose.verdict import Verdict
from heli_lab.identify import Fit
from heli_lab.identify.result import Identification

METRIC: Final = "2 s free-run rms on the validation flights, deg"


@dataclass(frozen=True)
class Diagnosis:
    """Everything that a diagnosis found.

    Parameters
    ----------
    residual_analysis : ResidualAnalysis
        What the final model still lacks.
    extended : Hypothesis
        The model with the causes of the catalogue alone, as the extended rig flies it.
    before, after : Prediction
        Free runs of the refitted baseline and of the extended model, over all flights.
    judgement : HeldOutComparison
        Free runs before and after on the flights held out, calibrated.
    spline_gains : Mapping[str, ErrorReduction]
        Errors over 2 s without anything and with the spline terms too that stand for causes outside the
        catalogue, by axis; empty without any.
    absent : tuple of AbsentTerm
        Terms of the baseline whose parameters the fit estimated as zero.
    undetectable : tuple of str
        Effects that would not be significant in these flights at a typical size.
    unidentifiable : tuple of str
        Parameters of the rig that these flights do not identify.
    skipped : tuple of str
        Why each flight without excitation was left out.
    next_flight : ExperimentDesign or None
        An experiment that would tell more.
    seconds : float
        Time taken.
    calibrate_s : float or None
        Free flight of each validation flight to calibrate on, where it was asked for.
    refits : int
        Refits of the model: the work that it took, on any computer.
    proposed_term : ProposedTerm or None
        The law of what no effect of the catalogue explains, where one was found and confirmed.
    """

    search: Search
    verdict: Verdict
    residual_analysis: ResidualAnalysis
    extended: Hypothesis
    before: Prediction
    after: Prediction
    judgement: HeldOutComparison
    spline_gains: Mapping[str, ErrorReduction]
    absent: tuple[AbsentTerm, ...]
    kinds: Mapping[str, EffectKind]
    undetectable: tuple[str, ...]
    unidentifiable: tuple[str, ...]
    skipped: tuple[str, ...]
    next_flight: ExperimentDesign | None
    seconds: float
    calibrate_s: float | None = None
    refits: int = 0
    proposed_term: ProposedTerm | None = None

    def values(self, cause: Cause) -> dict[str, tuple[float, float, str]]:
        """Parameters of a cause by full name: value, standard error and unit."""
        kind, fit = self.kinds[cause.candidate.id], self.after.fit
        std = reported_std(fit, kind)
        return {
            q.name: (
                fit.values.get(q.name, cause.candidate.effect.values[q.name]),
                std.get(q.name, 0.0),
                q.unit,
            )
            for q in kind.parameters
        }

    def sentence(self, cause: Cause) -> str:
        """A cause with its parameters, in one sentence without its full stop."""
        numbers = self.values(cause)
        return self.kinds[cause.candidate.id].describe(
            {name: value for name, (value, _, _) in numbers.items()},
            {name: std for name, (_, std, _) in numbers.items()},
        )

    @cached_property
    def failing(self) -> FailingRegimes:
        """Where the refitted baseline fails, and where the model with the causes does; with a proposed law
        where the model with the causes fails, and where it does with the law.
        """
        proposed = self.proposed_term
        splines = [spline.candidate.id.split(":") for spline in self.search.rounds[0].splines]
        best = [(channel, on) for _, channel, on in splines if channel.startswith("torque")]
        channel, on = best[0] if best else (f"torque.{self.residual_analysis.axis}", "")
        if proposed is not None:
            equation = proposed.discovery
            return failing_regimes(
                equation.base.estimate,
                equation.hypothesis.estimate,
                proposed.reference.axis,
                proposed.reference.on,
            )
        axis = channel.partition(".")[2]
        return failing_regimes(self.search.baseline.estimate, self.extended.estimate, axis, on)

    @property
    def gains(self) -> Mapping[str, ErrorReduction]:
        """Errors over 2 s before and after, by axis."""
        return self.judgement.horizons["2"]

    @property
    def label(self) -> str:
        """The verdict."""
        return self.verdict.label

    @property
    def curves(self) -> list[SplineCurve]:
        """The spline terms in the place of causes outside the catalogue, the strongest first."""
        effects = (cause.candidate.effect for cause in self.verdict.unlisted)
        return [
            spline_curve_of(effect, self.search.final.estimate)
            for effect in effects
            if isinstance(effect, SplineTerm)
        ]

    @property
    def random_torque(self) -> dict[str, tuple[float, float, str]]:
        """Parameters of the random torque, value, standard error and unit; empty when there is none."""
        if not self.verdict.gust:
            return {}
        axis = AXES.index(self.residual_analysis.axis)
        disturbances = self.residual_analysis.disturbances
        sigma_Nm, correlation_time_s = (
            float(disturbances.fast_std[axis]),
            float(disturbances.correlation_time_s[axis]),
        )
        seconds = sum(record.used_s for record in self.before.fit.problem.records)
        relative = 1.0 / math.sqrt(2.0 * max(seconds / (2.0 * correlation_time_s), 2.0))
        prefix = f"random_torque_{AXES[axis]}"
        return {
            f"{prefix}_Nm": (sigma_Nm, sigma_Nm * relative, "N m"),
            f"{prefix}_s": (correlation_time_s, 2.0 * correlation_time_s * relative, "s"),
        }

    @cached_property
    def prior_conflicts(self) -> tuple[PriorConflict, ...]:
        """Numbers of the rig that the extended model has far from what its file says, and what they are
        without that.
        """
        return tried_without(prior_conflicts(self.after.fit), self.extended.estimate)

    @property
    def cautions(self) -> list[str]:
        """What weakens the result, a line each; empty when nothing does."""
        cautions = [f"left out: {why}" for why in self.skipped]
        held_out = self.after.held_out_fit
        if held_out is None:
            cautions.append("no flight was held out: nothing here is confirmed; give one to --validate")
        else:
            cautions += self._cautions_of_judgement(sum(record.used_s for record in held_out.problem.records))
        cautions += [pull.sentence for pull in self.prior_conflicts]
        if not self.search.complete:
            cautions.append("the work allowed ran out before everything was tried; give more with --budget")
        return cautions

    def _cautions_of_judgement(self, seconds: float) -> list[str]:
        """What weakens the comparison on the flights held out, of so many seconds of free flight."""
        asked_s = CALIBRATE_s if self.calibrate_s is None else self.calibrate_s
        runs = self.judgement.after
        cautions = []
        if sum(len(run.errors["2"].rows) for run in runs) < FEW_WINDOWS:
            cautions.append(f"only {seconds:.0f} s were held out: too few for the intervals of the ratios")
        cautions += [
            f"{run.label} is short: its zeros and torques are calibrated on {run.calibrated_s:.1f} s of it, "
            f"not on {asked_s:g}"
            for run in runs
            # A sample is not worth a line.
            if run.calibrated_s < 0.99 * asked_s
        ]
        return cautions

    def rig(self, name: str, with_law: bool = False) -> Rig:
        """Make the extended rig `name`, of the refitted parameters and the causes with theirs, ready for
        `heli-host sil|fly --rig`; `with_law` adds the proposed law where there is one, whose effect file has
        to be given beside it.
        """
        if with_law and self.proposed_term is not None:
            return self._rig_with_law(name, self.proposed_term)
        rig = Identification(self.after.fit, (), (), (), ()).rig(name)
        labels = ", ".join(record.label for record in self.after.fit.problem.records)
        source = f"found by heli-host diagnose from {labels}"
        effects: dict[str, Mapping[str, Number]] = dict(rig.effects)
        for cause in self.verdict.causes:
            numbers = self.values(cause)
            effects[cause.candidate.id] = effect_numbers(
                self.kinds[cause.candidate.id],
                {key: value for key, (value, _, _) in numbers.items()},
                {key: 2.0 * std for key, (_, std, _) in numbers.items()},
                source,
            )
        if self.verdict.gust:
            numbers = self.random_torque
            id_ = f"random_torque.{self.residual_analysis.axis}"
            effects[id_] = effect_numbers(
                self.kinds[id_],
                {key: value for key, (value, _, _) in numbers.items()},
                {key: 2.0 * std for key, (_, std, _) in numbers.items()},
                source,
            )
        return Rig(rig.name, rig.description, rig.numbers, effects, rig.model)

    def _rig_with_law(self, name: str, proposed: ProposedTerm) -> Rig:
        rig = Identification(proposed.prediction.fit, (), (), (), ()).rig(name)
        labels = ", ".join(record.label for record in self.after.fit.problem.records)
        source = f"found by heli-host diagnose from {labels}"
        effects: dict[str, Mapping[str, Number]] = dict(rig.effects)
        fit = proposed.prediction.fit
        for candidate in proposed.discovery.hypothesis.candidates[:-1]:
            kind = self.kinds[candidate.id]
            std = reported_std(fit, kind)
            known = {q.name: fit.values.get(q.name, candidate.effect.values[q.name]) for q in kind.parameters}
            effects[candidate.id] = effect_numbers(
                kind, known, {n: 2.0 * std.get(n, 0.0) for n in known}, source
            )
        effects[proposed.discovery.effect.name] = {
            what: Number(value, unit, 2.0 * error, source)
            for what, (value, error, unit) in proposed.discovery.values.items()
        }
        return Rig(rig.name, rig.description, rig.numbers, effects, rig.model)

    @property
    def metric(self) -> str:
        """What the gains measure, with its unit."""
        return METRIC if self.after.held_out_fit else METRIC.replace("validation", "fitted")


def reported_std(fit: Fit, kind: EffectKind) -> dict[str, float]:
    """Standard errors by name of the numbers of a `kind`, none finer than what flights resolve.

    Voltages are held over a sample: a time constant or a delay is uncertain by a part of it, whichever way
    board and simulator count it, and of what a controller answers within a step. What acts within a step is
    blurred, so no size is finer than a share of itself; and what lies between an axis and its encoder is
    shown in whole counts.
    """
    record = fit.problem.records[0]
    part, _, axis = kind.acts_on.partition(".")
    errors = {}
    for parameter in fit.problem.free:
        least = 0.0
        if parameter.unit == "s":
            least = 0.5 * record.step_s
        elif parameter.unit == "rad" and part == "measurement" and axis in AXES:
            least = LEAST_COUNTS * float(record.count_rad[AXES.index(axis)])
        std = fit.std[parameter.name] * (WITHIN_STEP_STD if parameter.unit == "s" else 1.0)
        blurred = LEAST_STD_SHARE * fit.values[parameter.name] if parameter.name in kind.size else 0.0
        errors[parameter.name] = math.hypot(std, least, blurred)
    return errors
