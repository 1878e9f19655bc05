"""Order and cost of tests, shares of samples, kept results, measures of pictures, and stalls of processes."""

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib import image

from tests.running import alone, long
from tests.running.kept import FITTED, FLOWN, ROOT, Kept
from tests.running.long import samples, select_cases
from tests.running.order import REAL_TIME, group_of, plain, pytest_collection_modifyitems
from tests.running.pixels import coloured_share
from tests.running.stalls import run

pytest_plugins = ["pytester"]

MARKERS = "markers =\n  medium\n  slow\n  emulated\n  documents\n"
TESTS = f"""
import pytest

def test_cheap(): pass

@pytest.mark.slow
def test_slow(): pass

@pytest.mark.documents
@pytest.mark.xdist_group("document-b.md")
def test_document(): pass

@pytest.mark.xdist_group("document-a.md")
def test_other_document(): pass

@pytest.mark.xdist_group("{REAL_TIME}")
def test_that_waits(): pass
"""


def ordered(
    pytester: pytest.Pytester, known_s: dict[str, float], *, worker: bool = True
) -> list[pytest.Item]:
    """Return tests in the order in which a worker would run them."""
    pytester.makeini(f"[pytest]\n{MARKERS}")
    items = pytester.getitems(TESTS)
    cache = SimpleNamespace(get=lambda key, default: known_s)
    config: Any = SimpleNamespace(
        cache=cache, getoption=lambda name: False, **({"workerinput": {}} if worker else {})
    )
    pytest_collection_modifyitems(config, items)
    return items


def names(items: list[pytest.Item]) -> list[str]:
    return [item.name.removeprefix("test_") for item in items]


@pytest.mark.medium
def test_flights_in_real_time_are_first_then_markers_or_known_costs_decide(pytester: pytest.Pytester) -> None:
    items = ordered(pytester, {})
    assert names(items) == ["that_waits", "document", "cheap", "slow", "other_document"]
    groups = {item.name: group_of(item) for item in items}
    file = items[0].nodeid.partition("::")[0]
    assert groups["test_cheap"] == groups["test_slow"] == file
    assert groups["test_document"] == "document-b.md"
    known_s = {
        f"{file}::test_{name}": cost_s
        for name, cost_s in (("other_document", 50.0), ("document", 1.0), ("cheap", 9.0))
    }
    assert names(ordered(pytester, known_s)) == ["that_waits", "other_document", "cheap", "slow", "document"]


@pytest.mark.medium
def test_one_process_keeps_the_order_of_the_file(pytester: pytest.Pytester) -> None:
    items = ordered(pytester, {}, worker=False)
    assert names(items) == ["cheap", "slow", "document", "other_document", "that_waits"]
    assert not any(items[0].iter_markers("xdist_group"))


