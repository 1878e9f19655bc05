"""`python -m heli_benchmark.runs.equations`: count how many unlisted equations a diagnosis discovers."""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
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

from heli_benchmark.cases.clean import VALIDATE_S, add_choice, chosen
from heli_benchmark.cases.disturbed import DisturbedCase
from heli_benchmark.effects.disturbances import CORRELATION_TIMES_s, DisturbanceModel, STRENGTHS_Nm
from heli_benchmark.effects.listed import LISTED, Maker
from heli_benchmark.effects.unlisted import EQUATIONS, EquationInputs, MakeUnlisted, TrueEquation, Unlisted
from heli_benchmark.flights import CONTROLLERS
from heli_benchmark.judge import MIN_VISIBILITY_STD
from heli_benchmark.runs.case import REFITS, run_diagnosis
from heli_benchmark.visibility import inertia_kg_m2, torque_correlation, true_torque_Nm

_SIZES = {"large": 1.6, "small": 1.0}
_LARGER = (0.7, 1.0, 1.6)
"""Factors of the sizes by strength of the disturbances, as in `disturbed.py`."""
_LAG_s = 0.1
_RATES_Hz = (100, 250)


def equation_cases() -> list[DisturbedCase]:
    """Return all cases, in an order in which the first are a fair sample of all."""
    cases = []
    for number, (size, equation) in enumerate((size, equation) for size in _SIZES for equation in EQUATIONS):
        seed = 5000 + number
        rng = np.random.default_rng([seed, 6])  # 6: a stream that no other draws use
        strength = int(rng.integers(3))
        disturbances = DisturbanceModel(STRENGTHS_Nm[strength], CORRELATION_TIMES_s[int(rng.integers(3))])
        has_lag = bool(number % 2)  # in each second case
        makers: tuple[Maker, ...] = (MakeUnlisted(equation),)
        cases.append(
            DisturbedCase(
                f"law-{equation}-{size}",
                effects=(("rotor_lag", _LAG_s),) if has_lag else (),
                unlisted=((equation, EQUATIONS[equation].size * _SIZES[size] * _LARGER[strength]),),
                seed=seed,
                makers=(LISTED["rotor_lag"].maker, *makers) if has_lag else makers,
                rig_name="makki2024",
                rate_Hz=int(rng.choice(_RATES_Hz)),
                gentle=False,
                controller=CONTROLLERS[int(rng.integers(3))],
                disturbances=disturbances,
            )
        )
    fixed_order = np.random.default_rng(4).permutation(len(cases))
    return [cases[i] for i in fixed_order]


_AXES = ("elevation", "pitch", "travel")


@dataclass(frozen=True)
class TrueEquationEffect(Effect):
    """The true `equation` as an effect of a model: its size is free, its other `numbers` are the true
    ones.
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
            "nats": [proposed.discovery.train_nats, proposed.discovery.held_out_nats],
        }
    if proposed is None or not unlisted:
        return answer  # nothing to compare
    training, held_out = (prepare(flight, rig, label) for flight, label in zip(flights, "ab", strict=True))
    comparison = ModelComparison(MultibodyModel(), rig, [training], [held_out])
    true_s, true_Nm = true_torque_Nm(case, 1, VALIDATE_S)  # along the held-out flight
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


MIN_CORRELATION, MAX_ERROR_RATIO = 0.9, 1.3
"""Limits within which an equation counts as right: its correlation with the true torque, and the error of a
free run with it relative to a fit with the true equation."""
EquationRow = dict[str, Any]
"""Results of a case for JSON; ``failure`` if an error ended it."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the cases and count the results."""
    parser = argparse.ArgumentParser(prog="python -m heli_benchmark.runs.equations", description=__doc__)
    add_rows(parser, Path("equations.json"))
    parser.add_argument("--nothing", action="store_true", help="run cases without an unlisted equation")
    parser.add_argument("--seen", action="store_true", help="diagnose only visible equations")
    options = parser.parse_args(arguments)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from heli_benchmark.cases.disturbed import disturbed_cases

    cases = [case for case in disturbed_cases() if not case.unlisted] if options.nothing else equation_cases()
    rows = judge_rows(chosen(cases, options), judge_equation, _describe_row, options)
    print(equation_summary(rows))
    return 0 if all("failure" not in row for row in rows.values()) else 1


