"""The blind cases hide what they say, all of the catalogue, in flights that can be flown."""

from __future__ import annotations

import numpy as np
import pytest
from heli_benchmark.cases.clean import TRAIN_S, VALIDATE_S, clean_cases
from heli_benchmark.cases.disturbed import disturbed_cases
from heli_benchmark.effects.listed import LISTED, MORE_LISTED, OTHER_FORMS, RandomTorque
from heli_benchmark.effects.measured import MEASURED_EFFECTS
from heli_benchmark.engine.plant import Moment, MujocoPlant
from heli_benchmark.reference.truth import hidden_in
from heli_benchmark.simulation.flight_code import plan
from heli_benchmark.task.combined_causes import PARTS
from heli_sim.model.effects import catalogue

from tests.model.effect_list import COMMON, MEASURED

NOT_HIDDEN = {
    "zero_offset.travel": "every place of travel is as good as any other",
    "elevation_drag_quadratic": "elevation turns too slowly for it to show under any disturbances",
    "removed.drag": "the multibody model has no such term",
    "removed.differential_travel": "the multibody model has no such term",
}


def test_every_effect_of_the_list_is_hidden_in_two_sizes_or_in_disturbances_or_gone() -> None:
    hidden = {*LISTED, *MORE_LISTED, *(effect for effect, _, _ in OTHER_FORMS.values())}
    assert hidden <= set(catalogue())
    removed = {id for id in catalogue() if id.startswith("removed.")}
    assert {*COMMON, *MEASURED, *removed} <= {*hidden, *MEASURED_EFFECTS, *PARTS, *NOT_HIDDEN}
    names = [name for case in clean_cases() for name, _ in case.effects]
    assert all(names.count(name) >= (1 if name.startswith("removed.") else 2) for name in hidden)
    in_disturbed = {name for case in disturbed_cases() for name, _ in case.effects}
    assert {*MEASURED_EFFECTS, *(part for parts in PARTS.values() for part in parts)} <= in_disturbed


def test_ten_rigs_and_more_have_nothing_hidden_and_differ() -> None:
    rigs = [case.rig() for case in clean_cases() if case.kind == "nothing"]
    assert len(rigs) >= 10
    gains = {rig["thrust_gain"].value for rig in rigs}
    assert len(gains) == len(rigs)
    assert max(gains) / min(gains) > 1.2


def test_cases_have_names_and_seeds_of_their_own() -> None:
    cases = clean_cases()
    assert len({case.name for case in cases}) == len({case.seed for case in cases}) == len(cases)


@pytest.mark.medium
def test_every_plan_can_be_flown() -> None:
    for case in clean_cases():
        for number, duration_s in enumerate((TRAIN_S, VALIDATE_S)):
            plan(case.name, duration_s, np.random.default_rng([case.seed, 4, number])).check({})


def test_the_catalogue_can_make_all_that_is_hidden() -> None:
    kinds = catalogue()
    for case in clean_cases():
        for effect in hidden_in(case, 0.6):
            made = kinds[effect.id].make(effect.start)
            assert {*effect.scalars, *(name for pair in effect.amplitudes for name in pair)} <= set(
                made.values
            )


def test_gusts_differ_between_flights_and_everything_else_is_the_same() -> None:
    case = next(case for case in clean_cases() if case.name == "random_torque.pitch-large")
    first, second = (case.hidden(number)[0] for number in (0, 1))
    assert isinstance(first, RandomTorque)
    assert first.truth == second.truth
    moments = [Moment(0.0, 0.0, np.zeros(2), np.zeros(2), np.zeros(3), np.zeros(3)) for _ in range(2)]
    for effect, at in zip((first, second), moments, strict=True):
        effect.torque(at)
    assert moments[0].torque_Nm[1] != moments[1].torque_Nm[1]


@pytest.mark.parametrize(
    "name", ["nothing-0", "off-slosh-large", "zero_offset.elevation-large", "removed.pendulum.pitch-gone"]
)
def test_the_rig_balances_as_its_masses_do(name: str) -> None:
    case = next(case for case in clean_cases() if case.name == name)
    rig = case.rig()
    plant = MujocoPlant(rig, case.hidden())
    v = {key: rig[key].value for key in ("M_f", "M_b", "M_w", "M_h", "M_l", "L_a", "L_b", "L_x", "g")}
    carried_kg = v["M_f"] + v["M_b"] + v["M_h"]
    lift_N = v["g"] * (carried_kg * v["L_a"] + v["M_l"] * v["L_x"] - v["M_w"] * v["L_b"]) / v["L_a"]
    assert plant.holding_torque_Nm()[0] == pytest.approx(lift_N * v["L_a"], abs=2e-6)
