"""Healthy rigs under disturbances give no more alarms than stated, and changes get their right names."""

from __future__ import annotations

import math

import numpy as np
import pytest
from heli_lab.estimation import DisturbanceModel
from heli_lab.twin.calibration import Calibration
from heli_lab.twin.files import DEFAULT_CALIBRATION, TwinRig
from heli_lab.twin.healthy_flights import with_process_noise
from scipy.special import bdtrc

from tests.running.long import LONG, samples
from tests.twin.__main__ import HOURS, of_changed, of_healthy
from tests.twin.rigs import Known, known, true_rig

pytestmark = pytest.mark.slow
SEEDS = samples(20, 1)
HEALTHY = samples(10, 1)
CASES = [("thrust_step.back", 0.1), ("zero_offset.elevation", 0.02), ("coulomb_friction.pitch", 0.02)]


def of(seed: int) -> Known:
    """A rig with what a user finds out, or in the short share with what is true."""
    if LONG:
        return known(seed, 12)
    rig, model, disturbances = true_rig(seed)
    # An angle's quantisation error repeats itself, which the filter takes for a larger one.
    felt = DisturbanceModel(
        disturbances.fast_std,
        disturbances.correlation_time_s,
        disturbances.slow_std,
        np.array([1.8, 1.4, 1.1]),
    )
    twin = TwinRig(rig, model, Calibration(felt, DEFAULT_CALIBRATION.tail), f"rig {seed}")
    return Known(seed, rig, with_process_noise(model, disturbances), twin)


def test_alarms_are_as_seldom_as_stated_and_changes_have_their_names() -> None:
    alarms, chance, changes = 0, [], []
    for seed in range(1, SEEDS + 1):
        rig = of(seed)
        healthy = of_healthy(rig, HEALTHY)["healthy"]
        alarms += sum(flight["alarms"] > 0 for flight in healthy)
        chance += [1.0 - math.exp(-flight["free_s"] / 3600.0 / HOURS) for flight in healthy]
        cases = enumerate(CASES[: samples(3, 1)])
        changes += [of_changed(rig, name, size, 2_000 + 20 * number) for number, (name, size) in cases]
    assert bdtrc(alarms - 1, len(chance), float(np.mean(chance))) > 0.01
    named = [flight for flight in changes if flight.get("name") == flight["change"]]
    assert len(named) >= 0.9 * len(changes)
