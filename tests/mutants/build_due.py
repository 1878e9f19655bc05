"""Mutants of ``firmware/due``, against the tests that run the firmware on the emulated Due."""

import hashlib
import importlib
import re
import shlex
import shutil
import subprocess
from collections import defaultdict
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Any, Final

from tests.mutants import session
from tests.mutants.generate import BUILD, ROOT, BuildError, Mutant, Tree, digest
from tests.mutants.reach import Reach, Watch, reach_of, require_passed

FOLDER: Final = "firmware/due"
ROOMS: Final = ("tests/firmware",)
SOURCES: Final = ("firmware/core", "firmware/due", "sim/due")
_LEFT_OUT: Final = ("test_tools.py",)
"""Tests that build firmware of their own, or look at files and not at the firmware that is given to them."""
_LIMIT_s: Final = 60.0
_REAL_s: Final = 900.0
"""CPU time of one test, and real time of all, on the firmware without a mutant: they take 15 s together."""
_CROSS: Final = "arm-none-eabi-"
_STRIPPED: Final = "-Wl,--strip-debug"
_FUNCTION: Final = re.compile(r"^([0-9a-f]{8}) <(.+)>:$")
_PLACE: Final = re.compile(r"^(/\S+):(\d+)")


class DueBench:
    """Builds the Due's firmware with mutants and lets tests of the emulated board, in `files`, run on it."""

    # It takes over the objects of the firmware that the tests link.

    def __init__(self, work: Path, files: list[str]) -> None:
        built: Any = importlib.import_module("tests.firmware.built")
        objects = built.built_elf().parent
        work.mkdir(parents=True, exist_ok=True)
        self._work = work
        self._files = files
        self._tree = Tree(work / "tree")
        flags = (ROOT / FOLDER / "compile.flags").read_text(encoding="utf-8").split()
        self._flags = [flag for flag in flags if flag != "-g" and not flag.startswith("-W")] + ["-w"]
        self._sources = [source for source in self._tree.includes if source.endswith(".cpp")]
        self._original = {
            source: (objects / source.removeprefix("firmware/")).with_suffix(".o") for source in self._sources
        }
        self._code = self._link(self._original, "original.elf").read_bytes()

    def build(self, mutant: Mutant) -> Callable[[], None]:
        """Compile a mutant; what to call in a fork before its tests."""
        with self._tree.holding(mutant):
            objects = self._compile(self._tree.dependents(mutant.file))
            drivers = self._work / "drivers"
            shutil.rmtree(drivers, ignore_errors=True)
            shutil.copytree(self._tree.folder / FOLDER, drivers)
        elf = self._link(self._original | objects, "mutant.elf")
        return lambda: session.use_firmware(elf, drivers)

    def is_same_code(self, mutant: Mutant) -> bool:
        """Whether the linked program is the same; the mutant was built last."""
        return (self._work / "mutant.elf").read_bytes() == self._code

    def reach(self, _: Collection[str]) -> Reach:
        """Which test was seen to enter which function; these go first, and the others follow."""
        # A probe counts when its function returns. Fault handlers never do, a test that cuts the power or
        # calls a function itself may not let it, and tests of registers read the text of a header.
        part = hashlib.sha256("\0".join(self._files).encode()).hexdigest()[:8]
        kept = BUILD / f"reach-due-{digest(*SOURCES, *ROOMS)}-{part}.json"
        if not kept.exists():
            elf = self._link(self._original, "covered.elf", stripped=False)
            functions = _functions_of(elf)
            looked = session.call_in_fork(lambda: _look(elf, sorted(functions), self._files))
            require_passed(looked)
            seen = reach_of(looked, functions)
            every = frozenset(seen.costs_s)
            lines = {f: {line: tests or every for line, tests in of.items()} for f, of in seen.lines.items()}
            files = [name for name in self._tree.includes if name.startswith(FOLDER)]
            reach = Reach(seen.costs_s, lines, dict.fromkeys(files, every))
            self._check_original(reach)
            reach.save(kept)
        return Reach.load([kept])

    def _check_original(self, reach: Reach) -> None:
        """A test that fails without a mutant would kill them all."""
        elf = self._work / "original.elf"
        outcome = session.run_tests(
            lambda: session.use_firmware(elf), dict.fromkeys(reach.costs_s, _LIMIT_s), _REAL_s
        )
        if outcome.killed_by:
            raise BuildError(
                f"{outcome.killed_by} fails without a mutant ({outcome.reason}); make it pass first"
            )

    def _compile(self, sources: list[str]) -> dict[str, Path]:
        objects = {}
        folder = self._work / "mutant"
        folder.mkdir(exist_ok=True)
        include = [f"-I{self._tree.folder}/firmware/core", f"-I{self._tree.folder}/firmware/due"]
        for source in sources:
            objects[source] = folder / (source.replace("/", "+").removesuffix(".cpp") + ".o")
            output = ["-c", str(self._tree.path(source)), "-o", str(objects[source])]
            _run([f"{_CROSS}g++", *self._flags, *include, *output])
        return objects

    def _link(self, objects: dict[str, Path], name: str, stripped: bool = True) -> Path:
        elf = self._work / name
        flags = shlex.split((ROOT / FOLDER / "link.flags").read_text(encoding="utf-8"))
        if stripped:
            flags.append(_STRIPPED)
        script = f"-T{ROOT / FOLDER / 'due.ld'}"
        files = [str(objects[source]) for source in self._sources]
        _run([f"{_CROSS}gcc", *flags, script, *files, "-lm", "-o", str(elf)])
        return elf


