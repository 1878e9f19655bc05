"""Mutants of ``firmware/core``, against the tests that run the flight code on this computer."""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any, Final

from tests.mutants import session
from tests.mutants.generate import ROOT, Mutant
from tests.mutants.native import Native
from tests.mutants.reach import Reach, Recorder, Watch, blocks_of, reach_of, require_passed
from tests.mutants.tree import BUILD, BuildError, digest

FOLDER: Final = "firmware/core"
ROOMS: Final = ("tests/control", "tests/flight", "tests/law", "tests/link", "tests/sil")
"""Tests that run the flight code in their own process."""
SOURCES: Final = ("firmware/core", "sim/native", "tests/native", "CMakeLists.txt")
_COVERED: Final = ("-O0", "-gdwarf-4", "-w", "-fsanitize-coverage=trace-pc")
_MARKERS: Final = "not slow and not emulated and not documents and not diagnosis"


class CoreBench:
    """Builds mutants of the flight code and lets the native tests run on them.

    Parameters
    ----------
    work : Path
        A folder of this process.
    files : list of str
        Files of the tests that run.
    """

    def __init__(self, work: Path, files: list[str]) -> None:
        self._native = Native(work)
        self._work = work
        self._files = files

    def build(self, mutant: Mutant) -> Callable[[], None]:
        """Compile a mutant; what to call in a fork before its tests."""
        library = self._native.build(mutant)
        return lambda: session.load_extensions(library)

    def is_same_code(self, mutant: Mutant) -> bool:
        """Whether the compiler makes the same code of it."""
        return self._native.is_same_code(mutant)

    def reach(self, files: Collection[str]) -> Reach:
        """Which test reaches which line; only files of tests that have changed run again.

        Parameters
        ----------
        files : collection of str
            Files with mutants. Only if one of them is a header, the bindings are compiled again, which costs
            13 s of CPU: they contain what headers define.
        """
        with_headers = not all(file.endswith(".cpp") for file in files)
        folder = BUILD / f"reach-core-{digest(*SOURCES)}{'' if with_headers else '-cpp'}"
        kept = {
            file: folder / f"{file.replace('/', '+')}-{_digest_of_tests(file)}.json" for file in self._files
        }
        stale = [file for file, path in kept.items() if not path.exists()]
        code = folder / "code.json"
        if stale or not code.exists():
            folder.mkdir(parents=True, exist_ok=True)
            library = self._covered(with_headers)
            looked = session.call_in_fork(lambda: _look(library, stale))
            require_passed(looked)
            reach = reach_of(looked, blocks_of(library, self._native.tree.folder))
            for file in stale:
                reach.of_file(file).save(kept[file])
            Reach({}, {f: dict.fromkeys(lines, frozenset()) for f, lines in reach.lines.items()}).save(code)
        return Reach.load([code, *kept.values()])

    def _covered(self, with_headers: bool) -> Path:
        """A build that notes every block that it enters; those of headers only if that is wanted."""
        recorder = self._work / "recorder.o"
        source = Path(__file__).with_name("recorder.cpp")
        process = subprocess.run(
            ["c++", "-O2", "-fPIC", "-c", source, "-o", recorder], capture_output=True, text=True, check=False
        )
        if process.returncode != 0:
            raise BuildError(process.stderr)
        objects = self._native.compile(self._native.recompiled(), "covered", _COVERED)
        return self._native.link(objects, recorder, inlined=not with_headers)


def test_files() -> list[str]:
    """Files of the tests that run the flight code in their own process."""
    paths = (path for room in ROOMS for path in sorted((ROOT / room).glob("test_*.py")))
    return [path.relative_to(ROOT).as_posix() for path in paths]


def _digest_of_tests(file: str) -> str:
    """Digest of a file of tests and of the helpers in its folder."""
    helpers = (path for path in (ROOT / file).parent.glob("*.py") if not path.name.startswith("test_"))
    return digest(file, *(path.relative_to(ROOT).as_posix() for path in sorted(helpers)))


def _look(library: Path, files: list[str]) -> dict[str, Any]:
    session.load_extensions(library)
    watch = Watch(Recorder(library).take)
    session.run_pytest(files, [watch], "--maxfail=100000", "-m", _MARKERS)
    return watch.result()
