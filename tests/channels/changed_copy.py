"""A copy of the sources with another declaration: generated, compiled, and run next to the real one."""

import os
import shutil
import subprocess
import sys
import sysconfig
import tomllib
from collections.abc import Sequence
from pathlib import Path

from heli_lab.fit import _kalman
from heli_sim import _native
from heli_sim.evaluate import _expression_vm

ROOT = Path(__file__).resolve().parents[2]
CHANNEL = """\
[[channel]]
name = "{name}"
type = "{wire_type}"
unit = "{unit}"
scale = {scale}
meaning = "{meaning}"
"""
DECLARATION = "firmware/link.toml"
_SOURCES = ("firmware", "host", "sim")


class ChangedCopy:
    """The sources in a folder of their own."""

    def __init__(self, root: Path, source: Path = ROOT) -> None:
        self.root = root
        ignore = shutil.ignore_patterns("__pycache__", "*.so", "*.elf")
        for name in _SOURCES:
            shutil.copytree(source / name, root / name, ignore=ignore)
        shutil.copy(source / "CMakeLists.txt", root)
        scripts = tomllib.loads((source / "pyproject.toml").read_text(encoding="utf-8"))["project"]["scripts"]
        module, _, function = scripts["heli-host"].partition(":")
        self._command_line = ("-c", f"from {module} import {function}; {function}()")

    def replace(self, name: str, old: str, new: str) -> None:
        """Change the one place of a file where a text stands."""
        path = self.root / name
        text = path.read_text(encoding="utf-8")
        assert text.count(old) == 1, f"{name} has {text.count(old)} of {old!r}"
        path.write_text(text.replace(old, new), encoding="utf-8")

    def add_channel(self, entry: str, before: str = "") -> None:
        """Declare a channel: before another one, or behind all."""
        path = self.root / DECLARATION
        text = path.read_text(encoding="utf-8")
        mark = f'[[channel]]\nname = "{before}"\n' if before else "[[message]]"
        head, marker, tail = text.partition(mark)
        assert marker, f"there is no {mark}"
        path.write_text(head + entry + marker + tail, encoding="utf-8")

    def generate(self) -> None:
        """Write the copy's tables from its declaration."""
        self.run(str(self.root / "firmware" / "generate.py"))

    def build(self, optimised: str = "-O0", compiled: Sequence[str] = ("_native",)) -> None:
        """Compile some extensions, at the least cost, and copy the others, which need no declaration."""
        # Unoptimised, which computes the same, and each library in one piece: 10 s of CPU instead of 34, most
        # of which are headers that every file of the bindings' library reads again.
        build = self.root / "build"
        cmake = shutil.which("cmake") or str(Path(sys.executable).with_name("cmake"))
        configure = [cmake, "-S", str(self.root), "-B", str(build), f"-DPython_EXECUTABLE={sys.executable}"]
        configure += ["-DCMAKE_BUILD_TYPE=Debug", f"-DCMAKE_CXX_FLAGS_DEBUG={optimised}"]
        configure += ["-DCMAKE_UNITY_BUILD=ON", "-DCMAKE_UNITY_BUILD_BATCH_SIZE=0"]
        for command in (configure, [cmake, "--build", str(build), "--parallel", "2", "--target", *compiled]):
            process = subprocess.run(command, capture_output=True, text=True, check=False)
            assert process.returncode == 0, process.stdout[-4000:] + process.stderr[-4000:]
        for module in (_native, _kalman, _expression_vm):
            name = module.__name__.rpartition(".")[2]
            # Its declarations lie where Python looks for the extension.
            (declarations,) = (self.root / "sim").rglob(f"{name}.pyi")
            files = build.rglob(f"{name}*.so") if name in compiled else [Path(str(module.__file__))]
            (file,) = files
            shutil.copy(file, declarations.with_name(f"{name}{sysconfig.get_config_var('EXT_SUFFIX')}"))

    @property
    def extension(self) -> Path:
        """Where the copy's host looks for the native board."""
        return self.root / "sim" / "heli_sim" / f"_native{sysconfig.get_config_var('EXT_SUFFIX')}"

    def run(self, *command: str) -> str:
        """Run Python on the copy's packages: a script, or ``-c`` and a program; what it printed."""
        # The installed packages hook themselves in by a file of site-packages; without the module `site` that
        # is not read, and the copy is what is found.
        process = subprocess.run(
            [sys.executable, "-S", *command],
            cwd=self.root,
            env=self.environment(),
            capture_output=True,
            text=True,
            check=False,
        )
        assert process.returncode == 0, process.stdout + process.stderr
        return process.stdout

    def environment(self) -> dict[str, str]:
        """In which Python without `site` finds the copy's packages."""
        packages = dict.fromkeys((sysconfig.get_path("purelib"), sysconfig.get_path("platlib")))
        path = [self.root / "host", self.root / "sim", *packages, ROOT]
        return {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, path))}

    def heli_host(self, *arguments: str) -> str:
        """Run the command line of the copy; what it printed."""
        return self.run(*self._command_line, *arguments)

    def heli_host_command(self, *arguments: str) -> list[str]:
        """The same as a command to run in `environment`."""
        return [sys.executable, "-S", *self._command_line, *arguments]


def channel(
    name: str, wire_type: str, unit: str = "", scale: float = 1.0, meaning: str = "for a test"
) -> str:
    """The declaration of a telemetry channel."""
    return CHANNEL.format(name=name, wire_type=wire_type, unit=unit, scale=scale, meaning=meaning)
