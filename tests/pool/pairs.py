"""`python -m tests.pool.pairs`: what a lively machine's flight is worth to another machine that flew gently.

Two machines of one make fly in MuJoCo, in weather, behind a rotor lag: one lively, the other gently. The
gentle one's numbers are estimated from its flight with the rig's file as the prior, and with what the pool
makes of the lively machine. Both are held against another lively flight of the gentle machine, and against
another gentle one: by the log-likelihood of its innovations, and by free runs over 2 s, of which weather is
most. So is what no pool can be better than: the make as it was drawn, with the spread of its machines.
"""

from __future__ import annotations

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
from heli_lab.diagnose.evaluate import FreeRun, free_runs, predict
from heli_lab.diagnose.search import Hypothesis, ModelComparison
from heli_lab.identify import Record, prepare
from heli_lab.pool import pool
from heli_lab.pool.machine import Estimate, Machine, by_flights_alone
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import catalogue, effect_numbers, effects_of, parse_effects
from heli_sim.rig import Rig, load_rig

from tests.blind.disturbances import DisturbanceModel, MEMORIES_s, STRENGTHS_Nm
from tests.blind.disturbed_case import DisturbedCase
from tests.blind.hidden import RotorLag
from tests.blind.tracking import CONTROLLERS

LIVELY_s, GENTLE_s, OTHER_s = 40.0, 15.0, 30.0
"""Lengths of the lively machine's flight, of the gentle one's, and of those that neither fit saw."""
_LAG: Final = "rotor_lag"
_AMONG_MACHINES: Final = 0.3
"""Standard deviation among the machines of a make, over that among makes."""
_LAG_AMONG_MACHINES: Final = 0.1
"""Standard deviation of the logarithm of the lag among the machines of a make."""
_NORMAL: Final = {
    "thrust_gain": 0.08,
    "dead_zone": 0.06,
    **dict.fromkeys(("M_f", "M_b", "M_w", "M_h", "M_l"), 0.004),
    **dict.fromkeys((f"friction_{axis}" for axis in ("elevation", "pitch", "travel")), 0.4),
}
"""Standard deviations of the logarithms of the makes' numbers about the file's."""


@dataclass(frozen=True)
class MachineCase(DisturbedCase):
    """A machine of a make.

    Parameters
    ----------
    make : int
        Seed of the make.
    """

    make: int

    def rig(self) -> Rig:
        """Draw the make from what the file says, and the machine from the make."""
        make, own = self.make_rig(), np.random.default_rng([self.seed, 1])
        off = {
            name: float(np.exp(std * _AMONG_MACHINES * own.standard_normal()))
            for name, std in _NORMAL.items()
        }
        return make.replace(**{name: make[name].value * one for name, one in off.items()})

    def make_rig(self) -> Rig:
        """Draw the make from what the file says."""
        rig, make = load_rig(self.rig_name), np.random.default_rng([self.make, 9])
        off = {name: float(np.exp(std * make.standard_normal())) for name, std in _NORMAL.items()}
        return rig.replace(**{name: rig[name].value * one for name, one in off.items()})


def _drawn(number: int) -> tuple[np.random.Generator, float]:
    """What else a pair is drawn with, and the lag of its make."""
    rng = np.random.default_rng([8000 + number, 2])
    return rng, rng.uniform(0.05, 0.12)


def machines(number: int) -> tuple[MachineCase, MachineCase]:
    """Lay out a pair: the lively machine and the gentle one."""
    rng, lag_s = _drawn(number)
    both = []
    for which in range(2):
        own_s = float(lag_s * np.exp(_LAG_AMONG_MACHINES * rng.standard_normal()))
        both.append(
            MachineCase(
                f"pair-{number}-{('lively', 'gentle')[which]}",
                ((_LAG, own_s),),
                (),
                8000 + 2 * number + which,
                (RotorLag,),
                "makki2024",
                100,
                bool(which),
                CONTROLLERS[int(rng.integers(3))],
                DisturbanceModel(STRENGTHS_Nm[int(rng.integers(3))], MEMORIES_s[int(rng.integers(3))]),
                8000 + number,
            )
        )
    return both[0], both[1]


def as_drawn(number: int) -> Rig:
    """The make of a pair as it was drawn: its numbers, and as tolerances twice the spread of its machines."""
    make, lag_s = machines(number)[0].make_rig(), _drawn(number)[1]
    numbers = dict(make.numbers)
    for name, std in _NORMAL.items():
        value = make[name].value
        numbers[name] = replace(make[name], tolerance=2.0 * _AMONG_MACHINES * std * value)
    (name,) = catalogue()[_LAG].size
    lag = effect_numbers(
        catalogue()[_LAG], {name: lag_s}, {name: 2.0 * _LAG_AMONG_MACHINES * lag_s}, "as it was drawn"
    )
    return Rig("drawn", "the make as it was drawn", numbers, {_LAG: lag}, "multibody")


