"""The command that measures the effect of a threshold changes it, and only in a process of its own."""

from __future__ import annotations

import pytest

from tests.diagnose.sensitivity import CASES, in_a_process, judged, main, scaled


@pytest.mark.parametrize(
    ("value", "factor", "expected"),
    [
        (3, 0.5, 1),
        (1, 0.5, 1),
        (3, 2.0, 6),
        (0.8, 2.0, 1.0),
        (6.0, 2.0, 12.0),
        ((0.2, 5.0), 2.0, (0.1, 10.0)),
    ],
)
def test_a_constant_is_halved_or_doubled_as_its_type_allows(
    value: object, factor: float, expected: object
) -> None:
    assert scaled(value, factor) == expected


@pytest.mark.diagnosis
def test_a_shortlist_of_one_effect_changes_the_answer_on_a_small_lag() -> None:
    from heli_lab.explain import thresholds

    answer = in_a_process({"SHORTLIST": 0.5}, ["small lag"])
    assert answer["small lag"] != ["ambiguous", "rotor_lag"]
    assert answer["small lag"][0] != "failed"
    assert thresholds.SHORTLIST == 3


def test_only_constants_of_judgement_are_accepted(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert "SHORTLIST" in dict(judged())
    assert "FALSE_DISCOVERY_RATE" not in dict(judged())
    with pytest.raises(SystemExit):
        main(["FALSE_DISCOVERY_RATE"])
    assert "FALSE_DISCOVERY_RATE" in capsys.readouterr().err
    assert "small lag" in CASES
