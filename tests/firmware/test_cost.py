"""The control tick stays within its share of the processor, over the most expensive flights there are."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("due_emulator._due", reason="the emulated Due is not built: make setup")
pytest.importorskip("elftools", reason="pyelftools is missing: make setup")

from tests.firmware.cost import Costs, measure_costs

pytestmark = pytest.mark.emulated


@pytest.fixture(scope="module")
def costs(elf: Path) -> Costs:
    """Counted once for all claims."""
    return measure_costs(elf)


def test_a_tick_takes_at_most_7_percent_of_its_millisecond(costs: Costs) -> None:
    # They are 4,618 with GCC 12.2. GCC 8.3 needs a fifth more, and PlatformIO pins a version in between.
    assert 0 < costs.tick_instructions_mean < costs.tick_instructions_max <= 6000


def test_the_control_law_takes_a_third_of_that_and_less_than_three_loops_of_pid_v1(costs: Costs) -> None:
    assert 0 < costs.cascade_instructions_max <= 2000
    assert costs.cascade_instructions_max < costs.pid_v1_three_loops_instructions


def test_an_encoder_edge_takes_at_most_60_instructions(costs: Costs) -> None:
    assert 0 < costs.encoder_isr_instructions_max <= 60
