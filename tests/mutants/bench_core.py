"""Mutants of ``firmware/core``, against the tests that run the flight code on this computer."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any, Final

from tests.mutants import session
from tests.mutants.generate import Mutant
from tests.mutants.native import Native
from tests.mutants.reach import Reach, Recorder, Watch, blocks_of, reach_of
from tests.mutants.tree import BUILD, BuildError, digest

ROOMS: Final = ("tests/control", "tests/flight", "tests/law", "tests/link", "tests/sil", "tests/fly")
"""Tests that run the flight code in their own process."""
SOURCES: Final = ("firmware/core", "sim/native", "tests/native", "CMakeLists.txt")
_COVERED: Final = ("-O0", "-gdwarf-4", "-w", "-fsanitize-coverage=trace-pc")
_MARKERS: Final = "not emulated and not documents and not diagnosis"


class CoreBench:
    """Builds mutants of the flight code and lets the native tests run on them.

    Parameters
    ----------
    work : Path
        A folder of this process.
    """

    def __init__(self, work: Path) -> None:
        self._native = Native(work)
        self._work = work

    def build(self, mutant: Mutant) -> Callable[[], None]:
        """Compile a mutant; what to call in a fork before its tests."""
        library = self._native.build(mutant)
        return lambda: session.load_extensions(library)

    def is_same_code(self, mutant: Mutant) -> bool:
        """Whether the compiler makes the same code of it."""
        return self._native.is_same_code(mutant)

    def reach(self) -> Reach:
        """Which test reaches which line, from an earlier run if sources and tests are those of then."""
        kept = BUILD / f"reach-core-{digest(*SOURCES, *ROOMS)}.json"
        if not kept.exists():
            library = self._covered()
            result = session.call_in_fork(lambda: _look(library))
            reach_of(result, blocks_of(library, self._native.tree.folder)).save(kept)
        return Reach.load(kept)

    def _covered(self) -> Path:
        """A build that notes every block that it enters."""
        recorder = self._work / "recorder.o"
        source = Path(__file__).with_name("recorder.cpp")
        done = subprocess.run(
            ["c++", "-O2", "-fPIC", "-c", source, "-o", recorder], capture_output=True, text=True, check=False
        )
        if done.returncode != 0:
            raise BuildError(done.stderr)
        objects = self._native.compile(self._native.recompiled(), "covered", _COVERED)
        return self._native.link(objects, recorder)


def _look(library: Path) -> dict[str, Any]:
    session.load_extensions(library)
    watch = Watch(Recorder(library).take)
    session.run_pytest(ROOMS, [watch], "--maxfail=100000", "-m", _MARKERS)
    return watch.result()
