"""A fit finds the numbers of the rig that flew, and explains a flight it never saw down to the encoder."""

from __future__ import annotations

from pathlib import Path

import pytest
from heli_host.flight import Flight
from heli_sim.identify.run import identify
from heli_sim.model import MultibodyModel
from heli_sim.rig import load_rig

from tests.identify.made import flown, thinned

PRACTICE = Path(__file__).resolve().parents[3] / "shared" / "data" / "practice" / "none"


def test_the_numbers_of_a_simulated_rig_are_found_from_its_flights() -> None:
    rig = load_rig("makki2024").replace(thrust_gain=0.63, friction_travel=0.055, friction_pitch=0.02)
    flights = [thinned(flown(rig, seed, 30.0), 2) for seed in (3, 4)]
    found = identify(MultibodyModel(), load_rig("makki2024"), flights[:1], validation=flights[1:])
    told = found.json()
    for name in ("thrust_gain", "friction_travel", "friction_pitch"):
        key = next(k for k in told["parameters"] if k.startswith(name))
        value, std = told["parameters"][key]["value"], told["parameters"][key]["std"]
        assert value == pytest.approx(rig[name].value, abs=4 * std), name
    assert told["normalised_residual"]["validation"] <= 1.05


@pytest.mark.skipif(not PRACTICE.exists(), reason="skipped: no shared data")
def test_a_practice_flight_with_nothing_hidden_is_explained_down_to_the_encoder() -> None:
    train, held_out = (Flight.read(PRACTICE / name) for name in ("a.csv.gz", "b.csv.gz"))
    found = identify(MultibodyModel(), load_rig("makki2024"), [train], validation=[held_out])
    residual = found.json()["normalised_residual"]
    assert residual["train"] <= 1.02
    assert residual["validation"] <= 1.02
