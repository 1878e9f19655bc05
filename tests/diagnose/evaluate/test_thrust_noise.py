"""A thrust that varies at random is a disturbance with a size, estimated only if torques do not suffice."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import casadi as ca
import pytest
from heli_host.data.flight import Flight
from heli_lab.explain.assessment import justified_thrust_noise
from heli_lab.explain.comparison import ModelComparison
from heli_lab.explain.residuals import gain_ratios
from heli_lab.explain.screening import Screening
from heli_lab.fit.records import prepare
from heli_lab.report.diagnosis.text import thrust_noise_in_words
from heli_sim.model import MultibodyModel
from heli_sim.model.effect import Effect, Operands, Stage
from heli_sim.model.effects import parse_effects
from heli_sim.rig import Quantity
from typing_extensions import override

from tests.estimation.made import RIG, TRUE_RIG, GUST_Nm, flight_with_disturbances
from tests.identify import made
from tests.identify.made import flown, thinned
from tests.running.kept import FLOWN, KEPT

pytestmark = pytest.mark.diagnosis
STD, CORRELATION_s = 0.03, 1.5


class _WanderingSupply(Effect):
    """The voltage of both motors varies by an Ornstein-Uhlenbeck process."""

    @override
    def voltage_V(self, at: Operands, volts_V: ca.SX) -> ca.SX:
        return volts_V * (1 + self.value(at, "now"))

    @override
    def state_rates(self, at: Operands) -> ca.SX:
        return -self.value(at, "now") / CORRELATION_s

    @override
    def diffusion(self, at: Operands, step_s: float, normal: ca.SX) -> ca.SX:
        return STD * ca.sqrt(1 - ca.exp(-2 * step_s / CORRELATION_s)) * normal


def _flown() -> Flight:
    """Fly a rig whose supply wanders, in weak gusts."""
    gusts = parse_effects([f"random_torque.{axis}={size / 3}" for axis, size in GUST_Nm.items()])
    state = (Quantity("wandering_now", "1", "relative change of the voltage"),)
    wander = _WanderingSupply("wandering", states=state, stage=Stage.TORQUE, noise_inputs=1)
    return thinned(flown(TRUE_RIG, 21, 34.0, MultibodyModel((*gusts, wander))), 2)


@cache
def wandering() -> ModelComparison:
    """A flight whose supply wanders, in weak gusts."""
    flight = KEPT("wandering supply", _flown, made_by=(Path(__file__), Path(made.__file__)), rooms=FLOWN)
    return ModelComparison(MultibodyModel(), RIG, [prepare(flight, RIG, "wandering")], [])


def _justified(comparison: ModelComparison, verdict: str, gain_nats: float = 20.0) -> ModelComparison | None:
    """Ask for the noise after a search without causes, whose innovations a predictor explains by a gain."""
    dependences = (SimpleNamespace(log_likelihood_gain=gain_nats),)
    residual: Any = SimpleNamespace(dependences=dependences)
    assessment: Any = SimpleNamespace(verdict=SimpleNamespace(label=verdict), residual_analysis=residual)
    search: Any = SimpleNamespace(baseline=comparison.filtering_baseline, final=comparison.filtering_baseline)
    return justified_thrust_noise(comparison, search, assessment)


def test_a_wandering_supply_is_estimated_with_its_size_and_time() -> None:
    noisy = _justified(wandering(), "unexplained")
    assert noisy is not None
    estimate = noisy.filtering_baseline.estimate
    supply, difference = estimate.disturbances.gains
    assert supply.std == pytest.approx(STD, rel=0.4)
    assert 0.4 * CORRELATION_s < supply.correlation_time_s < 2.5 * CORRELATION_s
    assert difference.std < 0.3 * STD
    assert gain_ratios(Screening(estimate))[0] > 100.0


def test_no_thrust_noise_without_need_or_evidence() -> None:
    assert _justified(wandering(), "explained") is None
    assert _justified(wandering(), "unexplained", gain_nats=1000.0) is None
    gusts_alone = ModelComparison(MultibodyModel(), RIG, [flight_with_disturbances()], [])
    assert _justified(gusts_alone, "unexplained") is None


def test_a_supply_that_varies_is_stated_in_words() -> None:
    noise = {
        "supply": {"std": 0.021, "correlation_time_s": 2.1, "log_likelihood_ratio": 80.0},
        "difference": {"std": 0.004, "correlation_time_s": 0.3, "log_likelihood_ratio": 1.0},
    }
    assert thrust_noise_in_words(noise) == ["the supply varies by 2 % with a correlation time of 2 s"]
