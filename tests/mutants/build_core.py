"""Mutants of ``firmware/core``, against the tests that run the flight code on this computer."""

import fcntl
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from collections.abc import Callable, Collection
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from pathlib import Path
from typing import Any, Final

from tests.mutants import session
from tests.mutants.generate import BUILD, ROOT, BuildError, Mutant, Tree, digest
from tests.mutants.reach import Reach, Recorder, Watch, blocks_of, reach_of, require_passed

_BINDINGS: Final = ("sim/native/bind_", "tests/native/")
_LIBRARIES: Final = ("libheli_world.a", "libheli_core.a", "libnanobind-static.a")
_ROOMS: Final = ("firmware/core", "sim/native", "tests/native")
_QUICK: Final = ("-O0", "-w")
OPTIMISED: Final = ("-O2", "-w")
_SIZE: Final = re.compile(r"constexpr (?:std::)?u?(?:int|size_t|int\d+_t)\b[^=]*=|\w\[[^\]]*\d")
"""A declaration of a whole number, or of an array whose bound is computed."""


class Native:
    """Builds one shared object with both extensions in it: ``heli_sim._native`` and ``heli_test_native``."""

    def __init__(self, work: Path) -> None:
        self._work = work
        work.mkdir(parents=True, exist_ok=True)
        self._base = _built_base()
        self.tree = Tree(work / "tree", ("sim/native", "tests/native"))

    def build(self, mutant: Mutant, flags: tuple[str, ...] = _QUICK) -> Path:
        """The shared object with a mutant; a BuildError if it does not compile."""
        # The bindings call functions of headers as others compile them, because nothing is inlined there. A
        # named whole number may be the length of an array, of which all objects must have the same opinion.
        # To compile the bindings takes 40 s of CPU, everything else 1 to 10 s.
        alike = mutant.kind == "constant" and _SIZE.search(mutant.source_line) is not None
        sources = [source for source in self.tree.dependents(mutant.file) if source in self._commands]
        with self.tree.holding(mutant):
            replaced = [s for s in sources if alike or not s.startswith(_BINDINGS)]
            return self.link(self.compile(replaced, "mutant", flags), inlined=mutant.file.endswith(".cpp"))

    def is_same_code(self, mutant: Mutant) -> bool:
        """Whether the compiler makes the same code of the mutant, so that no test can see a difference."""
        dependents = [s for s in self.tree.dependents(mutant.file) if s.startswith("firmware/core/")]
        before = self.compile(dependents, "original", OPTIMISED)
        with self.tree.holding(mutant):
            after = self.compile(dependents, "mutant", OPTIMISED)
        return all(before[source].read_bytes() == after[source].read_bytes() for source in dependents)

    def compile(self, sources: list[str], name: str, flags: tuple[str, ...]) -> dict[str, Path]:
        """Objects of sources, by source."""
        objects = {
            source: self._work / name / (source.replace("/", "+").removesuffix(".cpp") + ".o")
            for source in sources
        }
        (self._work / name).mkdir(exist_ok=True)
        with ThreadPoolExecutor(1 if len(sources) < 3 else 2) as pool:
            list(pool.map(lambda source: self._compile(source, objects[source], flags), sources))
        return objects

    def link(self, objects: dict[str, Path], *more: Path, inlined: bool = False) -> Path:
        """Link objects with the rest, which gives what they do not; functions in it are `inlined` or not."""
        out = self._work / "both.so"
        bindings = self._base_bindings if inlined else self._bindings
        kept = [str(path) for source, path in bindings.items() if source not in objects]
        libraries = [str(self._base / name) for name in _LIBRARIES]
        _run(
            [*_compiler(), "-shared", "-Wl,--gc-sections", "-o", str(out)]
            + [str(path) for path in (*objects.values(), *more)]
            + [*kept, *libraries, "-ldl"]
        )
        return out

    def _compile(self, source: str, to: Path, flags: tuple[str, ...]) -> None:
        command = list(self._commands[source])
        command[command.index("-c") + 1] = str(self.tree.path(source))
        command[command.index("-o") + 1] = str(to)
        kept = [
            word
            for word in command
            if word not in ("-Werror", "-Wall", "-Wextra", "-Wconversion", "-O2", "-O3")
        ]
        copied = str(self.tree.folder / "firmware/core")
        kept = [
            word.replace(str(ROOT / "firmware/core"), copied) if word.startswith("-I") else word
            for word in kept
        ]
        if "tests/native" in source:
            kept += ["-I", str(ROOT / "tests/native")]
        _run([*_launcher(), *kept, *flags], cwd=self._base)

    @cached_property
    def _commands(self) -> dict[str, list[str]]:
        entries = json.loads((self._base / "compile_commands.json").read_text(encoding="utf-8"))
        paths = {Path(entry["file"]): shlex.split(entry["command"]) for entry in entries}
        return {
            path.relative_to(ROOT).as_posix(): [word for word in words if not word.endswith("ccache")]
            for path, words in paths.items()
            if path.is_relative_to(ROOT)
            and (path.is_relative_to(ROOT / "firmware") or "native" in path.parts)
        }

    @cached_property
    def _bindings(self) -> dict[str, Path]:
        """Objects of the bindings, with nothing inlined."""
        return self.compile(
            [source for source in self._commands if source.startswith(_BINDINGS)], "kept", _QUICK
        )

    @cached_property
    def _base_bindings(self) -> dict[str, Path]:
        """Objects of the bindings as CMake made them."""
        objects = {}
        for source, command in self._commands.items():
            if source.startswith(_BINDINGS):
                place = Path(command[command.index("-o") + 1])
                objects[source] = next(
                    p for p in (self._base / place, self._base / "tests/native" / place) if p.exists()
                )
        return objects

    def recompiled(self) -> list[str]:
        """Every source of the core, for builds that look into all of it."""
        return [source for source in self._commands if source.startswith("firmware/core/")]


