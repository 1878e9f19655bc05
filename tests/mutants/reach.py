"""Which tests reach which lines: each test runs once against a build that notes every block it enters."""

from __future__ import annotations

import ctypes
import json
import re
import subprocess
import time
from collections import defaultdict
from collections.abc import Callable, Generator, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

import numpy as np
import pytest

from tests.mutants.generate import ROOT, BuildError, Mutant, tokens_of

MAX_COST_S: Final = 3.0
"""CPU time above which a test is left out: such a test fits, or starts programs without the mutant."""
_MAX_NAMES: Final = 4


@dataclass
class Reach:
    """Lines that each test reaches."""

    costs_s: dict[str, float]  # CPU time of each test that passed, by name
    lines: dict[str, dict[int, frozenset[str]]]  # By file, by line: names of the tests that reach it
    # By file: names of the tests that may notice a mutant there although they were not seen to reach it
    others: dict[str, frozenset[str]] = field(default_factory=dict)
    _mentions: dict[str, list[tuple[str, int]]] = field(default_factory=dict)

    def tests_for(self, mutant: Mutant) -> list[str]:
        """Names of the tests that may notice a mutant; the quickest first, those of a file together."""
        reached = self._reached(mutant.file, range(mutant.line, mutant.last_line + 1), set())
        if reached is None:
            reached = frozenset().union(*self.lines.get(mutant.file, {}).values()) or frozenset(self.costs_s)
        return self.ordered(reached | self.others.get(mutant.file, frozenset()), first=reached)

    def ordered(self, names: Iterable[str], first: frozenset[str] = frozenset()) -> list[str]:
        """The quickest first; of those that cost alike, those in `first`; the tests of a file together."""

        def key(name: str) -> tuple[int, bool, str, float]:
            cost_s = self.costs_s[name]
            cost_class = sum(cost_s > limit_s for limit_s in (0.02, 0.1, 0.5))
            return cost_class, name not in first, name.partition("::")[0], cost_s

        return sorted(names, key=key)

    def _reached(self, file: str, lines: Iterable[int], seen: set[str]) -> frozenset[str] | None:
        """Tests that reach any of some lines; None if none of these has code and nothing uses them."""
        numbers = list(lines)
        known = self.lines.get(file, {})
        direct = [known[line] for line in numbers if line in known]
        if direct:
            return frozenset().union(*direct)
        # A constant has no code where it is declared: what uses its name reaches it.
        text = (ROOT / file).read_text(encoding="utf-8").splitlines()
        declared = {
            n for line in numbers for n in re.findall(r"\b(k[A-Z]\w*|\w+_)\b|\b(\w+)\(", text[line - 1])
        }
        names = {name for pair in declared for name in pair if name} - seen
        if not names or len(seen) > _MAX_NAMES:
            return None
        matches: list[frozenset[str]] = []
        for name in names:
            for other, line in self._mentioning(name):
                part = (
                    self._reached(other, [line], seen | names)
                    if (other, line) not in [(file, n) for n in numbers]
                    else None
                )
                if part is not None:
                    matches.append(part)
        return frozenset().union(*matches) if matches else None

    def _mentioning(self, name: str) -> list[tuple[str, int]]:
        if not self._mentions:
            for file in {
                *self.lines,
                *(p.relative_to(ROOT).as_posix() for p in (ROOT / "firmware").rglob("*.hpp")),
            }:
                text = (ROOT / file).read_text(encoding="utf-8")
                starts = np.cumsum([0, *(len(line) + 1 for line in text.split("\n"))])
                for token in tokens_of(text):
                    if token.kind == "name":
                        line = int(np.searchsorted(starts, token.start, side="right"))
                        self._mentions.setdefault(token.text, []).append((file, line))
        return self._mentions.get(name, [])

    def of_file(self, test_file: str) -> Reach:
        """The part of the tests of one file, with the lines that these reach."""
        mine = {name: cost_s for name, cost_s in self.costs_s.items() if name.partition("::")[0] == test_file}
        lines = {
            file: {line: kept for line, tests in of_file.items() if (kept := tests & mine.keys())}
            for file, of_file in self.lines.items()
        }
        return Reach(mine, lines)

    def save(self, path: Path) -> None:
        """Write it down."""
        place = {name: index for index, name in enumerate(self.costs_s)}
        lines = {
            file: {str(line): sorted(place[name] for name in tests) for line, tests in of_file.items()}
            for file, of_file in self.lines.items()
        }
        others = {file: sorted(tests) for file, tests in self.others.items()}
        written = {"costs_s": self.costs_s, "lines": lines, "others": others}
        path.write_text(json.dumps(written), encoding="utf-8")

    @classmethod
    def load(cls, paths: Iterable[Path]) -> Reach:
        """Read what `save` wrote, of several files of tests together."""
        costs_s: dict[str, float] = {}
        by_line: dict[str, dict[int, set[str]]] = defaultdict(lambda: defaultdict(set))
        others: dict[str, frozenset[str]] = {}
        for path in paths:
            written = json.loads(path.read_text(encoding="utf-8"))
            names = list(written["costs_s"])
            costs_s |= written["costs_s"]
            others |= {file: frozenset(tests) for file, tests in written["others"].items()}
            for file, of_file in written["lines"].items():
                for line, indices in of_file.items():
                    by_line[file][int(line)].update(names[index] for index in indices)
        frozen = {file: {line: frozenset(t) for line, t in lines.items()} for file, lines in by_line.items()}
        return cls(costs_s, frozen, others)


