"""Plans of proposed experiments."""

from functools import cache
from typing import Any

import pytest
from heli_host.data.flight import Flight
from heli_host.fly.plan import Plan
from heli_lab.diagnose import Diagnosis, diagnose, to_json
from heli_lab.explain.experiment_design import compose_experiment, segment_for
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import catalogue, parse_effects
from heli_sim.rig import load_rig

from tests.identify.made import flown_by_plan, thinned
from tests.running.long import LONG, samples

pytestmark = pytest.mark.diagnosis


@pytest.mark.parametrize("parts", [(), ("motors",), ("fast",), ("travel", "time"), ("elevation",)])
def test_next_flight_is_a_plan_that_can_be_flown(parts: tuple[str, ...]) -> None:
    flight = compose_experiment("Why.", parts)
    plan = Plan.parse(flight.plan, "next flight")
    plan.check()
    assert plan.duration_s > 20.0


def test_every_effect_has_a_part_that_shows_it() -> None:
    assert {segment_for(kind) for kind in catalogue().values()} == {"motors", "travel", "elevation", "time"}


LAG_s = 0.006
WEAKLY_EXCITED = """title = "Gentle"

[start]
elevation_deg = 0
rate_deg_s = 8
settle_s = 2

[[segment]]
kind = "sine"
travel_amplitude_deg = 8
travel_period_s = {period_s}
elevation_amplitude_deg = 4
elevation_period_s = 9
duration_s = {duration_s}
excite = {{ signal = "multisine", front_V = 0.1, back_V = 0.1, start_Hz = 0.1, stop_Hz = 1 }}
"""


def flown_with_lag(plan: str, seed: int) -> Flight:
    """Fly a plan on a rig whose rotors lag by `LAG_s`."""
    model = MultibodyModel(parse_effects([f"rotor_lag={LAG_s}"]))
    return thinned(flown_by_plan(load_rig("makki2024"), seed, Plan.parse(plan, "plan"), model), 2)


@cache
def weakly_excited(duration_s: int) -> tuple[Flight, Flight]:
    """Return two flights with hardly any excitation of the motors."""
    first, second = (WEAKLY_EXCITED.format(period_s=period_s, duration_s=duration_s) for period_s in (14, 11))
    return flown_with_lag(first, 1), flown_with_lag(second, 2)


@cache
def ambiguous_diagnosis() -> dict[str, Any]:
    """Return the JSON of a diagnosis of two weakly excited flights, which are longer in `make long`."""
    fit, held_out = weakly_excited(samples(30, 18))
    return to_json(diagnosed_with_two_effects([fit], [held_out]))


def diagnosed_with_two_effects(flights: list[Flight], validation: list[Flight]) -> Diagnosis:
    """Diagnose flights with a catalogue that has a lag and a delay only."""
    kinds = {id_: kind for id_, kind in catalogue().items() if id_ in ("rotor_lag", "input_delay")}
    return diagnose(MultibodyModel(), load_rig("makki2024"), flights, validation, kinds=kinds)


def test_weak_excitation_is_ambiguous_and_proposes_a_flight() -> None:
    assert ambiguous_diagnosis()["verdict"] == "ambiguous"
    (cause,) = ambiguous_diagnosis()["causes"]
    assert {cause["effect"], *cause["ambiguous_with"]} == {"rotor_lag", "input_delay"}
    next_flight = ambiguous_diagnosis()["next_flight"]
    assert "their log-likelihoods differ by" in next_flight["why"]
    assert "this plan alone gives a log-likelihood ratio of" in next_flight["why"]
    assert Plan.parse(next_flight["plan"], "next flight").segments


@pytest.mark.skipif(not LONG, reason="skipped: 40 s of CPU, in make long")
def test_proposed_flight_distinguishes_the_hypotheses() -> None:
    _, held_out = weakly_excited(30)
    clear = to_json(
        diagnosed_with_two_effects(
            [flown_with_lag(ambiguous_diagnosis()["next_flight"]["plan"], 3)], [held_out]
        )
    )
    assert clear["verdict"] == "cause_found"
    (cause,) = clear["causes"]
    assert cause["effect"] == "rotor_lag"
    assert cause["ambiguous_with"] == []
    lag = cause["parameters"]["rotor_lag_s"]
    assert abs(lag["value"] - LAG_s) < 3.0 * lag["std"]
