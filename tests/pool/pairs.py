"""`python -m tests.pool.pairs`: benefit of the strongly excited flight of one rig for another rig of its
type.

Two rigs of one type fly in MuJoCo with disturbances and a rotor lag: one flight is strongly excited, the
other weakly. The parameters of the second rig are estimated from its flight with
the rig file as prior, and with the pooled prior from the first rig. Both estimates are evaluated on
another flight of each kind of the second rig, by the log-likelihood of the innovations and by open-loop
errors over 2 s. The true population, with the standard deviation between its rigs, gives the best result that
pooling can reach.
"""

import argparse
import json
import os
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from heli_benchmark.cases.disturbed import DisturbedCase
from heli_benchmark.effects.disturbances import CORRELATION_TIMES_s, DisturbanceModel, STRENGTHS_Nm
from heli_benchmark.effects.listed import RotorLag
from heli_benchmark.flights import CONTROLLERS
from heli_lab.apps.pool import ParameterEstimate, RigDiagnosis, pool, without_prior
from heli_lab.explain.comparison import Hypothesis, ModelComparison
from heli_lab.explain.prediction import FreeRun, free_runs, predict
from heli_lab.fit.records import Record, prepare
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import catalogue, effect_numbers, effects_of, parse_effects
from heli_sim.rig import Rig, load_rig

EXCITED_s, GENTLE_s, OTHER_s = 40.0, 15.0, 30.0
"""Durations of the excited rig's flight, of the gentle one's, and of the flights for evaluation [s]."""
_LAG: Final = "rotor_lag"
_BETWEEN_RIGS: Final = 0.3
"""Standard deviation between rigs of one type, over that between types."""
_LAG_BETWEEN_RIGS: Final = 0.1
"""Standard deviation of the logarithm of the lag between rigs of one type."""
_NORMAL: Final = {
    "thrust_gain": 0.08,
    "dead_zone": 0.06,
    **dict.fromkeys(("M_f", "M_b", "M_w", "M_h", "M_l"), 0.004),
    **dict.fromkeys((f"friction_{axis}" for axis in ("elevation", "pitch", "travel")), 0.4),
}
"""Standard deviations of the logarithms of parameters between rig types, about the rig file."""


@dataclass(frozen=True)
class RigCase(DisturbedCase):
    """Simulated rig of a random rig type."""

    population: int  # Seed of its type

    def rig(self) -> Rig:
        """Draw the rig type about the rig file, and the rig from its type."""
        population, rng = self.type_rig(), np.random.default_rng([self.seed, 1])
        off = {
            name: float(np.exp(std * _BETWEEN_RIGS * rng.standard_normal())) for name, std in _NORMAL.items()
        }
        return population.replace(**{name: population[name].value * item for name, item in off.items()})

    def type_rig(self) -> Rig:
        """Draw the rig type about the rig file."""
        rig, population = load_rig(self.rig_name), np.random.default_rng([self.population, 9])
        off = {name: float(np.exp(std * population.standard_normal())) for name, std in _NORMAL.items()}
        return rig.replace(**{name: rig[name].value * item for name, item in off.items()})


def _drawn(number: int) -> tuple[np.random.Generator, float]:
    """Return the random generator of a pair, and the lag of its rig type [s]."""
    rng = np.random.default_rng([8000 + number, 2])
    return rng, rng.uniform(0.05, 0.12)


def pair_cases(number: int) -> tuple[RigCase, RigCase]:
    """Return the cases of a pair: the excited rig and the gentle one."""
    rng, lag_s = _drawn(number)
    both = []
    for place, word in enumerate(("lively", "gentle")):
        lag_of_rig_s = float(lag_s * np.exp(_LAG_BETWEEN_RIGS * rng.standard_normal()))
        both.append(
            RigCase(
                f"pair-{number}-{word}",
                effects=((_LAG, lag_of_rig_s),),
                unlisted=(),
                seed=8000 + 2 * number + place,
                makers=(RotorLag,),
                rig_name="makki2024",
                rate_Hz=100,
                gentle=word == "gentle",
                controller=CONTROLLERS[int(rng.integers(3))],
                disturbances=DisturbanceModel(
                    STRENGTHS_Nm[int(rng.integers(3))], CORRELATION_TIMES_s[int(rng.integers(3))]
                ),
                population=8000 + number,
            )
        )
    return both[0], both[1]


def true_population(number: int) -> Rig:
    """Return the true rig type of a pair; tolerances are twice the standard deviation between its rigs."""
    excited, _ = pair_cases(number)
    population = excited.type_rig()
    _, lag_s = _drawn(number)
    numbers = dict(population.numbers)
    for name, std in _NORMAL.items():
        value = population[name].value
        numbers[name] = replace(population[name], tolerance=2.0 * _BETWEEN_RIGS * std * value)
    (name,) = catalogue()[_LAG].size
    lag = effect_numbers(
        catalogue()[_LAG], {name: lag_s}, {name: 2.0 * _LAG_BETWEEN_RIGS * lag_s}, "as drawn"
    )
    return Rig("drawn", "the true rig type", numbers, {_LAG: lag}, "multibody")


