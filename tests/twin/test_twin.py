"""A twin detects, names and measures a change, in flight and afterwards, and lands the rig; its files."""

import math
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import numpy as np
import pytest
from heli_host.data.log.reader import Log, read_log
from heli_host.errors import HeliError
from heli_host.ui.cli import run
from heli_lab.fit.grey_box import DisturbanceModel
from heli_lab.watch import learn
from heli_lab.watch.calibration import (
    DEFAULT_CALIBRATION,
    Calibration,
    Tail,
    TwinRig,
    open_rig,
    write_calibration,
)
from heli_lab.watch.learn import FollowedFlight
from heli_lab.watch.model_check import PieceVariance
from heli_lab.watch.monitor import TwinReport, monitor_file, open_twin
from heli_lab.watch.twin_model import ParameterUncertainty
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


def fly_excited(folder: Path, address: str) -> Path:
    """Fly `EXCITED_PLAN` on a simulated board; return the log."""
    plan, log = folder / "short.toml", folder / "flight.mcap"
    plan.write_text(EXCITED_PLAN)
    run(["fly", str(plan), "--log", str(log), "--port", address])
    return log


@pytest.mark.slow
def test_a_machine_whose_rotors_lag_is_not_this_model_and_no_change_of_it_is_named(tmp_path: Path) -> None:
    log = fly_excited(tmp_path, "sil://?effect=rotor_lag%3D0.1&speed=max")
    report = monitor_file(open_rig("makki2024"), log, FALSE_ALARM_INTERVAL_h)
    assert not report.alarms
    (sentence,) = report.sentences()
    assert sentence.startswith("not this model from the start")


@pytest.mark.slow
def test_half_the_counts_of_travel_are_named(tmp_path: Path) -> None:
    log = fly_excited(tmp_path, "sil://?encoder_scale=travel:0.5")
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


CALIBRATION = Calibration(
    DisturbanceModel(
        fast_std=np.array([0.01, 0.002, 0.003]),
        correlation_time_s=np.array([0.4, 0.5, 0.6]),
        slow_std=np.full(3, 1e-3),
        quantisation=np.ones(3),
    ),
    Tail(level_nats=5.0, per_hour=140.0, scale_nats=1.25, excesses=30, shape=0.04, healthy_s=52.5),
    source='two flights, "a" and b',
    uncertainty=ParameterUncertainty(
        names=("L_a", "M_w"),
        covariance=np.array([[4e-6, 1e-5], [1e-5, 9e-4]]),
        supply_std=0.03,
        low_V=np.array([1.5, -0.5]),
        high_V=np.array([4.0, 5.0]),
    ),
    piece_variance=PieceVariance(np.array([1.5, 0.5, 2.0]), 50.0),
)


def test_a_twin_file_keeps_the_calibration(tmp_path: Path) -> None:
    path = tmp_path / "mine.twin.toml"
    write_calibration(path, CALIBRATION, "quanser-course")
    twin_rig = open_rig(str(path))
    read, written = twin_rig.calibration, CALIBRATION
    assert twin_rig.rig.name == "quanser-course"
    assert read.tail == written.tail and read.source == written.source
    assert np.array_equal(read.disturbances.fast_std, written.disturbances.fast_std)
    assert read.piece_variance.pieces == written.piece_variance.pieces
    assert np.array_equal(read.piece_variance.variance, written.piece_variance.variance)
    assert read.uncertainty.names == written.uncertainty.names
    assert read.uncertainty.supply_std == written.uncertainty.supply_std
    for name in ("covariance", "low_V", "high_V"):
        assert np.array_equal(getattr(read.uncertainty, name), getattr(written.uncertainty, name))


def test_a_trained_twin_has_no_lower_threshold_than_an_ideal_one() -> None:
    """Without that bound, twelve seconds of a quiet flight give a threshold of 8 nats, and a false alarm."""
    tail_of_quiet_flight = Tail(level_nats=2.0, per_hour=144.0, scale_nats=1.0, excesses=30, healthy_s=12.0)
    trained = replace(CALIBRATION, tail=tail_of_quiet_flight)
    assert trained.threshold_nats(10.0) == DEFAULT_CALIBRATION.threshold_nats(10.0)


