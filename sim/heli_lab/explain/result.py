"""Result of a diagnosis as data, and the extended rig; `heli_lab.report` writes it for readers."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, TypeVar

import numpy as np
from heli_sim.model.base import Model
from heli_sim.model.effect import AXES
from heli_sim.model.effects import EffectSpec, effect_numbers
from heli_sim.rig import Number, Rig

from heli_lab.explain.assessment import Assessment
from heli_lab.explain.candidates import channel_place
from heli_lab.explain.comparison import Hypothesis
from heli_lab.explain.contributions import SplineCurve, spline_curves_of
from heli_lab.explain.experiment_design import ExperimentDesign
from heli_lab.explain.prediction import ErrorReduction, Extrapolation, extrapolations
from heli_lab.explain.proposal import ProposedTerm
from heli_lab.explain.replication import HeldOutEvaluation, HypothesisEvaluation, Replication
from heli_lab.explain.residuals import FailingRegions, failing_regions
from heli_lab.explain.stepwise import Search
from heli_lab.explain.verdict import (
    CauseParameter,
    PriorConflict,
    Verdict,
    cause_parameters,
    prior_conflicts,
    tried_without,
    with_confirmation,
)
from heli_lab.fit.estimator import Estimate
from heli_lab.fit.identification import Identification
from heli_lab.fit.problem import PER_FLIGHT, Fit

EstimateT = TypeVar("EstimateT", Fit, Estimate)


def widened(estimate: EstimateT, full: EstimateT) -> EstimateT:
    """Add to the covariance of `estimate` how its parameters change in `full`, a model with more causes."""
    # A parameter takes the part of a cause that is left out: without a lag of 0.07 s, the thrust gain of one
    # flight was 0.416 instead of 0.584 N/V. The standard error of 0.006 N/V holds for the right model only.
    full_params = full.params
    change = np.array([value - full_params.get(name, value) for name, value in estimate.params.items()])
    return replace(estimate, covariance=estimate.covariance + np.outer(change, change))


def extended_rig(
    name: str,
    fit: Fit,
    kinds: Mapping[str, EffectSpec],
    causes: Mapping[str, Mapping[str, CauseParameter]],
    term: ProposedTerm | None,
) -> Rig:
    """Make a rig of fitted parameters and effects."""
    # The other fields of an identification are for its report.
    rig = Identification(fit, (), (), (), ()).rig(name)
    labels = ", ".join(record.label for record in fit.problem.records)
    source = f"found by heli-host diagnose from {labels}"
    effects: dict[str, Mapping[str, Number]] = dict(rig.effects)
    for id_, numbers in causes.items():
        effects[id_] = effect_numbers(
            kinds[id_],
            {parameter: number.value for parameter, number in numbers.items()},
            # A tolerance in a rig file is two standard deviations.
            {parameter: 2.0 * number.std for parameter, number in numbers.items()},
            source,
        )
    if term is not None:
        effects[term.discovery.effect.name] = {
            parameter: Number(value, unit, 2.0 * std, source)
            for parameter, (value, std, unit) in term.discovery.values.items()
        }
    return Rig(rig.name, rig.description, {**rig.numbers, **_mean_zeros(fit)}, effects, rig.model)


def _mean_zeros(fit: Fit) -> dict[str, Number]:
    """Return the means of the encoder zeros of several flights, by name; empty for a single flight, whose
    zeros the rig has.
    """
    # Zeros and constant torques of a flight compensate each other, so the mean of the torques predicts worse
    # without the mean of the zeros. The tolerance is at least that of the rig file, because encoders are
    # zeroed again before the next flight.
    problem, zeros = fit.problem, dict[str, list[float]]()
    if len(problem.records) == 1:
        return {}
    for parameter, value in zip(problem.free, fit.theta, strict=True):
        if parameter.quantity in PER_FLIGHT:
            zeros.setdefault(parameter.quantity, []).append(float(value))
    labels = ", ".join(record.label for record in problem.records)
    numbers = {}
    for name, values in zeros.items():
        before = problem.rig[name]
        tolerance = max(before.tolerance, 2.0 * float(np.std(values, ddof=1)))
        source = f"mean of {labels}; before: {before.value:g} +- {before.tolerance:g}"
        numbers[name] = Number(float(np.mean(values)), before.unit, tolerance, source)
    return numbers


def model_and_rig(hypothesis: Hypothesis) -> tuple[Model, Rig]:
    """Return the equations of a `hypothesis` with the estimated sizes of its effects and curves, and the rig
    with its estimated parameters. Constants of the flights are their means.
    """
    estimate = hypothesis.estimate
    vector = estimate.parameter_vector
    values: dict[str, list[float]] = {}
    for parameter, value in zip(vector.free, estimate.theta, strict=True):
        values.setdefault(parameter.quantity, []).append(float(value))
    means = {name: float(np.mean(of_flights)) for name, of_flights in values.items()}
    effects = tuple(
        replace(effect, values={name: means.get(name, value) for name, value in effect.values.items()})
        for effect in vector.model.effects
    )
    rig = vector.rig.replace(**{name: value for name, value in means.items() if name in vector.rig})
    return type(vector.model)(effects), rig


@dataclass(frozen=True)
class Proposal:
    """A proposed equation and its evaluation."""

    term: ProposedTerm  # The equation
    evaluation: HypothesisEvaluation  # Free runs of the model with it, compared with the baseline's


class MissingDependence(NamedTuple):
    """Axis with a torque or angle that no effect explains, and the quantity on which it depends."""

    axis: str
    quantity: str


@dataclass(frozen=True)
class Effort:
    """Work of a diagnosis."""

    refits: int  # Refits of the model: the work independent of the computer
    seconds: float  # Time taken on this computer


@dataclass(frozen=True)
class Diagnosis:
    """Result of a diagnosis.

    Parameters
    ----------
    search : Search
        Baseline, final model, causes with their evidence, and all rounds of the search.
    assessment : Assessment
        Verdict, extended model, its free runs over all flights, and what it leaves.
    replication : Replication
        Which causes hold in both directions, and the model with these alone.
    undetectable : tuple of str
        Effects that would not be significant in these flights at their typical size.
    unidentifiable : tuple of str
        Parameters of the rig that these flights do not identify.
    skipped : tuple of str
        Why each flight without excitation was not used.
    next_flight : ExperimentDesign or None
        Experiment that would answer what these flights leave open.
    proposal : Proposal or None
        Equation of what no effect of the catalogue explains; None if there is none or none was confirmed.
    effort : Effort
        Refits and time.
    curved : Hypothesis or None
        The final model with curves in the place of what no effect explains; None without such curves.
    """

    search: Search
    assessment: Assessment
    replication: Replication
    kinds: Mapping[str, EffectSpec]
    undetectable: tuple[str, ...]
    unidentifiable: tuple[str, ...]
    skipped: tuple[str, ...]
    next_flight: ExperimentDesign | None
    proposal: Proposal | None
    effort: Effort
    curved: Hypothesis | None = None

    @cached_property
    def verdict(self) -> Verdict:
        """Verdict with its causes; a cause that is not confirmed has a lower confidence."""
        return with_confirmation(self.assessment.verdict, self.replication.unconfirmed)

    @property
    def label(self) -> str:
        """``explained``, ``cause_found``, ``ambiguous`` or ``unexplained``."""
        return self.verdict.label

    @property
    def proposed_term(self) -> ProposedTerm | None:
        """Proposed equation, if there is one."""
        return self.proposal.term if self.proposal else None

    @property
    def held_out(self) -> HeldOutEvaluation:
        """Free-run errors before and after on the held-out flights; after, with the confirmed causes."""
        return self.replication.evaluation

    @property
    def error_reductions(self) -> Mapping[str, ErrorReduction]:
        """Free-run errors over 2 s before and after, by axis, on the held-out flights."""
        return self.held_out.reductions

    @property
    def curves(self) -> list[SplineCurve]:
        """Spline terms in the place of causes that the catalogue lacks, the strongest first."""
        return spline_curves_of(self.verdict.unlisted, self.search.final.estimate)

    @cached_property
    def failing_regions(self) -> FailingRegions:
        """Regions in which the baseline and the extended model fail."""
        # If there is a proposed equation, the two models are the extended model without and with it. The axis
        # is that of the missing torque, or otherwise that of the spline term with the highest score.
        term = self.proposed_term
        if term is not None:
            return self.failing_regions_about(term.trace.axis, term.trace.on)
        if self.missing is not None:
            return self.failing_regions_about(self.missing.axis, self.missing.quantity)
        for spline in self.search.rounds[0].splines:
            channel, quantity = spline.candidate.dependence
            if channel.startswith("torque"):
                return self.failing_regions_about(channel_place(channel), quantity)
        return self.failing_regions_about(self.assessment.residual_analysis.axis)

    def failing_regions_about(self, axis: str, on: str = "") -> FailingRegions:
        """Regions in which the two models of `failing_regions` fail about an `axis`.

        `on` is one of the two quantities of the plane; by default, the plane has the most evidence.
        """
        term = self.proposed_term
        before, after = (
            (term.discovery.base, term.discovery.hypothesis)
            if term is not None
            else (self.search.baseline, self.assessment.extended)
        )
        return failing_regions(before.estimate, after.estimate, axis, on)

    @property
    def missing(self) -> MissingDependence | None:
        """The strongest dependence that no effect explains; None if everything is explained."""
        if self.label != "unexplained":
            return None
        residual = self.assessment.residual_analysis
        if self.verdict.unlisted:
            channel, quantity = self.verdict.unlisted[0].candidate.dependence
            axis_or_rotors = channel_place(channel)
            # The sum of the thrusts lifts the arm, and their difference pitches it.
            axis = {"both": "elevation", "difference": "pitch"}.get(axis_or_rotors, axis_or_rotors)
            return MissingDependence(axis, quantity)
        channel, _, quantity = residual.dependences[0].what.partition(" on ")
        axis_or_rotors = channel_place(channel)
        axis = axis_or_rotors if axis_or_rotors in AXES else residual.axis
        return MissingDependence(axis, quantity)

    @cached_property
    def prior_conflicts(self) -> tuple[PriorConflict, ...]:
        """Parameters of the rig whose estimate is far from the rig file's prior."""
        return tried_without(prior_conflicts(self.assessment.after.fit), self.assessment.extended.estimate)

    @cached_property
    def extrapolations(self) -> tuple[Extrapolation, ...]:
        """Windows of each held-out flight with voltages that the fitted flights do not contain."""
        if self.assessment.after.held_out_fit is None:
            return ()
        return extrapolations(self.assessment.after.fit.problem.records, self.held_out.extension.after)

    @property
    def random_torque(self) -> dict[str, dict[str, CauseParameter]]:
        """Size and correlation time of the random torque, as ``{effect id: {full name: parameter}}``.

        It is empty if the verdict has no random torque.
        """
        if not self.verdict.random_torque:
            return {}
        residual = self.assessment.residual_analysis
        axis = AXES.index(residual.axis)
        std_Nm = float(residual.disturbances.fast_std[axis])
        correlation_time_s = float(residual.disturbances.correlation_time_s[axis])
        seconds = sum(record.used_s for record in self.assessment.before.fit.problem.records)
        # Values two correlation times apart count as independent. The relative standard error of a standard
        # deviation from N independent values is 1 / sqrt(2 N); at least two values are assumed.
        independent_values = max(seconds / (2.0 * correlation_time_s), 2.0)
        relative = 1.0 / math.sqrt(2.0 * independent_values)
        prefix = f"random_torque_{residual.axis}"
        return {
            f"random_torque.{residual.axis}": {
                f"{prefix}_Nm": CauseParameter(std_Nm, std_Nm * relative, "N m"),
                f"{prefix}_s": CauseParameter(correlation_time_s, 2.0 * correlation_time_s * relative, "s"),
            }
        }

    @property
    def confirmed_ids(self) -> list[str]:
        """Ids of the confirmed causes, the strongest first."""
        return [
            cause.effect for cause in self.verdict.causes if self.replication.causes[cause.effect].confirmed
        ]

    def rig(
        self,
        name: str,
        with_term: bool = False,
        with_unconfirmed: bool = False,
        only: Sequence[str] | None = None,
    ) -> Rig:
        """Make the extended rig for ``heli-host sil`` and ``fly``: refitted parameters and confirmed causes.

        The tolerances contain the change of each parameter by causes that are left out.

        Parameters
        ----------
        name : str
            Name of the rig.
        with_unconfirmed : bool
            Whether to add the causes that are not confirmed.
        with_term : bool
            Whether to add the proposed equation, if there is one. The rig then needs its effect file. It also
            has all causes that the equation was estimated with, confirmed or not.
        only : sequence of str, optional
            Ids of the named causes to add; by default the confirmed ones. The model is estimated again with
            these alone.
        """
        if with_term and self.proposal is not None:
            fit, term = self.proposal.evaluation.prediction.fit, self.proposal.term
            *named_causes, _equation = term.discovery.hypothesis.candidates
            causes = {
                candidate.id: cause_parameters(fit, self.kinds[candidate.id], candidate.effect.values)
                for candidate in named_causes
            }
            return extended_rig(name, fit, self.kinds, causes, term)
        if with_unconfirmed:
            fit = self.assessment.after.fit
            causes = {cause.effect: dict(cause.parameters) for cause in self.verdict.causes}
        elif only is not None:
            if self.replication.with_causes is not None:
                fit = self.replication.with_causes(only).fit
            else:
                assert not only, "the search was not pickled"
                fit = self.assessment.before.fit
            fit = widened(fit, self.assessment.after.fit)
            causes = {
                cause.effect: cause_parameters(fit, self.kinds[cause.effect], cause.candidate.effect.values)
                for cause in self.verdict.causes
                if cause.effect in only
            }
        else:
            fit = widened(self.replication.prediction.fit, self.assessment.after.fit)
            causes = {
                candidate.id: cause_parameters(fit, self.kinds[candidate.id], candidate.effect.values)
                for candidate in self.replication.model.candidates
                if candidate.id not in self.replication.unconfirmed
            }
        if with_unconfirmed or self.has_other_flight:
            causes |= self.random_torque
        return extended_rig(name, fit, self.kinds, causes, term=None)

    @property
    def has_converged_estimate(self) -> bool:
        """Whether the search for the parameters of the final model has converged."""
        return self.search.final.estimate.converged

    @property
    def has_converged_prediction(self) -> bool:
        """Whether the initial states of all free runs of the extended model have converged."""
        after = self.assessment.after
        return after.fit.converged and (after.held_out_fit is None or after.held_out_fit.converged)

    @property
    def has_other_flight(self) -> bool:
        """Whether a flight was held out; without one, no cause is confirmed."""
        return self.assessment.after.held_out_fit is not None