def compared(number: int) -> dict[str, Any]:
    """Measure a pair.

    Returns
    -------
    dict
        For each flight held out, ``lively`` and ``gentle``, and each prior, ``by_file``, ``by_make`` and
        ``as_drawn``: the ``log_likelihood`` of the flight, its own constants and weather estimated; rms
        errors over 2 s by axis (``deg``) and over all axes in standard deviations of the quantisation
        (``normalised``). Of each of the ``numbers``: truth, mean and standard deviation of the make's prior.
    """
    nominal = load_rig("makki2024")
    lively, gentle = machines(number)
    record = _record(lively, 0, LIVELY_s, nominal)
    model = MultibodyModel(parse_effects([f"{_LAG}=0.06"]))
    found = ModelComparison(model, nominal, [record], []).refit([])
    machine = _machine("lively", found)
    prior = pool([machine]).prior(nominal, "make")
    drawn = as_drawn(number)
    train = _record(gentle, 0, GENTLE_s, nominal)
    others = {
        "lively": _record(replace(gentle, gentle=False), 1, OTHER_s, nominal),
        "gentle": _record(gentle, 1, OTHER_s, nominal),
    }
    # Along the same courses, whatever the prior.
    judges = {name: ModelComparison(model, nominal, [train], [other]) for name, other in others.items()}
    answer: dict[str, Any] = {name: {} for name in others}
    for what, rig, own in (
        ("by_file", nominal, model),
        ("by_make", prior, MultibodyModel(effects_of(prior))),
        ("as_drawn", drawn, MultibodyModel(effects_of(drawn))),
    ):
        hypothesis = ModelComparison(own, rig, [train], []).refit([])
        fit = predict(hypothesis.estimate, [train], ()).fit
        for name, other in others.items():
            (run,) = free_runs(fit, [other])
            held_out = judges[name].held_out_estimate(hypothesis)
            answer[name][what] = _errors(run, other) | {"log_likelihood": held_out.log_likelihood}
    answer["numbers"] = {
        name: [one.value, prior[name].value, 0.5 * prior[name].tolerance]
        for name, one in gentle.rig().items()
    }
    return answer


def _record(case: DisturbedCase, flight: int, seconds: float, nominal: Rig) -> Record:
    return prepare(case.flown(flight, seconds)[0], nominal, f"{case.name} {flight}")


def _machine(label: str, found: Hypothesis) -> Machine:
    """The machine as a diagnosis that named the lag has it."""
    estimate = found.estimate
    std = np.sqrt(np.diag(estimate.covariance))
    priors, numbers = {}, {}
    for i, one in enumerate(estimate.parameter_vector.free):
        if one.record is None:
            priors[one.name] = Estimate(one.prior.mean, one.prior.std, one.unit)
            alone = by_flights_alone(float(estimate.theta[i]), float(std[i]), priors[one.name])
            if alone is not None:
                numbers[one.name] = alone
    return Machine(label, "makki2024", "multibody", numbers, priors, {_LAG: 1.0}, ())


def _errors(run: FreeRun, record: Record) -> dict[str, Any]:
    rms_deg = run.errors["2"].rms_deg
    return {
        "deg": rms_deg.tolist(),
        "normalised": float(np.sqrt(np.mean((np.deg2rad(rms_deg) / record.sigma_rad) ** 2))),
    }


def summary(rows: Sequence[dict[str, Any]]) -> str:
    """Count pairs in which the make's prior predicts the gentle machine better."""
    lines = []
    for name in ("lively", "gentle"):
        for prior, said in (("by_make", "the make's prior"), ("as_drawn", "the make as it was drawn")):
            ratios = [row[name][prior]["normalised"] / row[name]["by_file"]["normalised"] for row in rows]
            nats = [
                row[name][prior]["log_likelihood"] - row[name]["by_file"]["log_likelihood"] for row in rows
            ]
            lines.append(
                f"{said}, another {name} flight of the gentle machine: likelier in "
                f"{sum(n > 0.0 for n in nats)} of {len(nats)}, by {np.median(nats):.1f} nats "
                f"({min(nats):.1f} to {max(nats):.1f}); free runs better in {sum(r < 1.0 for r in ratios)}, "
                f"ratio {np.median(ratios):.3f} ({min(ratios):.3f} to {max(ratios):.3f})"
            )
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the pairs that the JSON file does not have, and count; 0 when all ran."""
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
        rows[str(number)] = compared(number)
        given.json.write_text(json.dumps(rows, indent=1) + "\n")
        print(
            f"pair {number}: {time.process_time() - started_s:.0f} s; {_said(rows[str(number)])}", flush=True
        )
    print(summary(list(rows.values())))
    return 0


def _said(row: dict[str, Any]) -> str:
    return "; ".join(
        f"{name} {row[name]['by_file']['normalised']:.3g} by the file, "
        f"{row[name]['by_make']['normalised']:.3g} by the make, "
        f"{row[name]['by_make']['log_likelihood'] - row[name]['by_file']['log_likelihood']:.1f} nats"
        for name in ("lively", "gentle")
    )


if __name__ == "__main__":
    sys.exit(main())
