"""Which effects one model may have: the declarations decide, for all pairs and triples of the catalogue."""

from __future__ import annotations

import itertools

import pytest
from heli_sim.errors import PlantError
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import catalogue

KINDS = catalogue()
EFFECTS = {id_: kind.make(kind.typical) for id_, kind in KINDS.items()}
FORBIDDEN = {
    frozenset(("input_delay", "rotor_lag_with_delay")),
    frozenset(("rotor_lag", "rotor_lag_with_delay")),
    frozenset(("rotor_lag", "rotor_speed_lag")),
    frozenset(("rotor_lag_with_delay", "rotor_speed_lag")),
}


def test_forbidden_pairs_of_effects_are_those_of_lags_and_delays() -> None:
    forbidden = set()
    for first, second in itertools.combinations(KINDS.values(), 2):
        assert first.compatible_with(second) == second.compatible_with(first)
        if not first.compatible_with(second):
            forbidden.add(frozenset((first.id, second.id)))
    assert forbidden == FORBIDDEN


@pytest.mark.medium
def test_every_allowed_pair_and_triple_of_effects_makes_a_model() -> None:
    made = 0
    for size in (2, 3):
        for ids in itertools.combinations(KINDS, size):
            pairs = itertools.combinations(ids, 2)
            if all(KINDS[first].compatible_with(KINDS[second]) for first, second in pairs):
                model = MultibodyModel(tuple(EFFECTS[id_] for id_ in ids))
                assert len(model.effects) == size
                made += 1
    assert made > 9000


def test_a_model_refuses_two_effects_that_delay_the_voltages() -> None:
    with pytest.raises(PlantError, match="both delay the voltages"):
        MultibodyModel((EFFECTS["input_delay"], EFFECTS["rotor_lag_with_delay"]))
