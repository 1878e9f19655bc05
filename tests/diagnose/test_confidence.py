"""A cause that is not confirmed has a limited confidence, from seeds that do not judge it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from heli_lab.explain.verdict import unconfirmed_confidence

from tests.diagnose.confidence import DEVELOPMENT, JUDGING, KINDS, case, is_right, main

LEVELS = np.linspace(0.01, 0.99, 99)


def test_confidence_without_confirmation_is_lower_and_grows_with_evidence() -> None:
    lowered = np.array([unconfirmed_confidence(level) for level in LEVELS])
    assert np.all(np.diff(lowered) >= 0.0)
    assert np.all(lowered <= LEVELS)
    assert 0.8 < lowered[-1] < 0.9
    assert lowered[0] > 0.0


def test_kinds_of_cases_alternate_and_an_event_has_a_moment_in_flight() -> None:
    drawn_cases = [case(seed) for seed in JUDGING]
    assert {drawn.kind for drawn in drawn_cases} == set(KINDS)
    for drawn in drawn_cases:
        assert bool(drawn.removed) == ("lacking" in drawn.kind)
        assert drawn.removed in ("", *drawn.hidden)
        for values in drawn.hidden.values():
            assert all(8.0 <= value <= 12.0 for name, value in values.items() if name.endswith("_at_s"))


def test_no_seed_of_the_calibration_judges_it() -> None:
    assert not {*DEVELOPMENT} & {*JUDGING}


def test_only_a_hidden_effect_or_one_of_two_is_right() -> None:
    drawn = next(drawn for drawn in map(case, JUDGING) if drawn.kind == "one")
    (hidden,) = drawn.hidden
    assert is_right(drawn, hidden, ())
    assert is_right(drawn, "flywheel", (hidden,))
    assert not is_right(drawn, "flywheel", ())
    assert not is_right(drawn, "flywheel", (hidden, "axis_tilt"))


@pytest.mark.medium
def test_measurement_continues_from_its_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cause = {"effect": "flywheel", "ambiguous_with": [], "verdict": "cause_found", "confirmed": False}
    cause |= {"why_not": "it happened in one flight only", "if_confirmed": 0.9, "confidence": 0.6}
    path = tmp_path / "rows.jsonl"
    path.write_text(json.dumps([9305, {"forward": [cause]}]) + "\n")
    assert main(["9305", "-o", str(path)]) == 0
    assert "0.50 to 0.70: mean 0.60, 0 of 1 right" in capsys.readouterr().out
