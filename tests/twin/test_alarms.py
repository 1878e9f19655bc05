"""Unchanged rigs under disturbances raise no more false alarms than stated, and changes get their names."""

from __future__ import annotations

import math

import numpy as np
import pytest
from heli_lab.fit.grey_box import DisturbanceModel
from heli_lab.watch.calibration import DEFAULT_CALIBRATION, Calibration, TwinRig
from scipy.special import bdtrc

from tests.running.long import LONG, samples
from tests.twin.__main__ import FALSE_ALARM_INTERVAL_h, fly_changed, fly_healthy
from tests.twin.rigs import RigWithTwin, rig_with_twin, true_rig

pytestmark = pytest.mark.slow
RIGS = samples(20, 1)
HEALTHY_FLIGHTS = samples(10, 1)
CHANGES = [("thrust_step.back", 0.1), ("zero_offset.elevation", 0.02), ("coulomb_friction.pitch", 0.02)]


def rig_for_test(seed: int) -> RigWithTwin:
    """Return a rig with a trained twin; in the short tests, the twin has the true parameters instead."""
    if LONG:
        return rig_with_twin(seed, drawn_minutes=12)
    drawn = true_rig(seed)
    # An angle's rounding error repeats itself, so that the filter needs a larger variance.
    disturbances = DisturbanceModel(
        drawn.disturbances.fast_std,
        drawn.disturbances.correlation_time_s,
        drawn.disturbances.slow_std,
        quantisation=np.array([1.8, 1.4, 1.1]),
    )
    calibration = Calibration(disturbances, DEFAULT_CALIBRATION.tail)
    twin = TwinRig(drawn.rig, drawn.model, calibration, f"rig {seed}")
    return RigWithTwin(seed, drawn.rig, drawn.disturbed_model, twin)


def test_false_alarms_are_as_rare_as_stated_and_changes_get_their_names() -> None:
    false_alarms, chances, changed = 0, [], []
    for seed in range(1, RIGS + 1):
        rig = rig_for_test(seed)
        healthy = fly_healthy(rig, HEALTHY_FLIGHTS)["healthy"]
        false_alarms += sum(flight["alarms"] > 0 for flight in healthy)
        chances += [1.0 - math.exp(-flight["free_s"] / 3600.0 / FALSE_ALARM_INTERVAL_h) for flight in healthy]
        for number, (name, size) in enumerate(CHANGES[: samples(3, 1)]):
            changed.append(fly_changed(rig, name, size, flight_seed=2_000 + 20 * number))
    probability_of_as_many = bdtrc(false_alarms - 1, len(chances), float(np.mean(chances)))
    assert probability_of_as_many > 0.01
    named = [flight for flight in changed if flight.get("name") == flight["change"]]
    assert len(named) >= 0.9 * len(changed)
