"""The noise cases: five kinds of disturbances, with nothing, one or two causes hidden."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from heli_benchmark.cases.noise import NOISE_KINDS, noise_case
from heli_benchmark.effects.noise import NOISE
from heli_benchmark.engine.plant import Moment
from heli_benchmark.runs.noise import NoiseCounts
from heli_host.data.arrays import Floats


def test_twenty_seeds_give_each_kind_twice_alone_and_with_one_and_two_causes() -> None:
    for first in (8000, 8100):
        cases = [noise_case(seed) for seed in range(first, first + 20)]
        counts = Counter((case.kind, len(case.effects)) for case in cases)
        assert counts == {
            (kind, causes): 2 if causes == 0 else 1 for kind in NOISE_KINDS for causes in range(3)
        }
    assert noise_case(8003) == noise_case(8003)


def _moment(flight_s: float, thrust_N: float = 2.0) -> Moment:
    return Moment(flight_s, flight_s, np.full(2, 5.0), np.full(2, thrust_N), np.zeros(3), np.zeros(3))


def _torques_Nm(kind: str, thrust_N: float = 2.0) -> Floats:
    """Torques about the three axes every 10 ms."""
    hidden = NOISE[kind](np.random.default_rng(5))
    rows = []
    for flight_s in np.arange(0.0, 100.0, 0.01):
        at = _moment(float(flight_s), thrust_N)
        for effect in hidden:
            effect.torque(at)
        rows.append(at.torque_Nm)
    return np.array(rows)


@pytest.mark.medium
def test_bursts_and_kicks_are_rarer_and_larger_than_gusts() -> None:
    def kurtosis(values: Floats) -> float:
        return float(np.mean(values**4) / np.mean(values**2) ** 2)

    steady, bursts, kicks = (_torques_Nm(kind)[:, 1] for kind in ("thrust", "bursts", "kicks"))
    assert kurtosis(steady) < 4.0 < min(kurtosis(bursts), kurtosis(kicks))
    assert np.allclose(_torques_Nm("thrust", 4.0), 2.0 * _torques_Nm("thrust", 2.0))


def test_a_supply_that_wanders_changes_both_voltages_alike() -> None:
    hidden = NOISE["supply"](np.random.default_rng(5))
    shares = []
    for flight_s in np.arange(0.0, 100.0, 0.5):
        at = _moment(float(flight_s))
        for effect in hidden:
            effect.volts(at)
        assert at.volts_V[0] == at.volts_V[1]
        shares.append(at.volts_V[0] / 5.0 - 1.0)
    assert 0.01 < np.std(shares) < 0.06


def test_counts_are_of_explained_flights_named_causes_and_false_names() -> None:
    nothing, one_cause = noise_case(8000), noise_case(8010)
    counts = NoiseCounts()
    counts.add(nothing, {"verdict": "explained", "causes": []}, 4.0)
    counts.add(nothing, {"verdict": "unexplained", "causes": []}, 4.0)
    hidden = one_cause.effects[0][0]
    counts.add(
        one_cause, {"verdict": "cause_found", "causes": [{"effect": hidden}, {"effect": "other"}]}, 10.0
    )
    assert str(counts) == (
        "explained 1 of 2, causes named 1 of 1, false names 1, all named but unexplained 1 of 3, 6.0 s"
    )
