"""Backward elimination: drop causes that are no longer needed, and measure the evidence of the others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from heli_lab.diagnose import thresholds
from heli_lab.diagnose.search.acceptance import Acceptance
from heli_lab.diagnose.search.candidate import Candidate, may_join
from heli_lab.diagnose.search.hypothesis import Alternative, Cause, Hypothesis, Refit, Round
from heli_lab.diagnose.search.model_comparison import ModelComparison
from heli_lab.diagnose.search.moments import with_held_out_moments
from heli_lab.diagnose.search.progress import Progress
from heli_lab.threads import parallel_map


@dataclass
class BackwardElimination:
    """Removes causes from the model that forward selection ended with.

    Parameters
    ----------
    baseline : Hypothesis
        The model without any cause.
    rounds : sequence of Round
        The rounds of the forward selection.
    """

    comparison: ModelComparison
    acceptance: Acceptance
    progress: Progress
    baseline: Hypothesis
    rounds: Sequence[Round]

    def eliminate(self, final: Hypothesis) -> tuple[Hypothesis, list[Cause]]:
        """Return the model `final` with the causes alone that are needed and that held-out flights do not
        contradict, and the evidence of each cause, the strongest first.
        """
        final, without = self._needed(with_held_out_moments(self.comparison, final))
        held_out = self._held_out(final, without)
        against = min(held_out, key=lambda id_: held_out[id_], default=None)
        if against is not None and held_out[against] < thresholds.HELD_OUT_AGAINST:
            return self.eliminate(self.restore_displaced(final, against, without[against]))
        causes = [
            Cause(
                candidate,
                final.log_likelihood - without[candidate.id].log_likelihood,
                held_out.get(candidate.id),
                self.acceptance.penalty(candidate),
                self._alternatives(final, candidate, without[candidate.id]),
            )
            for candidate in final.candidates
        ]
        return final, sorted(causes, key=lambda cause: -cause.train)

    def restore_displaced(self, final: Hypothesis, against: str, less: Hypothesis) -> Hypothesis:
        """Return the model without a cause that held-out flights contradict, and with what that had
        displaced.

        A spline may have followed a peculiarity of one flight. The causes before its round come back, and the
        best accepted effect of its round.

        Parameters
        ----------
        final : Hypothesis
            The model with the cause.
        against : str
            Id of the cause.
        less : Hypothesis
            The model without it.
        """
        round_ = next((round_ for round_ in self.rounds if round_.accepted_id == against), None)
        gone = next(candidate for candidate in final.candidates if candidate.id == against)
        if not gone.is_spline or round_ is None:
            return less
        displaced = list(round_.base.candidates)
        displaced += [refit.candidate for refit in round_.refits if self.acceptance.accepts(refit)][:1]
        present, back = list(less.ids), list[Candidate]()
        for candidate in displaced:
            # A cause that was accepted after the spline may exclude an effect from before.
            if (
                not candidate.is_spline
                and candidate.id not in present
                and may_join(candidate.id, present, self.acceptance.kinds)
            ):
                back.append(candidate)
                present.append(candidate.id)
        if not back:
            return less
        start = {**round_.base.values, **less.values}
        return self.comparison.refit([*less.candidates, *back], start, less)

    def _needed(self, final: Hypothesis) -> tuple[Hypothesis, dict[str, Hypothesis]]:
        """The model with the causes alone that are needed, and by each of their ids the model without it."""
        while True:
            candidates = final.candidates
            without: dict[str, Hypothesis] = {}
            less = final
            for number, candidate in enumerate(candidates):
                self.progress.check(candidate.id, number, len(candidates))
                others = [other for other in candidates if other is not candidate]
                less = self.comparison.refit(others, None, final) if others else self.baseline
                gain = final.log_likelihood - less.log_likelihood
                refit = Refit(final, gain, self.acceptance.penalty(candidate), 0.0)
                if refit.margin <= thresholds.MIN_MARGIN or not self.acceptance.is_significant(
                    refit, candidate
                ):
                    break
                without[candidate.id] = less
            if len(without) == len(candidates):
                return final, without
            final = less

    def _held_out(self, final: Hypothesis, without: Mapping[str, Hypothesis]) -> dict[str, float]:
        """Log-likelihood ratio of each cause on the held-out flights, nats, by id."""
        if not self.comparison.held_out or not without:
            return {}
        estimates = parallel_map(self.comparison.held_out_estimate, [final, *without.values()])
        whole, *less = (estimate.log_likelihood for estimate in estimates)
        return {id_: whole - log_likelihood for id_, log_likelihood in zip(without, less, strict=True)}

    def _alternatives(
        self, final: Hypothesis, candidate: Candidate, less: Hypothesis
    ) -> tuple[Alternative, ...]:
        """Other effects in the place of a cause of the final model, the closest first."""
        if candidate.is_spline:
            return ()
        round_ = next((round_ for round_ in self.rounds if round_.accepted_id == candidate.id), None)
        if round_ is None:
            return ()
        others = [other for other in final.candidates if other is not candidate]
        likely = self._likely_alternatives(final, others, round_)
        ratios: dict[str, float] = {}
        for refit in likely:
            if len(ratios) >= thresholds.ALTERNATIVES or (others and not self.progress.refits_left()):
                break
            other = refit.hypothesis
            if others:
                other = self.comparison.refit([*others, refit.candidate], refit.hypothesis.values, less)
            if not self.comparison.in_flight(other):
                continue
            ratio = final.log_likelihood - other.log_likelihood
            ratios[refit.candidate.id] = (
                ratio + self.acceptance.penalty(refit.candidate) - self.acceptance.penalty(candidate)
            )
        return tuple(
            Alternative(id_, ratio) for id_, ratio in sorted(ratios.items(), key=lambda item: item[1])
        )

    def _likely_alternatives(
        self, final: Hypothesis, rest: Sequence[Candidate], round_: Round
    ) -> list[Refit]:
        """Refits of a round that may be tried together with the other causes `rest`, the best score first."""
        kinds = self.acceptance.kinds
        best = max(refit.score for refit in round_.refits)

        def possible(refit: Refit) -> bool:
            if refit.score < thresholds.ALTERNATIVE_SHARE * best:
                return False
            return may_join(refit.candidate.id, [other.id for other in rest], kinds)

        return [
            refit
            for refit in sorted(round_.refits, key=lambda refit: -refit.score)
            if refit.candidate.id not in final.ids
            and not refit.candidate.is_spline
            and (not rest or possible(refit))
        ]
