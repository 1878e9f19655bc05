"""A confidence is a frequency: bins and their binomial bounds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from heli_benchmark.scoring.goals import goals
from heli_benchmark.scoring.judge import Row
from heli_benchmark.scoring.reliability import BINS, draw, holds, reliability

from tests.running.pixels import coloured_share

TEMPLATE = Row("c", "one", 1, ("rotor_lag",), {"rotor_lag": 50.0}, "cause_found", (), (), (), {}, {}, 1.0)


def cases_of_confidence(sure: float, right: int, wrong: int) -> list[Row]:
    """So many causes of one confidence, each in a case of its own."""
    return [
        replace(TEMPLATE, named=(name,), confidence=(sure,), alternatives=((),))
        for name in ["rotor_lag"] * right + ["axis_tilt"] * wrong
    ]


def test_there_are_five_bins_and_each_cause_is_in_one() -> None:
    rows = [row for sure in (0.0, 0.5, 0.7, 0.85, 0.95, 1.0) for row in cases_of_confidence(sure, 1, 0)]
    curve = reliability(rows)
    assert len(curve) == len(BINS) - 1 == 5
    assert [bin_["causes"] for bin_ in curve] == [1, 1, 1, 1, 2]


def test_wrong_names_count_wherever_they_are_given() -> None:
    off = replace(cases_of_confidence(0.97, 0, 1)[0], kind="off_list", hidden=("off-draught",))
    nothing = replace(off, kind="nothing", hidden=())
    (curve,) = [
        bin_ for bin_ in reliability([off, nothing, *cases_of_confidence(0.99, 1, 0)]) if bin_["causes"]
    ]
    assert (curve["causes"], curve["right"]) == (3, 1)


@pytest.mark.parametrize(("right", "within"), [(20, True), (19, True), (15, True), (14, False)])
def test_a_bin_that_boasts_lies_outside_its_bounds(right: int, within: bool) -> None:
    # 20 causes of 0.9: a binomial distribution gives 14 or fewer in 1 of 88 runs, 15 or fewer in 1 of 23.
    (curve,) = [bin_ for bin_ in reliability(cases_of_confidence(0.9, right, 20 - right)) if bin_["causes"]]
    assert holds(curve) is within


def test_a_bin_that_is_too_timid_lies_outside_too() -> None:
    rows = cases_of_confidence(0.6, 20, 0)
    assert goals(rows)["confidence: bins within their binomial bounds"]["reached"] is False


def test_the_diagram_is_drawn(tmp_path: Path) -> None:
    draw(reliability(cases_of_confidence(0.9, 9, 1)), tmp_path / "r.png")
    assert coloured_share(tmp_path / "r.png") > 0.0
