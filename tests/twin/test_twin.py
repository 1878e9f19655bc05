"""A twin detects, names and measures a change, in flight as afterwards, and lands the rig on request."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import numpy as np
import pytest
from heli_host.data.log.reader import Log, read_log
from heli_host.ui.cli import run
from heli_lab.fit.grey_box import DisturbanceModel
from heli_lab.watch.calibration import DEFAULT_CALIBRATION, Calibration, TwinRig, open_rig
from heli_lab.watch.monitor import TwinReport, monitor_file, open_twin
from scipy.special import bdtrc

from tests.running.long import LONG, samples
from tests.twin.__main__ import FALSE_ALARM_INTERVAL_h, fly_changed, fly_healthy
from tests.twin.rigs import RigWithTwin, rig_with_twin, true_rig

CHANGED_s = 12.0
"""Time from the first turn of the motors to the change [s]."""
TICK_s = 1e-3
PLAN = """
title = "Short"
[start]
elevation_deg = 0
rate_deg_s = 12
settle_s = 1
[[segment]]
kind = "sine"
travel_amplitude_deg = 20
travel_period_s = 14
elevation_amplitude_deg = 5
elevation_period_s = 8
duration_s = 15
"""


@dataclass(frozen=True)
class WatchedFlight:
    """A flight whose front rotor loses 8 % of its thrust, with a twin that lands the rig on an alarm."""

    path: Path
    exit_code: int
    log: Log
    report: TwinReport

    def messages(self, name: str) -> list[str]:
        """Return the messages of the log's events `name`."""
        return [str(event["message"]) for event in self.log.events if event["name"] == name]


@cache
def flight_with_twin() -> WatchedFlight:
    folder = Path(mkdtemp())
    plan, path = folder / "short.toml", folder / "flight.mcap"
    plan.write_text(PLAN)
    command = f"fly {plan} --sil --speed max --effect thrust_step.front=0.08@{CHANGED_s:g}"
    exit_code = run([*command.split(), "--twin", "makki2024", "--on-alarm", "land", "--log", str(path)])
    report = monitor_file(open_rig("makki2024"), path, FALSE_ALARM_INTERVAL_h)
    return WatchedFlight(path, exit_code, read_log(path), report)


@pytest.mark.slow
def test_a_loss_of_thrust_is_detected_named_and_measured() -> None:
    flight = flight_with_twin()
    (alarm,) = flight.report.alarms
    most_likely = alarm.ranking[0]
    front_V, t_s = flight.log.flight().front_V, flight.log.ticks["t_s"]
    motors_on_s = float(t_s[np.flatnonzero(front_V > 0)[0]])
    assert most_likely.change.id == "thrust_step.front"
    assert abs(most_likely.size - 0.08) < 3 * most_likely.std
    assert abs(alarm.onset_s - (motors_on_s + CHANGED_s)) < 1.0
    assert "the front rotor lost" in alarm.text and "times more likely than the next" in alarm.text


@pytest.mark.slow
def test_the_flight_ends_in_a_landing_and_the_log_states_why() -> None:
    flight = flight_with_twin()
    assert flight.exit_code != 0
    assert any(message.startswith("alarm at") for message in flight.messages("twin"))
    assert flight.messages("phase")[-1] == "landing"
    # The whole plan would take longer.
    assert flight.log.ticks["t_s"][-1] < 21.0


@pytest.mark.slow
def test_the_events_in_flight_and_afterwards_are_equal() -> None:
    """In flight the ticks arrive in batches of random length."""
    flight = flight_with_twin()
    log = flight.log
    twin = open_twin("makki2024")(log.parameters, FALSE_ALARM_INTERVAL_h)
    tick = int(log.ticks["tick"][0]) + np.rint(log.ticks["t_s"] / TICK_s).astype(np.int64)
    rng = np.random.default_rng(1)
    start, live_events = 0, []
    while start < len(tick):
        stop = start + int(rng.integers(1, 150))
        live_events += twin.update(tick[start:stop], log.raw[start:stop])
        start = stop
    later_events = [event for event in flight.report.events if event.kind != "diagnosed" or event.ranking]
    assert [event.kind for event in live_events] == [event.kind for event in later_events]
    live_ticks = [event.tick - int(tick[0]) for event in live_events]
    assert live_ticks == [round(event.t_s / TICK_s) for event in later_events]


