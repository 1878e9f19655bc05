"""Log files of drawn loggers are imported right, or questioned or refused for the right reason."""

from pathlib import Path

import pytest
from heli_benchmark.zoo.draw import draw_case
from heli_benchmark.zoo.flights import FlightRecipe
from heli_benchmark.zoo.judge import SILENT, WRONG_REASON, judge_import

from tests.guess.flights import simulated

SEED = 8
RECIPE = FlightRecipe("makki2024", "flight code", 0, 0.12)
"""The flight `simulated` starts on the table, and its rotors lag."""


@pytest.mark.slow
@pytest.mark.parametrize("number", range(6))
def test_the_import_of_a_drawn_log_is_never_silently_wrong(number: int, tmp_path: Path) -> None:
    flight, _ = simulated(1)
    score = judge_import(draw_case(SEED, number, [RECIPE], [flight]), tmp_path)
    assert score.score not in (SILENT, WRONG_REASON), (score.detail, score.traits)
