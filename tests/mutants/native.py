"""The flight code and its bindings for this computer, linked with some objects replaced."""

from __future__ import annotations

import fcntl
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from pathlib import Path
from typing import Final

from tests.mutants.generate import ROOT, Mutant
from tests.mutants.tree import BUILD, BuildError, Tree

_BINDINGS: Final = ("sim/native/bind_", "sim/native/module", "tests/native/")
_LIBRARIES: Final = ("libheli_world.a", "libheli_core.a", "libnanobind-static.a")
_ROOMS: Final = ("firmware/core", "sim/native", "tests/native")
_QUICK: Final = ("-O0", "-w")
OPTIMISED: Final = ("-O2", "-w")
_SIZE: Final = re.compile(r"constexpr (?:std::)?u?(?:int|size_t|int\d+_t)\b[^=]*=|\w\[[^\]]*\d")
"""A declaration of a whole number, or of an array whose bound is computed."""


class Native:
    """Builds one shared object that has both extensions in it: ``heli_sim._native`` and ``heli_test_native``.

    Parameters
    ----------
    work : Path
        A folder of this process.
    """

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
