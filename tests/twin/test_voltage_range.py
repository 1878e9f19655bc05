"""Voltages that no nominal flight contains are not judged, and the result states which and for how long."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from heli_lab.twin.events import TwinEvent
from heli_lab.twin.monitor import TwinReport
from heli_lab.twin.parameter_uncertainty import EXACT
from heli_lab.twin.voltage_range import VoltageRange

KNOWN = replace(EXACT, low_V=np.array([0.0, 1.7]), high_V=np.full(2, 5.5))
REASON = "the front rotor gets -0.3 V (it reverses); the twin knows 0.0 V to 5.5 V from its nominal flights"


def test_a_rotor_that_reverses_is_not_judged_for_one_second_and_reported_once() -> None:
    known = VoltageRange(KNOWN, 0.01)
    assert known.update(1, np.array([1.0, 2.0])) == "" and known.is_known(1)
    assert known.update(2, np.array([-0.3, 2.0])) == REASON
    assert known.update(3, np.array([-0.4, 2.0])) == ""
    assert not known.is_known(3) and not known.is_known(103) and known.is_known(104)


def test_the_rotor_that_is_farthest_outside_is_named() -> None:
    reason = VoltageRange(KNOWN, 0.01).update(0, np.array([-0.1, 1.0]))
    assert reason.startswith("the back rotor gets 1.0 V; the twin knows 1.7 V to 5.5 V")


def sentences(unjudged_s: float) -> list[str]:
    event = TwinEvent("unjudged", 7.0, REASON)
    return TwinReport("flight", (event,), ((8.0, 3.0),), 14.0, 20.0, unjudged_s).sentences()


def test_the_result_states_what_was_not_judged() -> None:
    unchanged, rest = sentences(12.0)
    assert unchanged == "no change of the rig in 8 s (evidence: 3.0 nats at most)"
    assert rest == f"12.0 s of 20.0 s are not judged: {REASON}"


def test_a_flight_that_was_not_judged_is_not_called_unchanged() -> None:
    assert sentences(19.5) == [f"19.5 s of 20.0 s are not judged: {REASON}"]
