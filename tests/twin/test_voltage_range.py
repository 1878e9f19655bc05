"""A twin does not judge flights at voltages that no nominal flight contains, and reports these voltages."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from heli_lab.watch.monitor import TwinReport
from heli_lab.watch.steps import VoltageRange
from heli_lab.watch.twin import TwinEvent
from heli_lab.watch.twin_model import EXACT

STEP_s = 0.01
KNOWN_VOLTAGES = replace(EXACT, low_V=np.array([0.0, 1.7]), high_V=np.full(2, 5.5))
REASON = "the front rotor gets -0.3 V (it reverses); the twin knows 0.0 V to 5.5 V from its nominal flights"


def test_a_rotor_that_reverses_is_not_judged_for_one_second_and_reported_once() -> None:
    voltage_range = VoltageRange(KNOWN_VOLTAGES, STEP_s)
    assert voltage_range.update(1, np.array([1.0, 2.0])) == ""
    assert voltage_range.is_known(1)
    assert voltage_range.update(2, np.array([-0.3, 2.0])) == REASON
    assert voltage_range.update(3, np.array([-0.4, 2.0])) == ""
    # Step 103 is one second after the last step with an unknown voltage.
    assert not voltage_range.is_known(3) and not voltage_range.is_known(103)
    assert voltage_range.is_known(104)


def test_a_range_is_extrapolated_by_a_tenth_but_not_across_zero() -> None:
    voltages = replace(EXACT, low_V=np.array([0.0, -1.0]), high_V=np.array([2.0, 3.0]))
    known = [(0.0, 0.0), (2.19, 0.0), (0.0, 3.39), (0.0, -1.39)]
    unknown = [(-0.01, 0.0), (2.21, 0.0), (0.0, 3.41), (0.0, -1.41)]
    for volts_V in known:
        assert VoltageRange(voltages, STEP_s).update(0, np.array(volts_V)) == ""
    for volts_V in unknown:
        assert VoltageRange(voltages, STEP_s).update(0, np.array(volts_V)) != ""


def test_exact_parameters_hold_for_all_voltages() -> None:
    assert VoltageRange(EXACT, STEP_s).update(0, np.array([-100.0, 100.0])) == ""


def test_the_rotor_that_is_farthest_outside_is_named() -> None:
    reason = VoltageRange(KNOWN_VOLTAGES, STEP_s).update(0, np.array([-0.1, 1.0]))
    assert reason.startswith("the back rotor gets 1.0 V; the twin knows 1.7 V to 5.5 V")


def sentences_of_flight(unjudged_s: float) -> list[str]:
    """Describe a flight of 20 s without an alarm, of which `unjudged_s` were not judged."""
    report = TwinReport(
        label="flight",
        events=(TwinEvent("unjudged", 7.0, REASON),),
        evidence_nats=((8.0, 3.0),),
        threshold_nats=14.0,
        free_s=20.0,
        unjudged_s=unjudged_s,
    )
    return report.sentences()


def test_the_report_states_how_long_the_twin_did_not_judge() -> None:
    no_change, not_judged = sentences_of_flight(12.0)
    assert no_change == "no change of the rig in 8 s (evidence: 3.0 nats at most)"
    assert not_judged == f"12.0 s of 20.0 s are not judged: {REASON}"


def test_a_flight_that_was_not_judged_is_not_called_unchanged() -> None:
    assert sentences_of_flight(19.5) == [f"19.5 s of 20.0 s are not judged: {REASON}"]
