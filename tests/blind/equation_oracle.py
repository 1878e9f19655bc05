"""How good a proposed law is: against the true torque on the flight held out, and a fit told the law.

With `oracle.py` the only files of this room that use the project's models.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np
from heli_host.arrays import Floats
from heli_host.flight import Flight
from heli_lab.diagnose import Diagnosis
from heli_lab.diagnose.discover import NAME, accelerations
from heli_lab.diagnose.evaluate import compare_free_runs, free_runs, predict
from heli_lab.diagnose.search import Candidate, Hypothesis, ModelComparison, typical_candidate
from heli_lab.identify import prepare
from heli_sim.model import MultibodyModel
from heli_sim.model.effect import Effect, Operands, Stage
from heli_sim.model.effects import catalogue
from heli_sim.rig import Prior, Quantity, load_rig

from tests.blind.cases import VALIDATE_S
from tests.blind.disturbed_case import DisturbedCase
from tests.blind.equations import LAWS, Seen, TrueLaw, Unlisted
from tests.blind.replay import FINE, GRID_S, Rebuilt, inertia_kg_m2, steps
from tests.blind.run import REFITS, found_in

_AXES = ("elevation", "pitch", "travel")


@dataclass(frozen=True)
class ToldLaw(Effect):
    """A true law as an effect, its size free and its further numbers as they are."""

    equation: TrueLaw = field(default_factory=lambda: LAWS["pitch_by_elevation"])
    numbers: Mapping[str, float] = field(default_factory=dict)

    def __hash__(self) -> int:
        return hash((self.name, tuple(self.values.items())))

    def _seen(self, at: Operands) -> Seen:
        q = [at.state[f"{axis}_rad"] for axis in _AXES]
        w = [at.state[f"{axis}_rate_rad_s"] for axis in _AXES]
        late = self.own(at, "late") if self.states else 0.0
        return Seen(q, w, [at.thrust_N[0], at.thrust_N[1]], late)

    def _value(self, at: Operands) -> ca.SX:
        value: ca.SX = self.own(at, "size") * self.equation.value(ca, self._seen(at), self.numbers)
        return value

    def torque_Nm(self, at: Operands) -> ca.SX:
        kind, _, where = self.equation.channel.partition(".")
        on = kind == "torque"
        return ca.vertcat(*(self._value(at) if on and where == axis else ca.SX(0) for axis in _AXES))

    def thrust_N(self, at: Operands, thrust_N: ca.SX) -> ca.SX:
        kind, _, where = self.equation.channel.partition(".")
        if kind != "thrust":
            return thrust_N
        on = {"both": (1.0, 1.0), "front": (1.0, 0.0), "back": (0.0, 1.0)}[where]
        return thrust_N * (1.0 + self._value(at) * ca.DM(on))

    def state_rates(self, at: Operands) -> ca.SX:
        if not self.states:
            return ca.SX.zeros(0)
        assert self.equation.remembers is not None
        seen = self._seen(at)
        return ca.SX((self.equation.remembers(seen) - seen.late) / self.numbers["lag_s"])


def told_effect(hidden: Unlisted) -> ToldLaw:
    """Make the effect of a law that is hidden."""
    states = (Quantity("told_law_late", "1", "behind a lag"),) if hidden.equation.remembers else ()
    stage = Stage.TORQUE if hidden.equation.channel.startswith("torque") else Stage.INFLOW
    return ToldLaw(
        "told_law",
        parameters=(Quantity("told_law_size", "1", "size of the law"),),
        values={"told_law_size": hidden.size},
        priors={"told_law_size": Prior(0.0, 3.0 * abs(hidden.size))},
        states=states,
        stage=stage,
        equation=hidden.equation,
        numbers=hidden.numbers,
    )


def true_torque_Nm(case: DisturbedCase) -> tuple[Floats, Floats]:
    """Times and torques of the hidden law along the flight held out, (n,) and (n, 3): by what MuJoCo does
    without it.
    """
    course = case.flown(1, VALIDATE_S)[1]
    rig = case.rig()
    every = case.hidden(1)
    acting, rest = Rebuilt(rig, every), Rebuilt(rig, _without_law(case.hidden(1)))
    with_it = acting.accelerations(course, acting.forces(course), FINE)
    without = rest.accelerations(course, rest.forces(course), FINE)
    halves = len(course.time_s) // steps(course)
    middle = slice(halves // 2, steps(course) * halves, halves)
    inertia = inertia_kg_m2(rig, course.angles_rad[middle])
    torque = np.einsum("nij,nj->ni", inertia, with_it - without)
    return np.asarray(GRID_S * (np.arange(len(torque)) + 0.5), float), np.asarray(torque, float)


def _without_law(hidden: list[Any]) -> list[Any]:
    return [one for one in hidden if not isinstance(one, Unlisted)]


def judged_law(case: DisturbedCase, flights: tuple[Flight, Flight], refits: int = REFITS) -> dict[str, Any]:
    """Diagnose a case and hold the law that is proposed against the truth.

    Parameters
    ----------
    case : DisturbedCase
        The case.
    flights : tuple of Flight
        The flight to fit and the one to hold out.
    refits : int
        Most refits of the search.

    Returns
    -------
    dict
        ``verdict``, ``causes``, ``channel`` and ``expression`` of the law (None where none is proposed),
        ``correlation`` of its torques with the true ones along the flight held out, ``error_ratio``: its
        free-run error there over that of a fit told the law, about the axis that the law acts on most.
    """
    rig = load_rig(case.rig_name)
    found = found_in(rig, flights, refits)
    proposed = found.proposed_term
    answer: dict[str, Any] = {
        "verdict": found.label,
        "causes": [one.candidate.id for one in found.verdict.causes],
        "channel": None,
        "expression": None,
        "seconds": found.effort.seconds,
    }
    unlisted = [one for one in case.hidden(0) if isinstance(one, Unlisted)]
    if proposed is not None:
        answer |= {
            "channel": proposed.equation.channels[0],
            "expression": proposed.sentence,
            "confidence": proposed.confidence,
            "nats": [proposed.discovery.train, proposed.discovery.held_out],
        }
    if proposed is None or not unlisted:
        return answer
    records = [prepare(flight, rig, label) for flight, label in zip(flights, "ab", strict=True)]
    comparison = ModelComparison(MultibodyModel(), rig, records[:1], records[1:])
    time_s, truth = true_torque_Nm(case)
    seen_s, law = law_torque_Nm(comparison, proposed.discovery.hypothesis, case)
    there = (time_s >= seen_s[0]) & (time_s <= seen_s[-1])
    at = np.column_stack([np.interp(time_s[there], seen_s, law[:, i]) for i in range(3)])
    axis = int(np.argmax(truth[there].std(axis=0)))
    answer["axis"] = _AXES[axis]
    answer["correlation"] = float(np.corrcoef(truth[there][:, axis], at[:, axis])[0, 1])
    answer["error_ratio"] = _over_told(comparison, found, case, unlisted[0], axis)
    return answer


def law_torque_Nm(
    comparison: ModelComparison, hypothesis: Hypothesis, case: DisturbedCase
) -> tuple[Floats, Floats]:
    """Times and torques of a proposed law along the flight held out, (n,) and (n, 3)."""
    estimate = comparison.held_out_estimate(hypothesis)
    seen_s, change = accelerations(estimate, NAME)
    (linear,) = estimate.filtered().linearised_flights
    inertia = inertia_kg_m2(case.rig(), linear.trajectory.state[:, :3])
    return seen_s, np.asarray(np.einsum("nij,nj->ni", inertia, change), float)


def _over_told(
    comparison: ModelComparison, found: Diagnosis, case: DisturbedCase, hidden: Unlisted, axis: int
) -> float:
    """Held-out error over 2 s with the proposed law over that of the fit told the law."""
    assert found.proposal is not None
    told = Candidate("told_law", told_effect(hidden), ("told_law_size",))
    reached = told_errors_deg(comparison, [*listed(name for name, _ in case.effects), told])
    return found.proposal.evaluation.reductions[_AXES[axis]].after_deg / reached[_AXES[axis]]


def listed(names: Iterable[str]) -> list[Candidate]:
    """Effects of the catalogue for a fit to be told, from their typical sizes."""
    kinds = catalogue()
    return [typical_candidate(kinds[name]) for name in names]


def told_errors_deg(comparison: ModelComparison, candidates: Sequence[Candidate]) -> dict[str, float]:
    """Held-out errors over 2 s by axis of a fit that is told what is hidden."""
    start = {name: value for one in candidates for name, value in one.effect.values.items()}
    hypothesis = comparison.refit(candidates, start, comparison.refit([]))
    fit = predict(hypothesis.estimate, comparison.train, comparison.held_out).fit
    runs = free_runs(fit, comparison.held_out)
    return {axis: one.after_deg for axis, one in compare_free_runs(runs, runs, 0).horizons["2"].items()}


__all__ = ["judged_law", "law_torque_Nm", "listed", "told_effect", "told_errors_deg", "true_torque_Nm"]
