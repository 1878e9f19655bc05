"""Cases without disturbances: small effects count as reported if they are named or too small to matter."""

from __future__ import annotations

from heli_benchmark.cases.calm import CALM_EFFECTS, calm_case
from heli_benchmark.runs.calm import false_names, unreported


def test_seeds_go_through_all_effects_and_some_rates() -> None:
    cases = [calm_case(seed) for seed in range(7000, 7030)]
    assert {case.effects for case in cases} == set(CALM_EFFECTS)
    assert {case.rate_Hz for case in cases} == {100, 250, 500}
    assert len({case.name for case in cases}) == len(cases)
    assert not any(any(case.disturbances.gusts_Nm) for case in cases)


def test_effect_is_reported_if_named_or_too_small_and_other_names_are_false() -> None:
    delay_and_sag = calm_case(7003)
    result = {
        "causes": [{"effect": "input_delay"}, {"effect": "thrust_fade"}],
        "too_small": [{"effect": "supply_fade"}],
    }
    assert false_names(delay_and_sag, result) == ["thrust_fade"]
    assert unreported(delay_and_sag, result) == ["supply_sag"]
    result["too_small"].append({"effect": "supply_sag"})
    assert unreported(delay_and_sag, result) == []