class Watch:
    """A plugin that notes what each test enters, and what it costs."""

    def __init__(self, take: Callable[[], set[int]], *, keeps_all: bool = False) -> None:
        # `take` returns the blocks that were entered since its last call.
        self._take, self._keeps_all = take, keeps_all
        self.entered: dict[str, set[int]] = defaultdict(set)
        self.costs_s: dict[str, float] = {}
        # Blocks and costs of fixtures that several tests share, by name and by where they are declared.
        self._shared: dict[tuple[str, str], set[int]] = {}
        self._shared_s: dict[tuple[str, str], float] = defaultdict(float)
        self._not_passed: set[str] = set()
        self._failed: dict[str, str] = {}
        self._ran: list[pytest.Item] = []
        # Blocks entered by the test around each shared fixture that is being set up.
        self._outer: list[set[int]] = []
        self._start_s = self._set_up_s = 0.0
        # Blocks that the present test has entered, as far as they were taken already.
        self._pending: set[int] = set()

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: pytest.FixtureDef[Any]) -> Generator[None, Any, Any]:
        if fixturedef.scope == "function":
            return (yield)
        # Shared by tests, whichever of them it is made for: a mutant may meet any of them first.
        self._outer.append(self._take())
        start_s, earlier_s = time.process_time(), self._set_up_s
        try:
            return (yield)
        finally:
            inner, key = self._take(), (fixturedef.argname, fixturedef.baseid)
            self._shared.setdefault(key, set()).update(inner)
            self._pending |= self._outer.pop() | inner
            spent_s = time.process_time() - start_s
            self._shared_s[key] = max(self._shared_s[key], spent_s - (self._set_up_s - earlier_s))
            self._set_up_s = earlier_s + spent_s

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> Generator[None, Any, Any]:
        # Collected tests that a marker leaves out never get here, and share fixtures with those that do.
        self._ran.append(item)
        self._take()
        self._pending = set()
        self._start_s, self._set_up_s = time.process_time(), 0.0
        try:
            return (yield)
        finally:
            self.costs_s[item.nodeid] = time.process_time() - self._start_s - self._set_up_s
            self.entered[item.nodeid] |= self._take() | self._pending

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if not report.passed:
            self._not_passed.add(report.nodeid)
        self._note_failure(report)

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        # A file that cannot be imported ends the run before the first test: no line would be reached.
        self._note_failure(report)

    def _note_failure(self, report: pytest.TestReport | pytest.CollectReport) -> None:
        if report.failed:
            crash = getattr(report.longrepr, "reprcrash", None)
            text = str(crash.message if crash is not None else report.longrepr).strip()
            self._failed.setdefault(report.nodeid, text.splitlines()[0 if crash is not None else -1])

    def result(self) -> dict[str, Any]:
        """Costs and entered functions of the tests that passed and are not too expensive."""
        for item in self._ran:
            for (name, base), entered in self._shared.items():
                if name in getattr(item, "fixturenames", ()) and item.nodeid.startswith(base):
                    self.entered[item.nodeid] |= entered
                    self.costs_s[item.nodeid] += self._shared_s[name, base]
        costs_s = {
            name: round(cost_s, 4)
            for name, cost_s in self.costs_s.items()
            if name not in self._not_passed
            and cost_s <= MAX_COST_S
            and (self.entered[name] or self._keeps_all)
        }
        return {
            "costs_s": costs_s,
            "entered": {name: sorted(self.entered[name]) for name in costs_s},
            "failed": self._failed,
        }


