"""The board behaves as it did when its behaviour was recorded, to the bit."""

import pytest

from tests.flight import baseline
from tests.flight.script_book import SCRIPTS

RECORDED = baseline.read()


@pytest.mark.medium
@pytest.mark.parametrize("name", SCRIPTS)
def test_a_script_has_the_recorded_outcome(name: str) -> None:
    """If the change is intended, run ``python -m tests.flight.baseline`` and review the difference."""
    recorded = RECORDED["scripts"][name]
    notes = baseline.play(name, baseline.laws_of(RECORDED), recorded["windows"])
    assert notes.events == recorded["events"]
    assert notes.windows == recorded["windows"]
