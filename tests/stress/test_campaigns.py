"""A small share of the campaigns, and what they would complain about."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("heli_sim._native", reason="skipped: the simulation is not built")
pytest.importorskip("starlette", reason="skipped: the extra 'page' is not installed")

from tests.page.page_server import patient_page, steady
from tests.running.long import samples
from tests.running.order import REAL_TIME
from tests.stress.attack import attack_page
from tests.stress.serial_board import Truth
from tests.stress.serial_stories import Lived, late_text, story, table
from tests.stress.soak import Lateness, Soak, StatusAges, keep_busy

ROOT = Path(__file__).resolve().parents[2]
posix = pytest.mark.skipif(os.name != "posix", reason="skipped: Windows has no pseudo-terminals")


@posix
@pytest.mark.slow
@pytest.mark.xdist_group(REAL_TIME)
def test_stories_of_serial_trouble_end_with_a_true_reason_and_motors_off(tmp_path: Path) -> None:
    lines = tmp_path / "stories.jsonl"
    count = samples(300, 2)
    command = [sys.executable, "-m", "tests.stress.serial_stories", "--count", str(count), "--first", "8"]
    ended = subprocess.run(
        [*command, "--lines", str(lines)], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert ended.returncode == 0, ended.stdout + ended.stderr
    stories = [json.loads(line) for line in lines.read_text().splitlines()]
    assert len(stories) == count and all(story["outcome"] for story in stories)


@posix
@pytest.mark.slow
@pytest.mark.xdist_group(REAL_TIME)
def test_a_page_that_clients_attack_and_soak_answers_all_and_loses_no_client(tmp_path: Path) -> None:
    with patient_page(tmp_path, laws=[steady().program]) as served:
        assert not list(attack_page(served.address, 1, samples(1000, 25)))
        result = Soak(seed=1)
        keep_busy(result, served.address, os.getpid(), samples(600, 3) / 60.0, lambda line: None)
    assert not result.complaints
    assert result.statuses > 10 and result.acts and result.memory_kB


def test_a_number_is_always_the_same_story() -> None:
    assert [story(number) for number in range(50)] == [story(number) for number in range(50)]
    assert len({str(story(number)).partition("(")[2] for number in range(50)}) == 50


def heard(*messages: tuple[str, int]) -> Truth:
    from heli_host.declaration import MessageId

    truth = Truth()
    for name, tick in messages:
        truth.hear(MessageId[name], tick)
    return truth


def test_a_gap_of_two_seconds_is_the_boards_own_landing_and_later_setpoints_are_none() -> None:
    truth = heard(("ARM", 100), ("CONTROL", 150), ("SETPOINT", 200), ("SETPOINT", 2300), ("LAND", 2400))
    assert truth.longest_ticks == 2100 and truth.fresh_tick == 200 and truth.land_tick == -1
    followed = heard(("ARM", 100), ("CONTROL", 150), ("SETPOINT", 2100), ("LAND", 2200), ("SETPOINT", 9000))
    assert followed.longest_ticks == 1950 and followed.land_tick == 2200


def test_a_request_that_is_sent_again_is_no_setpoint() -> None:
    truth = heard(("CONTROL", 150), ("CONTROL", 1200), ("SETPOINT", 2300))
    assert truth.longest_ticks == 2150 and truth.fresh_tick == 150


def test_a_host_that_is_silent_between_arming_and_control_closes_nothing() -> None:
    truth = heard(("ARM", 100), ("CONTROL", 2200))
    assert truth.longest_ticks == 2100 and truth.closed_tick == -1


@pytest.mark.parametrize(
    ("messages", "last_on_tick", "says"),
    [
        ((("CONTROL", 0), ("SETPOINT", 100)), 29_999, "still run"),
        ((("CONTROL", 0), ("SETPOINT", 100), ("SETPOINT", 9000)), 6500, "after the newest setpoint"),
        ((("CONTROL", 0), ("SETPOINT", 100), ("LAND", 200)), 5000, "after the request to land"),
        ((("CONTROL", 0), ("SETPOINT", 100), ("LAND", 200)), 3500, ""),
    ],
)
def test_motors_that_run_too_long_are_noticed(
    messages: tuple[tuple[str, int], ...], last_on_tick: int, says: str
) -> None:
    truth = heard(*messages)
    truth.last_on_tick = last_on_tick
    late = late_text(truth, 30_000)
    assert says in late if says else not late


def test_the_table_counts_stories_with_complaints() -> None:
    bad = Lived(1, code=0, outcome="completed", kinds=["suspended"], complaints=["untrue"])
    good = Lived(2, code=0, outcome="completed", kinds=["suspended"])
    assert "| suspended | 2 | 1 |" in table([bad, good]) and "| completed | 2 |" in table([bad, good])


def test_a_status_is_shown_from_its_sending_to_the_next_and_an_old_one_not_at_all() -> None:
    ages = StatusAges(Lateness())
    for sent_s, now_s in ((10.0, 10.1), (10.2, 10.5), (10.4, 11.2), (10.5, 11.2), (11.0, 11.2)):
        ages.take(sent_s, now_s)
    # The second was shown until 11.2 s, with the red bar from 10.8 s on; two were too old when they came.
    assert ages.oldest_s == pytest.approx(0.5)
    assert (ages.bars + ages.bars_of_computer, ages.dropped, ages.received) == (1, 2, 5)


def test_memory_that_grows_after_the_warm_up_is_seen() -> None:
    warm = [(float(second), 1000 + second) for second in range(600)]
    flat = Soak(1, minutes=20.0, memory_kB=warm + [(float(second), 1600) for second in range(600, 1200)])
    grows = Soak(1, minutes=20.0, memory_kB=[(float(second), 1000 + second) for second in range(1200)])
    assert flat.growth() == 0.0 and grows.growth() > 0.2 and not grows.good