def add_rows(parser: argparse.ArgumentParser, json_file: Path) -> None:
    """Add to a `parser` the options of `judge_rows` and `chosen`; `json_file` is the default output."""
    add_choice(parser)
    parser.add_argument("--keep", action="store_true", help="use flights that exist")
    parser.add_argument("--json", type=Path, default=json_file)
    parser.set_defaults(visibilities=False)


def judge_rows(
    cases: Sequence[DisturbedCase],
    judge: Callable[[DisturbedCase, tuple[Flight, Flight]], EquationRow],
    describe: Callable[[EquationRow], str],
    options: argparse.Namespace,
) -> dict[str, EquationRow]:
    """Judge the cases that the JSON file lacks, and write it after each."""
    from heli_benchmark.runs.case import prepare

    rows: dict[str, EquationRow] = json.loads(options.json.read_text()) if options.json.exists() else {}
    for case in cases:
        if case.name in rows:
            continue  # judged by an earlier run
        started_s = time.process_time()
        try:
            prepared = prepare(case, options.folder, keep=options.keep)
            reference = prepared.reference
            row: EquationRow = {"visibility": reference if isinstance(reference, dict) else {}}
            if options.seen and not is_visible(row):
                print(f"{case.name}: not visible, {row['visibility']}", flush=True)
                continue
            row |= judge(case, prepared.flights)
        except Exception as error:  # noqa: BLE001 - an error in one case must not end the others
            row = {"failure": f"{type(error).__name__}: {error}"}
        row["cpu_seconds"] = time.process_time() - started_s
        rows[case.name] = row
        options.json.write_text(json.dumps(rows, indent=1, default=float) + "\n")
        print(f"{case.name}: {describe(row)}", flush=True)
    return rows


def is_visible(row: EquationRow) -> bool:
    """Return whether the equation of a case, by its `row`, is visible enough to count."""
    visibilities_std = [std for name, std in row["visibility"].items() if name.startswith("off-")]
    return min(visibilities_std, default=0.0) >= MIN_VISIBILITY_STD


def _describe_row(row: EquationRow) -> str:
    """Return one line: visibility of each cause, verdict, equation and how well it agrees with the truth."""
    if "failure" in row:
        return str(row["failure"])
    visibilities = ", ".join(f"{name} {z:.0f}" for name, z in row["visibility"].items())
    expression = row["expression"] or "no equation"
    numbers = ""
    if "correlation" in row:
        numbers = f"; correlation {row['correlation']:.3f}, error {row['error_ratio']:.2f} of informed"
    return (
        f"[{visibilities}] {row['verdict']}, {', '.join(row['causes']) or 'no cause'}: {expression}{numbers}"
    )


def equation_summary(rows: dict[str, EquationRow]) -> str:
    """Count the hidden equations that were proposed, and the equations that were proposed without a
    reason.
    """
    equations = [
        row
        for name, row in rows.items()
        if name.startswith("law-") and "failure" not in row and is_visible(row)
    ]
    others = [row for name, row in rows.items() if not name.startswith("law-") and "failure" not in row]
    proposed = [row for row in equations if row["expression"]]
    correlated = [row for row in equations if row.get("correlation", 0.0) >= MIN_CORRELATION]
    accurate = [row for row in equations if row.get("error_ratio", 99.0) <= MAX_ERROR_RATIO]
    return (
        f"visible equations: {len(equations)}, proposed {len(proposed)}, "
        f"correlation of {MIN_CORRELATION} and more {len(correlated)}, "
        f"error within {MAX_ERROR_RATIO} of informed {len(accurate)}; proposed where none is hidden: "
        f"{sum(bool(row['expression']) for row in others)} of {len(others)}"
    )


if __name__ == "__main__":
    sys.exit(main())
