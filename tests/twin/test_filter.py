"""Innovations are white where nothing changed, and sensitivities are what changes do to them."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from heli_host.flight import Flight
from heli_lab.estimation import DisturbanceModel
from heli_lab.twin import twin as twin_module
from heli_lab.twin.calibration import Calibration
from heli_lab.twin.draws import evidence
from heli_lab.twin.flights import count_rad_of, samples_of
from heli_lab.twin.healthy_flights import fly_simulated, random_plan, with_process_noise
from heli_lab.twin.kalman_filter import KalmanFilter
from heli_lab.twin.likelihood_ratio import ONSETS
from heli_lab.twin.parameter_uncertainty import EXACT, SUPPLY_STD
from heli_lab.twin.tail import Tail
from heli_lab.twin.twin import Twin
from heli_lab.twin.twin_model import TwinModel
from heli_sim.model import MultibodyModel
from heli_sim.model.linear import trim
from heli_sim.rig import Rig, load_rig

NO_ALARM = Tail(np.inf, 0.0, 0.0, 1)
DISTURBANCES = DisturbanceModel(
    np.array([0.01, 0.003, 0.006]), np.full(3, 0.5), np.array([1e-3, 5e-4, 5e-4]), np.array([1.6, 1.4, 1.1])
)


@cache
def healthy() -> tuple[Rig, Flight]:
    rig = load_rig("makki2024")
    return rig, fly_simulated(
        with_process_noise(MultibodyModel(), DISTURBANCES), rig, random_plan(4, 46.0), 4
    )


def innovations(monkeypatch: pytest.MonkeyPatch, twin: Twin, flight: Flight) -> np.ndarray:
    found = []
    update = KalmanFilter.update

    def kept(self: KalmanFilter, *arguments: object) -> object:
        result = update(self, *arguments)  # type: ignore[arg-type]
        found.append(result.value.copy())
        return result

    monkeypatch.setattr(KalmanFilter, "update", kept)
    twin.update(samples_of(flight)[0])
    return np.array(found)


@pytest.mark.slow
def test_innovations_are_white_and_of_unit_variance(monkeypatch: pytest.MonkeyPatch) -> None:
    rig, flight = healthy()
    twin = Twin(
        TwinModel(MultibodyModel(), rig), Calibration(DISTURBANCES, NO_ALARM), count_rad_of(flight, rig), 1e-3
    )
    seen = innovations(monkeypatch, twin, flight)
    assert len(seen) > 900
    # The filter assumes too large errors for angles at rest: a variance below one is safe, above it alarms
    # are false.
    assert np.all((seen.std(axis=0) > 0.6) & (seen.std(axis=0) < 1.15))
    lag = (seen[1:] * seen[:-1]).mean(axis=0) / (seen**2).mean(axis=0)
    assert np.all(np.abs(lag) < 0.15)


@pytest.mark.slow
def test_sensitivities_are_what_a_change_does_to_the_innovations(monkeypatch: pytest.MonkeyPatch) -> None:
    """The oracle is the filter itself on a rig whose number is otherwise from the beginning."""
    rig, flight = healthy()
    share = 1e-3
    values = {}
    for sign in (-1.0, 1.0):
        moved = rig.replace(L_b=rig["L_b"].value + sign * share)
        model = TwinModel(MultibodyModel(), moved)
        twin = Twin(model, Calibration(DISTURBANCES, NO_ALARM), count_rad_of(flight, rig), 1e-3)
        values[sign] = innovations(monkeypatch, twin, flight)
        monkeypatch.undo()
    numeric = -(values[1.0] - values[-1.0]) / (2 * share)
    kept: list[np.ndarray] = []
    monkeypatch.setattr(twin_module, "FILTER_SETTLING_s", np.inf)
    update = KalmanFilter.update

    def told(self: KalmanFilter, *arguments: object) -> object:
        # A single onset, before the filter began.
        result = update(self, *arguments)  # type: ignore[arg-type]
        place = next(i for i, c in enumerate(columns) if c == "counterweight_shift_m")
        kept.append(result.sensitivity[:, place, 0].copy())
        return result

    model = TwinModel(MultibodyModel(), rig)
    columns = [entry for change in model.changes for entry in change.numbers]
    twin = Twin(model, Calibration(DISTURBANCES, NO_ALARM), count_rad_of(flight, rig), 1e-3)
    monkeypatch.setattr(KalmanFilter, "update", told)
    monkeypatch.setattr(
        "heli_lab.twin.likelihood_ratio.LikelihoodRatio.ages", lambda self, block: np.ones((len(columns), 42))
    )
    twin.update(samples_of(flight)[0])
    linear = np.array(kept)
    scale = np.abs(numeric).max()
    assert scale > 10.0
    assert np.sqrt(((linear - numeric) ** 2).mean()) < 0.05 * scale


@pytest.mark.medium
def test_no_variance_turns_negative_however_large_the_disturbances_are() -> None:
    """Rounding made one negative in a filter that subtracts from its covariance; its power was not a
    number.
    """
    rig = load_rig("makki2024")
    model = TwinModel(MultibodyModel(), rig)
    hover = trim(MultibodyModel(), rig)
    vast = DisturbanceModel(np.full(3, 1e7), np.full(3, 5.0), np.full(3, 1e-3), np.full(3, 0.02))
    kalman = KalmanFilter(model, vast, np.full(3, 1e-9), 0.01, 4, hover.state.copy())
    amount, onset_rad = np.ones((model.weights.shape[1], ONSETS)), np.zeros((len(model.scales), ONSETS))
    for _ in range(20):
        for _ in range(4):
            kalman.predict(0.0, hover.volts_V)
        kalman.update(0.0, hover.state[:3], 1, hover.volts_V, amount, onset_rad)
        assert np.all(np.diagonal(kalman.covariance) > 0.0)


@pytest.mark.slow
def test_another_supply_than_the_rig_s_is_estimated_and_no_change() -> None:
    """Differences between days are states of the filter, estimated from their prior and the first
    seconds."""
    rig, flight = healthy()
    weak = replace(flight, front_V=flight.front_V / 0.96, back_V=flight.back_V / 0.96)
    most = {}
    for uncertainty in (EXACT, replace(EXACT, supply_std=SUPPLY_STD)):
        twin = TwinModel(MultibodyModel(), rig, uncertainty)
        history = evidence(twin, DISTURBANCES, weak).history
        most[uncertainty.supply_std] = max(nats for _, nats in history if np.isfinite(nats))
    assert most[SUPPLY_STD] < 10.0 < most[0.0]
