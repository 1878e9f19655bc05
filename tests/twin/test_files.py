"""Twin files keep their content; a mistake in a file or an option is reported in one line."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from heli_host.errors import HeliError
from heli_host.ui.cli import run
from heli_lab.fit.grey_box import DisturbanceModel
from heli_lab.watch import learn
from heli_lab.watch.calibration import DEFAULT_CALIBRATION, Calibration, Tail, open_rig, write_calibration
from heli_lab.watch.learn import FollowedFlight
from heli_lab.watch.model_check import PieceVariance
from heli_lab.watch.twin_model import ParameterUncertainty

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
    monkeypatch.setattr(learn, "evidence", lambda *_: FollowedFlight(evidence, np.ones((1500, 3)), ()))
    monkeypatch.setattr(learn, "drawn_evidence", lambda *_: 12 * [evidence])
    assert run(["twin", "--rig", "makki2024", "--nominal", str(log), "--learn", str(twin_file)]) == 0
    printed = capsys.readouterr().out
    assert f"files: {twin_file}" in printed and "almost no disturbances" in printed
    learned = open_rig(str(twin_file))
    assert learned.rig.name == "makki2024"
    assert run(["twin", str(log), "--rig", "quanser-course", "--to", "9"]) == 0
    printed_of_other_rig = capsys.readouterr().out
    assert "is a flight of rig makki2024, but the twin is of rig quanser-course" in printed_of_other_rig
    assert "this twin has learned no flight of this machine" in printed_of_other_rig
    assert learned.calibration.source == "monday.mcap"
    # A minute of flight supports one false alarm in two hours.
    assert learned.calibration.tail.healthy_s == pytest.approx(60.0)
    assert "one false alarm in 2 h in the air at best" in printed
    # The flight had no disturbances. The learned ones are small, but not smaller than encoders can show.
    fast_std_Nm = learned.calibration.disturbances.fast_std
    assert np.any(fast_std_Nm < DEFAULT_CALIBRATION.disturbances.fast_std)
    assert np.all(fast_std_Nm > 1e-4)
    assert np.all(learned.calibration.disturbances.quantisation >= 1.0)