def require_passed(result: dict[str, Any]) -> None:
    """Refuse a run in which a test failed without a mutant: mutants that only it notices would survive."""
    failed = [f"{name} ({reason})" for name, reason in result["failed"].items()]
    if failed:
        more = f", and {len(failed) - 3} more" if len(failed) > 3 else ""
        raise BuildError(
            f"tests failed without a mutant: {', '.join(failed[:3])}{more}; make them pass first"
        )


def reach_of(result: dict[str, Any], lines_of_block: dict[int, set[tuple[str, int]]]) -> Reach:
    """From what each test entered and which lines each block has, which tests reach each line."""
    by_line: dict[str, dict[int, set[str]]] = defaultdict(lambda: defaultdict(set))
    for lines in lines_of_block.values():
        for file, line in lines:
            by_line[file][line] |= set()
    for name, entered in result["entered"].items():
        for block in entered:
            for file, line in lines_of_block.get(block, ()):
                by_line[file][line].add(name)
    frozen = {file: {line: frozenset(t) for line, t in lines.items()} for file, lines in by_line.items()}
    return Reach(result["costs_s"], frozen)


def blocks_of(library: Path, folder: Path) -> dict[int, set[tuple[str, int]]]:
    """By the address that the hook of each block returns to: files and lines of the block."""
    listing = subprocess.run(
        ["objdump", "-d", "-l", "--no-show-raw-insn", str(library)],
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    lines_at: dict[int, set[tuple[str, int]]] = {}
    place: tuple[str, int] | None = None
    current: set[tuple[str, int]] = set()
    after_hook = False
    prefix = f"{folder}/"
    for row in listing.splitlines():
        if match := re.match(r"(/\S+):(\d+)", row):
            path = str(Path(match[1]))
            inside = path.startswith(prefix) and "/firmware/" in path
            place = (path.removeprefix(prefix), int(match[2])) if inside else None
            continue
        instruction = re.match(r"\s*([0-9a-f]+):\s+(.*)", row)
        if instruction is None:
            if row.endswith(">:"):
                current, place = set(), None
            continue
        if after_hook:
            current = lines_at.setdefault(int(instruction[1], 16), set())
            after_hook = False
        if "<__sanitizer_cov_trace_pc" in instruction[2] and "call" in instruction[2]:
            after_hook = True
        if place is not None:
            current.add(place)
    return lines_at


class Recorder:
    """The table that the hook of blocks writes, in a loaded library."""

    def __init__(self, library: Path) -> None:
        self._library = ctypes.CDLL(str(library))
        self._library.heli_reached.restype = ctypes.POINTER(ctypes.c_uint8)
        size = 1 << 24
        self._table = np.ctypeslib.as_array(self._library.heli_reached(), shape=(size,))
        self._end = library.stat().st_size

    def take(self) -> set[int]:
        """Return addresses of the blocks that were entered since the last call."""
        part = self._table[: self._end]
        entered = {int(address) for address in np.flatnonzero(part)}
        part[:] = 0
        return entered
