"""A kept result is made once for all workers, and again when anything that determines it has changed."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.running.kept import FITTED, FLOWN, ROOT, Kept

Place = Callable[[], Kept]


@pytest.fixture
def place(tmp_path: Path) -> Place:
    """A small project; each call opens it as a new run does."""
    for room in FITTED:
        (tmp_path / "project" / room).mkdir(parents=True)
    for name in ("host/heli_host/fly.py", "sim/heli_sim/rigs/small.toml", "firmware/core/law.cpp"):
        path = tmp_path / "project" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f"# {name}\n")
    for name in ("heli_sim/_native.so", "heli_sim/model.py"):
        path = tmp_path / "installed" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f"{name}\n")
    (tmp_path / "helper.py").write_text("SECONDS = 10\n")
    return lambda: Kept(tmp_path / "kept", tmp_path / "project", tmp_path / "installed")


class Maker:
    """Counts its calls."""

    def __init__(self) -> None:
        self.times = 0

    def __call__(self) -> int:
        self.times += 1
        return self.times


def test_a_result_is_made_once_in_this_run_and_the_next(place: Place, tmp_path: Path) -> None:
    make = Maker()
    this_run = place()
    results = [this_run("a flight", make, made_by=[tmp_path / "helper.py"]) for _ in range(3)]
    assert [*results, place()("a flight", make, made_by=[tmp_path / "helper.py"])] == [1, 1, 1, 1]
    assert make.times == 1
    assert this_run("another flight", make, made_by=[]) == 2


@pytest.mark.parametrize(
    "changed",
    [
        "project/host/heli_host/fly.py",
        "project/sim/heli_sim/rigs/small.toml",
        "project/firmware/core/law.cpp",
        "installed/heli_sim/_native.so",
        "helper.py",
    ],
)
def test_a_change_of_any_source_makes_it_again(place: Place, tmp_path: Path, changed: str) -> None:
    make, helpers = Maker(), [tmp_path / "helper.py"]
    assert place()("a flight", make, made_by=helpers) == 1
    path = tmp_path / changed
    before = path.read_text()
    path.write_text(before + "# edited\n")
    assert place()("a flight", make, made_by=helpers) == 2
    path.write_text(before)
    assert place()("a flight", make, made_by=helpers) == 3, "only the newest is kept"
    path.rename(path.with_name(f"other_{path.name}")) if path.name != "helper.py" else path.write_text("")
    assert place()("a flight", make, made_by=helpers) == 4, "a name counts, too"


def test_documents_bytecode_and_other_folders_change_nothing(place: Place, tmp_path: Path) -> None:
    make, project = Maker(), tmp_path / "project"
    assert place()("a flight", make, made_by=[], rooms=FLOWN) == 1
    (project / "host" / "README.md").write_text("Words.\n")
    (project / "host" / "fly.pyc").write_bytes(b"made of fly.py")
    (project / "sim" / "heli_lab").mkdir(exist_ok=True)
    (project / "sim" / "heli_lab" / "fit.py").write_text("")
    assert place()("a flight", make, made_by=[], rooms=FLOWN) == 1
    assert place()("a fit", make, made_by=[], rooms=FITTED) == 2


@pytest.mark.medium
def test_two_workers_at_once_make_it_once(place: Place, tmp_path: Path) -> None:
    place()
    script = (
        "import sys, time; from pathlib import Path; from tests.running.kept import Kept\n"
        f"here = Path({str(tmp_path)!r})\n"
        "def make():\n"
        "    with (here / 'made').open('a') as file: file.write('once ')\n"
        "    time.sleep(0.3)\n"
        "    return 'a flight'\n"
        "print(Kept(here / 'kept', here / 'project', here / 'installed')('slow', make, made_by=[]))\n"
    )
    workers = [
        subprocess.Popen([sys.executable, "-c", script], cwd=ROOT, stdout=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    assert [worker.communicate()[0] for worker in workers] == ["a flight\n"] * 2
    assert (tmp_path / "made").read_text() == "once "


def test_a_failure_is_not_kept(place: Place) -> None:
    def fail() -> int:
        raise ArithmeticError("crashed")

    with pytest.raises(ArithmeticError):
        place()("a flight", fail, made_by=[])
    assert place()("a flight", Maker(), made_by=[]) == 1