def compare_pair(number: int) -> dict[str, Any]:
    """Estimate and evaluate a pair with all priors.

    Returns
    -------
    dict
        For each evaluation flight, ``lively`` and ``gentle``, and each prior, ``by_file``, ``by_make`` and
        ``as_drawn``:

        - ``log_likelihood`` of the flight, with its constants and disturbances estimated;
        - ``deg``: open-loop RMS error over 2 s by axis;
        - ``normalised``: the same over all axes, in standard deviations of the quantisation.

        For each of the ``numbers``: true value, mean and standard deviation of the pooled prior.
    """
    nominal = load_rig("makki2024")
    excited, gentle = pair_cases(number)
    record = _record(excited, 0, EXCITED_s, nominal)
    model = MultibodyModel(parse_effects([f"{_LAG}=0.06"]))
    excited_fit = ModelComparison(model, nominal, [record], []).refit([])
    diagnosis = _diagnosis("lively", excited_fit)
    prior = pool([diagnosis]).prior_rig(nominal, "pooled")
    drawn = true_population(number)
    train = _record(gentle, 0, GENTLE_s, nominal)
    others = {
        "lively": _record(replace(gentle, gentle=False), 1, OTHER_s, nominal),
        "gentle": _record(gentle, 1, OTHER_s, nominal),
    }
    # The same reference trajectories for every prior.
    judges = {name: ModelComparison(model, nominal, [train], [other]) for name, other in others.items()}
    answer: dict[str, Any] = {name: {} for name in others}
    for prior_name, rig, trial_model in (
        ("by_file", nominal, model),
        ("by_make", prior, MultibodyModel(effects_of(prior))),
        ("as_drawn", drawn, MultibodyModel(effects_of(drawn))),
    ):
        hypothesis = ModelComparison(trial_model, rig, [train], []).refit([])
        fit = predict(hypothesis.estimate, [train], ()).fit
        for name, other in others.items():
            (run,) = free_runs(fit, [other])
            held_out = judges[name].held_out_estimate(hypothesis)
            answer[name][prior_name] = _errors(run, other) | {"log_likelihood": held_out.log_likelihood}
    answer["numbers"] = {
        name: [item.value, prior[name].value, 0.5 * prior[name].tolerance]
        for name, item in gentle.rig().items()
    }
    return answer


def _record(case: DisturbedCase, flight: int, seconds: float, nominal: Rig) -> Record:
    return prepare(case.fly(flight, seconds)[0], nominal, f"{case.name} {flight}")


def _diagnosis(label: str, hypothesis: Hypothesis) -> RigDiagnosis:
    """Return the diagnosis of a rig whose cause is the rotor lag."""
    estimate = hypothesis.estimate
    std = np.sqrt(np.diag(estimate.covariance))
    priors, numbers = {}, {}
    for i, item in enumerate(estimate.parameter_vector.free):
        if item.is_shared:
            priors[item.name] = ParameterEstimate(item.prior.mean, item.prior.std, item.unit)
            from_flights = without_prior(float(estimate.theta[i]), float(std[i]), priors[item.name])
            if from_flights is not None:
                numbers[item.name] = from_flights
    return RigDiagnosis(
        label,
        rig="makki2024",
        model="multibody",
        parameters=numbers,
        priors=priors,
        causes={_LAG: 1.0},
        undetectable=(),
        is_explained=True,
    )


def _errors(run: FreeRun, record: Record) -> dict[str, Any]:
    rms_deg = run.errors["2"].rms_deg
    return {
        "deg": rms_deg.tolist(),
        "normalised": float(np.sqrt(np.mean((np.deg2rad(rms_deg) / record.sigma_rad) ** 2))),
    }


def summary(rows: Sequence[dict[str, Any]]) -> str:
    """Count the pairs in which the pooled prior predicts the gentle rig better than the rig file."""
    lines = []
    for name in ("lively", "gentle"):
        for prior, label in (("by_make", "pooled prior"), ("as_drawn", "true rig type as prior")):
            ratios = [row[name][prior]["normalised"] / row[name]["by_file"]["normalised"] for row in rows]
            nats = [
                row[name][prior]["log_likelihood"] - row[name]["by_file"]["log_likelihood"] for row in rows
            ]
            lines.append(
                f"{label}, another {name} flight of the gentle rig: more likely in "
                f"{sum(n > 0.0 for n in nats)} of {len(nats)}, by {np.median(nats):.1f} nats "
                f"({min(nats):.1f} to {max(nats):.1f}); smaller error in {sum(r < 1.0 for r in ratios)}, "
                f"ratio {np.median(ratios):.3f} ({min(ratios):.3f} to {max(ratios):.3f})"
            )
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the pairs that are missing in the JSON file, and print a summary; return 0."""
    parser = argparse.ArgumentParser(prog="python -m tests.pool.pairs", description=__doc__)
    parser.add_argument("--pairs", type=int, default=20)
    parser.add_argument("--json", type=Path, default=Path("pairs.json"))
    given = parser.parse_args(arguments)
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    rows: dict[str, dict[str, Any]] = json.loads(given.json.read_text()) if given.json.exists() else {}
    for number in range(given.pairs):
        if str(number) in rows:
            continue
        started_s = time.process_time()
        rows[str(number)] = compare_pair(number)
        given.json.write_text(json.dumps(rows, indent=1) + "\n")
        print(
            f"pair {number}: {time.process_time() - started_s:.0f} s; {_summary_line(rows[str(number)])}",
            flush=True,
        )
    print(summary(list(rows.values())))
    return 0


def _summary_line(row: dict[str, Any]) -> str:
    return "; ".join(
        f"{name} {row[name]['by_file']['normalised']:.3g} with the file, "
        f"{row[name]['by_make']['normalised']:.3g} with the pooled prior, "
        f"{row[name]['by_make']['log_likelihood'] - row[name]['by_file']['log_likelihood']:.1f} nats"
        for name in ("lively", "gentle")
    )


if __name__ == "__main__":
    sys.exit(main())
