"""Whatever happens to a flight: no wrong tick, every loss counted, the true reason reported, motors off."""

from __future__ import annotations

from collections import Counter

import pytest

from tests.running.long import samples
from tests.sil.faulty_flights import BLOWS, case, flown, mistakes_of, reason

pytestmark = pytest.mark.slow

FLIGHTS = 150
CUT_FRAME = 439
"""Flight in which the cable cuts a frame in its middle."""


def test_every_faulty_flight_is_reported_as_it_was() -> None:
    reasons: Counter[str] = Counter()
    complaints = []
    for number in (*range(samples(FLIGHTS, len(BLOWS))), CUT_FRAME):
        flight = flown(case(number))
        reasons[reason(flight)] += 1
        complaints += [f"{flight.case}: {complaint}" for complaint in mistakes_of(flight)]
    assert not complaints, "\n".join(complaints)
    # The set is worth something only while it has flights of all these ends in it.
    assert {"completed", "because of stale_land", "fault hardware_stop", "fault pitch_limit"} <= set(reasons)
    assert len(reasons) >= 8
