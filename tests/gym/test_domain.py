"""Episodes draw from the rig files and the given ranges."""

from __future__ import annotations

import numpy as np
import pytest
from heli_sim.errors import EffectError, RigError
from heli_sim.rig import load_rig, rig_names

pytest.importorskip("gymnasium", reason="skipped: no gymnasium")

from heli_lab.apps.gym import Domain


@pytest.mark.medium
def test_numbers_spread_by_the_tolerances_of_the_file() -> None:
    rig, random = load_rig("makki2024"), np.random.default_rng(1)
    drawn = [Domain(tolerances=1.0).draw(random).rig for _ in range(200)]
    for name, number in rig.items():
        values = np.array([rig_[name].value for rig_ in drawn])
        assert np.abs(values - number.value).max() <= number.tolerance * (1.0 + 1e-12)
        # Half widths are of 95 %: two standard deviations, less what the cut takes (12 %).
        if number.tolerance and 0.0 < number.tolerance < 0.9 * number.value:
            assert 0.36 < np.std(values) / number.tolerance < 0.52


@pytest.mark.medium
@pytest.mark.parametrize("name", rig_names())
def test_every_shipped_rig_can_be_drawn(name: str) -> None:
    random = np.random.default_rng(2)
    for _ in range(20):
        Domain(rigs=(name,), tolerances=1.0).draw(random)


def test_effects_come_with_their_chance_and_within_their_range() -> None:
    domain, random = Domain(effects={"rotor_lag": (0.05, 0.15)}, chance=0.25), np.random.default_rng(3)
    effects = [effect for _ in range(400) for effect in domain.draw(random).effects]
    values = np.array([next(iter(effect.values.values())) for effect in effects])
    assert 70 < len(values) < 130
    assert values.min() >= 0.05 and values.max() <= 0.15 and np.std(values) > 0.02


def test_what_a_domain_cannot_draw_is_refused_at_once() -> None:
    with pytest.raises(RigError):
        Domain(rigs=("no such rig",))
    with pytest.raises(EffectError):
        Domain(effects={"no_such_effect": (0.0, 1.0)})