@pytest.mark.medium
def test_the_tests_of_a_file_run_in_one_worker(
    pytester: pytest.Pytester, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    pytester.makeini("[pytest]\naddopts = --dist=loadgroup --no-loadscope-reorder\n")
    test = """
    import os, time
    from pathlib import Path
    import pytest
    @pytest.mark.parametrize("number", range(6))
    def test_of_a_file(number):
        time.sleep(0.05)
        with Path(__file__).with_suffix(".txt").open("a") as file:
            print(os.environ["PYTEST_XDIST_WORKER"], file=file)
    """
    pytester.makepyfile(test_one=test, test_two=test)
    arguments = ("-n2", "-p", "tests.running.order", "-p", "no:cacheprovider")
    result = pytester.runpytest_subprocess(*arguments)
    result.assert_outcomes(passed=12)
    result.stdout.fnmatch_lines(
        ["* s of CPU, of which * to start and collect; most expensive: test_of_a_file*"]
    )
    workers = [set((pytester.path / f"test_{name}.txt").read_text().split()) for name in ("one", "two")]
    assert sorted(map(sorted, workers)) == [["gw0"], ["gw1"]]


@pytest.mark.medium
@pytest.mark.parametrize(
    ("nodeid", "name"),
    [
        ("tests/log/test_log.py::test_cut@tests/log/test_log.py", "tests/log/test_log.py::test_cut"),
        ("test_a.py::test_b[who@where]@group", "test_a.py::test_b[who@where]"),
        ("test_a.py::test_b[who@where]", "test_a.py::test_b[who@where]"),
        ("test_a.py::test_b", "test_a.py::test_b"),
    ],
)
def test_a_test_has_the_same_name_in_each_worker(nodeid: str, name: str) -> None:
    assert plain(nodeid) == name


@pytest.mark.medium
def test_quick_leaves_expensive_tests_out_and_does_not_import_their_files(pytester: pytest.Pytester) -> None:
    pytester.makeini(f"[pytest]\n{MARKERS}")
    pytester.makepyfile(
        test_mixed=TESTS,
        test_expensive="""
        import pytest

        pytestmark = pytest.mark.emulated

        raise AssertionError("imported")
        """,
    )
    result = pytester.runpytest_inprocess("-p", "tests.running.order", "--quick", "-p", "no:cacheprovider")
    result.assert_outcomes(passed=3, deselected=2)


@pytest.mark.medium
def test_an_expensive_test_is_listed_unless_it_has_a_marker(pytester: pytest.Pytester) -> None:
    pytester.makeini(f"[pytest]\n{MARKERS}")
    pytester.makepyfile("""
        import pytest
        from tests.running import alone

        def test_waiting(): alone.charge(1.5)

        @pytest.mark.medium
        def test_medium(): alone.charge(1.5)

        @pytest.mark.slow
        def test_slow(): alone.charge(9)
        """)
    result = pytester.runpytest_inprocess("-p", "tests.running.order", "-p", "no:cacheprovider")
    alone.charge(-12.0)
    listed = [line for line in result.outlines if line.startswith("make it cheaper")]
    assert [line.rpartition("::")[2] for line in listed] == ["test_waiting: 1.5 s of CPU, limit 1 s"]


CASES = [f"{kind}{number}" for kind, count in (("a", 7), ("b", 1), ("c", 4)) for number in range(count)]


def test_a_share_has_at_least_one_case_of_each_kind(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(long, "LONG", False)
    assert select_cases(CASES, every=3, kind=lambda case: case[0]) == ["a0", "a3", "a6", "b0", "c0", "c3"]
    assert select_cases(CASES, every=5) == ["a0", "a5", "c2"]
    assert samples(200, 8) == 8
    monkeypatch.setattr(long, "LONG", True)
    assert select_cases(CASES, every=3, kind=lambda case: case[0]) == CASES
    assert samples(200, 8) == 200


def test_only_coloured_pixels_count(tmp_path: Path) -> None:
    picture = np.full((10, 10, 3), 0.5)
    picture[:3] = (0.1, 0.4, 0.9)
    image.imsave(tmp_path / "picture.png", picture)
    assert coloured_share(tmp_path / "picture.png") == pytest.approx(0.3)


# A process that ends once it went on after two stalls.
IS_STALLED_TWICE = """
import signal, time
continued = []
signal.signal(signal.SIGCONT, lambda *_: continued.append(True))
while len(continued) < 2:
    time.sleep(0.01)
raise SystemExit(7)
"""
IN_A_CHILD = """
import subprocess, sys
sys.exit(subprocess.run([sys.executable, "-c", sys.argv[1]]).returncode)
"""


@pytest.mark.medium
@pytest.mark.skipif(sys.platform != "linux", reason="skipped: reads /proc, which is of Linux")
@pytest.mark.parametrize("words", [["-c", IS_STALLED_TWICE], ["-c", IN_A_CHILD, IS_STALLED_TWICE]])
def test_a_command_or_its_child_is_stalled_and_its_exit_status_is_reported(words: list[str]) -> None:
    status, stalls = run(1, [sys.executable, *words])
    assert status == 7 and stalls >= 2


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