def test_files() -> list[str]:
    """Files of the tests that run the firmware on the emulated Due."""
    paths = (path for room in ROOMS for path in sorted((ROOT / room).glob("test_*.py")))
    return [path.relative_to(ROOT).as_posix() for path in paths if path.name not in _LEFT_OUT]


def _functions_of(elf: Path) -> dict[int, set[tuple[str, int]]]:
    """By the address of each function of the drivers: files and lines of its code."""
    command = [f"{_CROSS}objdump", "-d", "-l", "--no-show-raw-insn", str(elf)]
    listing = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    lines_at: dict[int, set[tuple[str, int]]] = defaultdict(set)
    address = 0
    for row in listing.splitlines():
        if function := _FUNCTION.match(row):
            address = int(function[1], 16)
        elif (place := _PLACE.match(row)) and place[1].startswith(f"{ROOT}/{FOLDER}/"):
            lines_at[address].add((place[1].removeprefix(f"{ROOT}/"), int(place[2])))
    return dict(lines_at)


class _Probes:
    """Counts how often the functions of all emulated boards of a test are entered."""

    def __init__(self, addresses: list[int]) -> None:
        self._addresses = addresses
        self._boards: list[Any] = []

    def watch(self, board: Any) -> None:
        for address in self._addresses:
            board.add_probe(address)
        self._boards.append(board)

    def take(self) -> set[int]:
        boards, self._boards = self._boards, []
        return {address for board in boards for address in self._addresses if board.probe(address).count > 0}


def _look(elf: Path, addresses: list[int], files: list[str]) -> dict[str, Any]:
    machine: Any = importlib.import_module("due_emulator.machine")
    probes = _Probes(addresses)
    load = machine.load_image

    def load_and_watch(board: Any, image: Any) -> None:
        load(board, image)
        probes.watch(board)

    machine.load_image = load_and_watch
    session.use_firmware(elf)
    watch = Watch(probes.take, keeps_all=True)
    session.run_pytest(files, [watch], "--maxfail=100000")
    return watch.result()


def _run(command: list[str]) -> None:
    process = subprocess.run(command, capture_output=True, text=True, check=False)
    if process.returncode != 0:
        raise BuildError(process.stderr.strip() or process.stdout.strip())
