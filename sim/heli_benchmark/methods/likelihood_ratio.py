"""Generalised likelihood ratio with the filter of the twin: which change of the identified rig began when?"""

from __future__ import annotations

import math
from typing import Any, Final

from heli_lab.fit.identification import identify
from heli_lab.watch.calibration import Calibration, Tail
from heli_lab.watch.learn import learn_rig
from heli_lab.watch.likelihood_ratio import ChangeCandidate
from heli_lab.watch.steps import count_rad_of, samples_of
from heli_lab.watch.twin import Twin
from heli_lab.watch.twin_model import TwinModel
from heli_sim.model import MultibodyModel
from heli_sim.rig import Rig

from heli_benchmark.task import NOTHING, UNLISTED, BenchmarkCase, Estimate, answer_with

_ALARM_NATS: Final = 12.0
"""Evidence from which the twin raises an alarm: 6 nats are 400 times as likely, and a flight has hundreds of
onsets."""
_MIN_NATS: Final = 12.0
"""Evidence from which an alarm counts."""
_NO_CHANGE: Final = 0.6
"""Probability of nothing without an alarm: a cause that acts from the start is no change in flight."""


def diagnose(case: BenchmarkCase) -> dict[str, Any]:
    """Identify the rig from the training flights, and look for changes in all flights."""
    rig, best = identified_and_changed(case)
    parameters = {
        name: Estimate(rig[name].value, max(0.5 * rig[name].tolerance, 1e-9))
        for name in rig
        if rig[name].value != case.rig[name].value
    }
    if best is None or best.log_evidence < _MIN_NATS:
        return answer_with(case.causes, {NOTHING: _NO_CHANGE}, parameters)
    name = best.change.id if best.change.id in case.causes.listed else UNLISTED
    parameter = best.change.parameters[0]
    if parameter in case.causes.parameter_names and best.std > 0.0:
        parameters[parameter] = Estimate(best.size, best.std)
    # The probability rises slowly with the evidence, because a cause may also imitate another change.
    probability = 1.0 - math.exp(-0.1 * best.log_evidence)
    return answer_with(case.causes, {name: min(0.9, probability)}, parameters)


def identified_and_changed(case: BenchmarkCase) -> tuple[Rig, ChangeCandidate | None]:
    """Return the identified rig and the change with the highest evidence."""
    labels = [f"training {i}" for i in range(len(case.training))]
    rig = identify(MultibodyModel(), case.rig, case.training, labels=labels, threads=1).rig("identified")
    disturbances, uncertainty = learn_rig(MultibodyModel(), rig, case.training, labels)
    tail = Tail(_ALARM_NATS, per_hour=1e-9, scale_nats=1.0, excesses=1000)
    calibration = Calibration(disturbances, tail, uncertainty=uncertainty)
    best: ChangeCandidate | None = None
    for flight in (*case.training, *case.validation):
        samples, sample_s = samples_of(flight)
        twin = Twin(TwinModel(MultibodyModel(), rig), calibration, count_rad_of(flight, rig), sample_s)
        for event in [*twin.update(samples), *twin.finish()]:
            if event.kind == "diagnosed" and event.ranking:
                first = event.ranking[0]
                if best is None or first.log_evidence > best.log_evidence:
                    best = first
    return rig, best