def _built_base() -> Path:
    """CMake's build of the sources as they are: that of the installation, or else one of our own."""
    newest = max(path.stat().st_mtime for room in _ROOMS for path in (ROOT / room).rglob("*.[ch]pp"))
    for installed in sorted((ROOT / "build").glob("cp*")):
        libraries = [installed / name for name in _LIBRARIES]
        complete = all(path.exists() for path in (*libraries, installed / "compile_commands.json"))
        if complete and libraries[1].stat().st_mtime > newest and list(installed.glob("tests/native/**/*.o")):
            return installed
    base = BUILD / "native"
    base.mkdir(parents=True, exist_ok=True)
    with (BUILD / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        launcher = [f"-DCMAKE_CXX_COMPILER_LAUNCHER={word}" for word in _launcher()]
        cmake = _tool("cmake")
        _run([cmake, "-S", str(ROOT), "-B", str(base), f"-DPython_EXECUTABLE={sys.executable}", *launcher])
        _run([cmake, "--build", str(base), "--parallel", "2", "--target", "_native", "heli_test_native"])
    return base


def _tool(name: str) -> str:
    beside = Path(sys.executable).with_name(name)
    return str(beside) if beside.exists() else shutil.which(name) or name


def _launcher() -> list[str]:
    ccache = shutil.which("ccache")
    return [ccache] if ccache else []


def _compiler() -> list[str]:
    return shlex.split(os.environ.get("CXX", "c++"))


def _run(command: list[str], cwd: Path = ROOT) -> None:
    process = subprocess.run(command, cwd=cwd, capture_output=True, text=True, check=False)
    if process.returncode != 0:
        raise BuildError(process.stderr.strip() or process.stdout.strip())


FOLDER: Final = "firmware/core"
ROOMS: Final = ("tests/control", "tests/flight", "tests/law", "tests/link", "tests/sil")
"""Tests that run the flight code in their own process."""
SOURCES: Final = ("firmware/core", "sim/native", "tests/native", "CMakeLists.txt")
_COVERED: Final = ("-O0", "-gdwarf-4", "-w", "-fsanitize-coverage=trace-pc")
_MARKERS: Final = "not slow and not emulated and not documents and not diagnosis"


class CoreBench:
    """Builds mutants of the flight code and lets the native tests run on them."""

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
        """Which test reaches which line; only files of tests that have changed run again."""
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