def test_a_rig_without_a_twin_file_has_the_default_calibration() -> None:
    assert open_rig("makki2024").calibration is DEFAULT_CALIBRATION


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("fast_std_Nm = [", "fast_std_Nm = [-", "disturbances.fast_std"),
        ("level_nats = 5", "level_nats = nan", "tail.level_nats"),
        ('rig = "makki2024"', "", "names no rig"),
        ("[tail]", "[tail", "is not TOML"),
        ("scale_nats", "scale", "tail.scale_nats"),
        ("excesses = 30", "excesses = 0", "tail.excesses"),
        ("healthy_s = 52.5", "healthy_s = nan", "tail.healthy_s"),
        ("  [4e-06, 1e-05],\n", "", "parameters.covariance does not have 2 rows"),
        ("supply_std = 0.03", "supply_std = inf", "parameters.supply_std"),
        ("low_V = [1.5, -0.5]", "low_V = [1.5]", "parameters.low_V"),
        ("piece_variance = [1.5", "piece_variance = [-1.5", "innovations.piece_variance"),
        ("pieces = 50", "pieces = 0", "innovations.pieces"),
    ],
)
def test_a_mistake_in_a_file_is_reported(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = tmp_path / "wrong.toml"
    write_calibration(path, CALIBRATION, "makki2024")
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(HeliError, match=message) as error:
        open_rig(str(path))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("command", "message"),
    [
        ("twin", "no flight is given; give one"),
        ("twin nowhere.mcap", "nowhere.mcap"),
        ("twin --learn monday.mcap", "give a name that ends in .toml"),
        ("twin nowhere.mcap --rig nobody", "nobody"),
        ("fly hover --sil --on-alarm land", "--on-alarm needs a twin"),
        ("fly hover --sil --twin makki2024 --on-alarm fall", "choose warn or land"),
        ("fly hover --sil --twin nobody", "nobody"),
        ("dashboard --sil --twin nobody", "nobody"),
        ("dashboard --replay nothere", "nothere"),
        ("dashboard --replay nothere --twin makki2024", "heli-host twin nothere"),
        ("dashboard --replay nothere --fly hover", "flies nothing"),
        ("dashboard --replay nothere --law mine.py", "flies nothing"),
        ("dashboard --sil --law mine.py", "mine.py is not a file"),
    ],
)
def test_invalid_options_are_refused_before_a_board_is_opened(
    command: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(command.split()) != 0
    captured = capsys.readouterr()
    output = captured.out + captured.err
    # The message may be broken into lines.
    assert message in " ".join(output.split())
    board_was_opened = "firmware 0" in output
    assert not board_was_opened
    assert "Traceback" not in captured.err


@pytest.mark.slow
def test_a_twin_file_that_was_learned_from_a_flight_can_be_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    log, twin_file = tmp_path / "monday.mcap", tmp_path / "mine.toml"
    assert run(["fly", "hover", "--sil", "--speed", "max", "--log", str(log)]) == 0
    # Drawing evidence takes seconds, so each draw has the same invented evidence of a minute.
    evidence = [(0.04 * number, 0.001 * (number % 977)) for number in range(1500)]
    monkeypatch.setattr(
        learn, "evidence", lambda *_: FollowedFlight(evidence, innovations=np.ones((1500, 3)), kicks_s=())
    )
    monkeypatch.setattr(learn, "drawn_evidence", lambda *_: 12 * [evidence])
    assert run(["twin", "--rig", "makki2024", "--nominal", str(log), "--learn", str(twin_file)]) == 0
    printed = capsys.readouterr().out
    assert f"files: {twin_file}" in printed and "almost no disturbances" in printed
    learned = open_rig(str(twin_file))
    assert learned.rig.name == "makki2024"
    assert run(["twin", str(log), "--rig", "quanser-course", "--to", "9"]) == 0
    printed_of_other_rig = capsys.readouterr().out
    assert "is a flight of rig makki2024, and --rig is quanser-course" in printed_of_other_rig
    assert "this twin has learned no flight of this machine" in printed_of_other_rig
    assert "learned from" not in printed_of_other_rig
    assert learned.calibration.source == "monday.mcap"
    for words in (["--rig", str(twin_file)], ["--nominal", str(log)]):
        assert run(["twin", str(log), "--to", "9", *words]) == 0
        printed_of_learned = capsys.readouterr().out
        assert "the twin has learned from monday.mcap, so it cannot detect" in printed_of_learned
    assert "disturbances from monday.mcap, threshold from a quiet room" in printed_of_learned
    # A minute of flight supports one false alarm in two hours.
    assert learned.calibration.tail.healthy_s == pytest.approx(60.0)
    assert "one false alarm in 2 h in the air at best" in printed
    # The flight had no disturbances. The learned ones are small, but not smaller than encoders can show.
    fast_std_Nm = learned.calibration.disturbances.fast_std
    assert np.any(fast_std_Nm < DEFAULT_CALIBRATION.disturbances.fast_std)
    assert np.all(fast_std_Nm > 1e-4)
    assert np.all(learned.calibration.disturbances.quantisation >= 1.0)