@pytest.mark.slow
def test_the_log_has_the_alarm_at_the_time_of_the_later_report() -> None:
    flight = flight_with_twin()
    logged_s = [
        float(event["t_s"]) for event in flight.log.events if str(event["message"]).startswith("alarm at")
    ]
    reported_s = [event.t_s for event in flight.report.events if event.kind == "alarm"]
    # The alarm is logged when its step of 10 ms is complete and its batch of ticks has arrived.
    assert 0.0 <= logged_s[0] - reported_s[0] < 0.06


@pytest.mark.slow
def test_the_part_of_a_flight_before_the_change_has_no_alarm() -> None:
    path = flight_with_twin().path
    report = monitor_file(open_rig("makki2024"), path, FALSE_ALARM_INTERVAL_h, stop_s=CHANGED_s)
    assert report.free_s > 5.0 and not report.alarms


EXCITED_PLAN = """
title = "Short"
[start]
elevation_deg = 0
rate_deg_s = 12
settle_s = 2
[[segment]]
kind = "sine"
travel_amplitude_deg = 12
travel_period_s = 12
elevation_amplitude_deg = 4
elevation_period_s = 8
duration_s = 14
excite = { signal = "multisine", front_V = 0.3, back_V = 0.3, start_Hz = 0.1, stop_Hz = 3 }
"""


def fly_with_scale(folder: Path, encoder_scale: str) -> Path:
    """Fly `EXCITED_PLAN` with a scale such as ``travel:0.5``; return the log."""
    plan, log = folder / "short.toml", folder / "flight.mcap"
    plan.write_text(EXCITED_PLAN)
    port = f"sil://?encoder_scale={encoder_scale}"
    run(["fly", str(plan), "--log", str(log), "--port", port])
    return log


@pytest.mark.slow
def test_half_the_counts_of_travel_are_named(tmp_path: Path) -> None:
    log = fly_with_scale(tmp_path, "travel:0.5")
    (alarm,) = monitor_file(open_rig("makki2024"), log, FALSE_ALARM_INTERVAL_h).alarms
    most_likely = alarm.ranking[0]
    assert most_likely.change.id == "encoder_scale.travel"
    # The estimate of so large a change is approximate, because the twin is linearised.
    assert -1.0 < most_likely.size < -0.25
    assert "the travel encoder counts" in alarm.text and "fewer than its counts" in alarm.text


RIGS = samples(20, 1)
HEALTHY_FLIGHTS = samples(10, 1)
CHANGES = [("thrust_step.back", 0.1), ("zero_offset.elevation", 0.02), ("coulomb_friction.pitch", 0.02)]


def rig_for_test(seed: int) -> RigWithTwin:
    """Return a rig with a trained twin; in the short tests, the twin has the true parameters instead."""
    if LONG:
        return rig_with_twin(seed, drawn_minutes=12)
    drawn = true_rig(seed)
    # An angle's rounding error repeats itself, so that the filter needs a larger variance.
    disturbances = DisturbanceModel(
        drawn.disturbances.fast_std,
        drawn.disturbances.correlation_time_s,
        drawn.disturbances.slow_std,
        quantisation=np.array([1.8, 1.4, 1.1]),
    )
    calibration = Calibration(disturbances, DEFAULT_CALIBRATION.tail)
    twin = TwinRig(drawn.rig, drawn.model, calibration, f"rig {seed}")
    return RigWithTwin(seed, drawn.rig, drawn.disturbed_model, twin)


@pytest.mark.slow
def test_false_alarms_are_as_rare_as_stated_and_changes_get_their_names() -> None:
    false_alarms, chances, changed = 0, [], []
    for seed in range(1, RIGS + 1):
        rig = rig_for_test(seed)
        healthy = fly_healthy(rig, HEALTHY_FLIGHTS, samples(60, 45))["healthy"]
        false_alarms += sum(flight["alarms"] > 0 for flight in healthy)
        chances += [1.0 - math.exp(-flight["free_s"] / 3600.0 / FALSE_ALARM_INTERVAL_h) for flight in healthy]
        for number, (name, size) in enumerate(CHANGES[: samples(3, 1)]):
            changed.append(fly_changed(rig, name, size, flight_seed=2_000 + 20 * number))
    probability_of_as_many = bdtrc(false_alarms - 1, len(chances), float(np.mean(chances)))
    assert probability_of_as_many > 0.01
    named = [flight for flight in changed if flight.get("name") == flight["change"]]
    assert len(named) >= 0.9 * len(changed)
