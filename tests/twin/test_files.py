"""The files of the twin keep their content; a mistake in one is an error of one line."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from heli_host.cli import run
from heli_host.errors import HeliError
from heli_lab.estimation import DisturbanceModel
from heli_lab.twin import learn
from heli_lab.twin.calibration import Calibration, write_calibration
from heli_lab.twin.draws import FollowedFlight
from heli_lab.twin.files import DEFAULT_CALIBRATION, open_rig
from heli_lab.twin.parameter_uncertainty import ParameterUncertainty
from heli_lab.twin.tail import Tail

CALIBRATION = Calibration(
    DisturbanceModel(np.array([0.01, 0.002, 0.003]), np.array([0.4, 0.5, 0.6]), np.full(3, 1e-3), np.ones(3)),
    Tail(5.0, 140.0, 1.25, 30, 0.04, 52.5),
    'two flights, "a" and b',
    ParameterUncertainty(
        ("L_a", "M_w"),
        np.array([[4e-6, 1e-5], [1e-5, 9e-4]]),
        0.03,
        np.array([1.5, -0.5]),
        np.array([4.0, 5.0]),
    ),
)


def test_a_file_gives_back_what_was_learned(tmp_path: Path) -> None:
    path = tmp_path / "mine.twin.toml"
    write_calibration(path, CALIBRATION, "quanser-course")
    read = open_rig(str(path))
    assert read.rig.name == "quanser-course"
    assert read.calibration.tail == CALIBRATION.tail and read.calibration.source == CALIBRATION.source
    assert np.array_equal(read.calibration.disturbances.fast_std, CALIBRATION.disturbances.fast_std)
    known, written = read.calibration.uncertainty, CALIBRATION.uncertainty
    assert known.names == written.names and known.supply_std == written.supply_std
    for name in ("covariance", "low_V", "high_V"):
        assert np.array_equal(getattr(known, name), getattr(written, name))


def test_a_trained_twin_has_no_lower_threshold_than_an_ideal_one() -> None:
    """Twelve seconds of a quiet flight once gave a threshold of 8 nats, and a false alarm."""
    calm = replace(CALIBRATION, tail=Tail(2.0, 144.0, 1.0, 30, healthy_s=12.0))
    assert calm.threshold_nats(10.0) == DEFAULT_CALIBRATION.threshold_nats(10.0)


def test_a_rig_alone_has_the_default_disturbances() -> None:
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
    ("words", "message"),
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
def test_words_that_cannot_be_are_refused_in_one_line(
    words: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(words.split()) != 0
    shown = capsys.readouterr()
    assert message in " ".join((shown.out + shown.err).split())
    # Before any board is opened.
    assert "firmware 0" not in shown.out + shown.err
    assert "Traceback" not in shown.err


@pytest.mark.slow
def test_learning_from_a_healthy_flight_writes_a_file_that_the_twin_takes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    flown, file = tmp_path / "monday.mcap", tmp_path / "mine.toml"
    assert run(["fly", "hover", "--sil", "--speed", "max", "--log", str(flown)]) == 0
    # Draws take seconds: here the evidence of each is this.
    evidence = [(0.04 * number, 0.001 * (number % 977)) for number in range(1500)]
    monkeypatch.setattr(learn, "evidence", lambda *_: FollowedFlight(evidence, np.ones((1500, 3)), ()))
    monkeypatch.setattr(learn, "drawn_evidence", lambda *_: 12 * [evidence])
    assert run(["twin", "--rig", "makki2024", "--nominal", str(flown), "--learn", str(file)]) == 0
    printed = capsys.readouterr().out
    assert f"files: {file}" in printed and "almost no disturbances" in printed
    learned = open_rig(str(file))
    assert learned.rig.name == "makki2024"
    assert run(["twin", str(flown), "--rig", "quanser-course", "--to", "9"]) == 0
    assert "is a flight of rig makki2024, but the twin is of rig quanser-course" in capsys.readouterr().out
    assert learned.calibration.source == "monday.mcap"
    # A minute of flight supports one false alarm in two hours.
    assert learned.calibration.tail.healthy_s == pytest.approx(60.0)
    assert "one false alarm in 2 h in the air at best" in printed
    # Estimated disturbances of a flight without any are almost zero.
    fast_std_Nm = learned.calibration.disturbances.fast_std
    assert np.any(fast_std_Nm < DEFAULT_CALIBRATION.disturbances.fast_std)
    # Learned disturbances are not smaller than encoders can show.
    assert np.all(learned.calibration.disturbances.quantisation >= 1.0) and np.all(fast_std_Nm > 1e-4)
