"""Quality of a proposed equation: against the true torque, and against a fit with the true equation."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import casadi as ca
import numpy as np
from heli_host.data.arrays import Floats
from heli_host.data.flight import Flight
from heli_lab.diagnose import Diagnosis
from heli_lab.explain.candidates import Candidate, typical_candidate
from heli_lab.explain.comparison import Hypothesis, ModelComparison
from heli_lab.explain.contributions import accelerations
from heli_lab.explain.prediction import compare_free_runs, free_runs, predict
from heli_lab.explain.terms import NAME
from heli_lab.fit.records import prepare
from heli_sim.model import MultibodyModel
from heli_sim.model.effect import Effect, Operands, Stage
from heli_sim.model.effects import catalogue
from heli_sim.rig import Prior, Quantity, load_rig

from heli_benchmark.cases.clean import VALIDATE_S
from heli_benchmark.cases.disturbed_case import DisturbedCase
from heli_benchmark.effects.equations import EQUATIONS, EquationInputs, TrueEquation, Unlisted
from heli_benchmark.reference.equation_torque import torque_correlation, true_torque_Nm
from heli_benchmark.reference.replay import inertia_kg_m2
from heli_benchmark.runs.ask import REFITS, run_diagnosis

_AXES = ("elevation", "pitch", "travel")


@dataclass(frozen=True)
class TrueEquationEffect(Effect):
    """The true `equation` as an effect of a model: its size is free, its other `numbers` are the true ones.

    The other fields are those of `Effect`.
    """

    equation: TrueEquation = field(default_factory=lambda: EQUATIONS["pitch_by_elevation"])
    numbers: Mapping[str, float] = field(default_factory=dict)

    def __hash__(self) -> int:
        return hash((self.name, tuple(self.values.items())))

    def _input_symbols(self, at: Operands) -> EquationInputs:
        """Return the arguments of the equation as symbols."""
        q = [at.state[f"{axis}_rad"] for axis in _AXES]
        w = [at.state[f"{axis}_rate_rad_s"] for axis in _AXES]
        late = self.value(at, "late") if self.states else 0.0
        return EquationInputs(q, w, [at.thrust_N[0], at.thrust_N[1]], late)

    def _value(self, at: Operands) -> ca.SX:
        value: ca.SX = self.value(at, "size") * self.equation.value(ca, self._input_symbols(at), self.numbers)
        return value

    def torque_Nm(self, at: Operands) -> ca.SX:
        kind, _, acting_axis = self.equation.channel.partition(".")
        if kind != "torque":
            return ca.SX.zeros(3)
        return ca.vertcat(*(self._value(at) if axis == acting_axis else ca.SX(0) for axis in _AXES))

    def thrust_N(self, at: Operands, thrust_N: ca.SX) -> ca.SX:
        kind, _, rotors = self.equation.channel.partition(".")
        if kind != "thrust":
            return thrust_N
        shares = {"both": (1.0, 1.0), "front": (1.0, 0.0), "back": (0.0, 1.0)}[rotors]
        return thrust_N * (1.0 + self._value(at) * ca.DM(shares))

    def state_rates(self, at: Operands) -> ca.SX:
        if not self.states:
            return ca.SX.zeros(0)
        assert self.equation.remembers is not None
        inputs = self._input_symbols(at)
        return ca.SX((self.equation.remembers(inputs) - inputs.late) / self.numbers["lag_s"])


def true_equation_effect(hidden: Unlisted) -> TrueEquationEffect:
    """Create the effect of a hidden equation."""
    states = (Quantity("true_equation_late", "1", "output of its lag"),) if hidden.equation.remembers else ()
    stage = Stage.TORQUE if hidden.equation.channel.startswith("torque") else Stage.INFLOW
    return TrueEquationEffect(
        "true_equation",
        parameters=(Quantity("true_equation_size", "1", "size of the equation"),),
        values={"true_equation_size": hidden.size},
        priors={"true_equation_size": Prior(0.0, 3.0 * abs(hidden.size))},
        states=states,
        stage=stage,
        equation=hidden.equation,
        numbers=hidden.numbers,
    )


def judge_equation(
    case: DisturbedCase, flights: tuple[Flight, Flight], refits: int = REFITS
) -> dict[str, Any]:
    """Diagnose a case, and compare the proposed equation with the truth."""
    rig = load_rig(case.rig_name)
    diagnosis = run_diagnosis(rig, flights, refits)
    proposed = diagnosis.proposed_term
    answer: dict[str, Any] = {
        "verdict": diagnosis.label,
        "causes": [cause.candidate.id for cause in diagnosis.verdict.causes],
        "channel": None,
        "expression": None,
        "seconds": diagnosis.effort.seconds,
    }
    unlisted = [effect for effect in case.hidden(0) if isinstance(effect, Unlisted)]
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
    true_s, true_Nm = true_torque_Nm(case, 1, VALIDATE_S)
    proposed_s, proposed_Nm = equation_torque_Nm(comparison, proposed.discovery.hypothesis, case)
    axis, correlation = torque_correlation(true_s, true_Nm, proposed_s, proposed_Nm)
    answer["axis"] = _AXES[axis]
    answer["correlation"] = correlation
    answer["error_ratio"] = _error_ratio(comparison, diagnosis, case, unlisted[0], axis)
    return answer


def equation_torque_Nm(
    comparison: ModelComparison, hypothesis: Hypothesis, case: DisturbedCase
) -> tuple[Floats, Floats]:
    """Return times and torques of a proposed equation along the validation flight, shapes (n,) and (n, 3)."""
    estimate = comparison.held_out_estimate(hypothesis)
    times_s, change_rad_s2 = accelerations(estimate, NAME)
    (linear,) = estimate.filtered().linearised_flights
    inertia = inertia_kg_m2(case.rig(), linear.trajectory.state[:, :3])
    return times_s, np.asarray(np.einsum("nij,nj->ni", inertia, change_rad_s2), float)


def _error_ratio(
    comparison: ModelComparison, diagnosis: Diagnosis, case: DisturbedCase, hidden: Unlisted, axis: int
) -> float:
    """Error over 2 s of the validation flight, divided by that of the fit with the true equation."""
    assert diagnosis.proposal is not None
    truth = Candidate("true_equation", true_equation_effect(hidden), ("true_equation_size",))
    informed_deg = informed_errors_deg(
        comparison, [*listed_candidates(name for name, _ in case.effects), truth]
    )
    return diagnosis.proposal.evaluation.reductions[_AXES[axis]].after_deg / informed_deg[_AXES[axis]]


def listed_candidates(names: Iterable[str]) -> list[Candidate]:
    """Return effects of the catalogue by `names`, with their typical sizes as start values."""
    kinds = catalogue()
    return [typical_candidate(kinds[name]) for name in names]


def informed_errors_deg(comparison: ModelComparison, candidates: Sequence[Candidate]) -> dict[str, float]:
    """Return errors over 2 s of the validation flight by axis, of a fit with the true causes, degrees."""
    start = {name: value for candidate in candidates for name, value in candidate.effect.values.items()}
    hypothesis = comparison.refit(candidates, start, comparison.refit([]))
    fit = predict(hypothesis.estimate, comparison.train, comparison.held_out).fit
    runs = free_runs(fit, comparison.held_out)
    return {axis: error.after_deg for axis, error in compare_free_runs(runs, runs, 0).horizons["2"].items()}
