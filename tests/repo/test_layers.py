"""The contracts of layers hold and notice what breaks them: of packages, C++ folders, and tests."""

import ast
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
HOST, SIM = ROOT / "host" / "heli_host", ROOT / "sim" / "heli_sim"
LINT = """
import sys
from importlinter.cli import lint_imports
sys.exit(lint_imports(no_cache=True, no_logo=True))
"""


WRONG = {
    "host/heli_host/link/frames.py": (
        "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from heli_host.fly import plan",
        "heli_host.link.frames -> heli_host.fly.plan",
    ),
    "sim/due/due_emulator/gdb.py": ("from heli_host import errors", "due_emulator.gdb -> heli_host.errors"),
}
"""Imports that contracts forbid, also for types only: a line put at the end of a file, and its report."""
SIMULATION = ("sim/native", "sim/due", "sim/due_board")
FORBIDDEN_INCLUDES = {
    "firmware/core/params/store.cpp": "control/controller.hpp",
    "firmware/core/control/cascade.hpp": "law/simplex.hpp",
    "firmware/core/link/bytes.hpp": "params/params.hpp",
    "firmware/core/flight/limits.hpp": "law/guard.hpp",
    "firmware/core/core.hpp": "due_board.hpp",
    "firmware/due/motors.cpp": "control/mixer.hpp",
    "sim/native/world.cpp": "flight/supervisor.hpp",
    "sim/due/chip/uart.cpp": "board.hpp",
    "sim/due/chip/adc.cpp": "sim_board.hpp",
    "sim/due/bus/bus.cpp": "wiring.hpp",
}


def copy_to(folder: Path) -> None:
    """Copy what the linter reads."""
    ignore = shutil.ignore_patterns("__pycache__", "*.so", "*.elf", "firmware")
    for package in (
        *(HOST, SIM, ROOT / "sim" / "heli_lab", ROOT / "sim" / "heli_benchmark"),
        *(ROOT / "sim" / "due" / "due_emulator", ROOT / "sim" / "web" / "heli_web"),
    ):
        shutil.copytree(package, folder / package.relative_to(ROOT), ignore=ignore)
    shutil.copy(ROOT / "pyproject.toml", folder)


def lint(folder: Path) -> dict[str, str]:
    """Messages of the linter by the name of the broken contract."""
    # Without the module `site`, the file that hooks in the installed packages is not read, and the copy is
    # what is found.
    packages = dict.fromkeys((sysconfig.get_path("purelib"), sysconfig.get_path("platlib")))
    path = [folder / "host", folder / "sim", folder / "sim" / "due", folder / "sim" / "web", *packages]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(str, path)), "COLUMNS": "200"}
    process = subprocess.run(
        [sys.executable, "-S", "-c", LINT],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert "Contracts: " in process.stdout, process.stdout + process.stderr
    _, _, report = process.stdout.partition("Broken contracts\n")
    parts = re.split(r"^(.+)\n-{3,}$", report, flags=re.MULTILINE)
    reports = dict(zip(parts[1::2], parts[2::2], strict=True))
    assert bool(reports) == bool(process.returncode)
    return reports


@pytest.mark.slow
def test_no_contract_has_an_exception() -> None:
    table = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]
    assert not [
        contract["name"]
        for contract in table["contracts"]
        if {"ignore_imports", "exhaustive_ignores", "skip_descendants", "depth"} & set(contract)
        or ("containers" in contract and not contract.get("exhaustive"))
    ]
    assert not table.get("exclude_type_checking_imports", False)


@pytest.mark.slow
def test_wrong_imports_and_a_module_in_no_layer_are_noticed(tmp_path: Path) -> None:
    pytest.importorskip("importlinter", reason="skipped: no import-linter, which make setup installs")
    copy_to(tmp_path)
    for file, (line, _) in WRONG.items():
        with (tmp_path / file).open("a", encoding="utf-8") as source:
            source.write(f"\n{line}\n")
    (tmp_path / "host" / "heli_host" / "stray.py").write_text("")
    report = re.sub(r"\s+", " ", " ".join(lint(tmp_path).values()))
    for text in ("heli_host.stray", *(text for _, text in WRONG.values())):
        assert text in report


@pytest.mark.slow
def test_the_host_names_no_package_above_it() -> None:
    imports = [
        f"{path.relative_to(ROOT)}:{number}"
        for path in HOST.rglob("*.py")
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if re.search(r"heli_sim|heli_lab", line)
    ]
    assert not imports, "a package above the host comes in by an entry point"


@pytest.mark.slow
def test_the_emulator_s_tests_import_nothing_of_the_project() -> None:
    sources = sorted((ROOT / "sim" / "due" / "tests").rglob("*.py"))
    assert len(sources) > 10
    assert not [
        path.name for path in sources if re.search(r"^\s*(from|import) heli_", path.read_text(), re.M)
    ]


@pytest.fixture(scope="module")
def cpp_tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("includes")
    for folder in (
        "firmware/core",
        "firmware/due",
        "firmware/proofs",
        "sim/native",
        "sim/due",
        "sim/due_board",
    ):
        shutil.copytree(ROOT / folder, root / folder, ignore=shutil.ignore_patterns("*.so", "__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", root)
    return root


def includes_checked(root: Path) -> tuple[int, str]:
    command = [sys.executable, str(ROOT / ".ci" / "includes"), str(root)]
    process = subprocess.run(command, capture_output=True, text=True, check=False)
    return process.returncode, process.stdout + process.stderr


@pytest.mark.slow
def test_the_sources_keep_the_contract(cpp_tree: Path) -> None:
    code, output = includes_checked(cpp_tree)
    assert code == 0, output


@pytest.mark.slow
@pytest.mark.parametrize(("file", "included"), FORBIDDEN_INCLUDES.items())
def test_a_forbidden_include_fails(cpp_tree: Path, file: str, included: str) -> None:
    path = cpp_tree / file
    text = path.read_text(encoding="utf-8")
    path.write_text(f'#include "{included}"\n{text}', encoding="utf-8")
    try:
        code, output = includes_checked(cpp_tree)
    finally:
        path.write_text(text, encoding="utf-8")
    assert code == 1
    assert f"{file}: layer" in output
    assert included in output


@pytest.mark.slow
def test_a_file_without_a_layer_fails(cpp_tree: Path) -> None:
    text = (cpp_tree / "pyproject.toml").read_text(encoding="utf-8")
    (cpp_tree / "pyproject.toml").write_text(
        text.replace('"firmware/due/*"', '"firmware/due/m*"'), encoding="utf-8"
    )
    code, output = includes_checked(cpp_tree)
    (cpp_tree / "pyproject.toml").write_text(text, encoding="utf-8")
    assert code == 1
    assert "firmware/due/clock.cpp: no layer" in output


PACKAGES = ("host", "sim", "firmware", "docs")


def imported(path: Path) -> Iterator[str]:
    """Modules and names of ``tests`` that a file imports, in full."""
    source = path.read_text(encoding="utf-8")
    # To parse all files takes 2 s of CPU; most import nothing of `tests`.
    if not re.search(r"\b(from|import)\s+tests\b", source):
        return
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom) and node.module:
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)


def wrong_imports(root: Path) -> list[str]:
    """Imports of tests by measurements and helpers, and of anything in ``tests`` by packages."""
    mistakes = []
    for path in sorted((root / "tests").rglob("*.py")):
        name = path.relative_to(root).as_posix()
        if not path.name.startswith(("test_", "conftest")):
            mistakes += [
                f"{name} imports {full}"
                for full in imported(path)
                if full.startswith("tests.") and any(part.startswith("test_") for part in full.split("."))
            ]
    for package in PACKAGES:
        for path in sorted((root / package).rglob("*.py")):
            mistakes += [
                f"{path.relative_to(root).as_posix()} imports {full}"
                for full in imported(path)
                if full.split(".")[0] == "tests" and "tests" not in path.relative_to(root).parts
            ]
    return mistakes


@pytest.mark.medium
def test_no_measurement_imports_a_test_and_no_package_imports_from_tests() -> None:
    assert wrong_imports(ROOT) == []


def test_a_wrong_import_is_noticed(tmp_path: Path) -> None:
    for name, line in {
        "tests/bench/board.py": "from tests.link.test_core import frames",
        "tests/bench/test_parts.py": "from tests.link.test_core import frames",
        "tests/bench/page.py": "from tests.page.page_server import Served",
        "sim/heli_lab/link.py": "from tests import link",
        "sim/heli_lab/page.py": "import tests.page",
    }.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(f"{line}\n")
    assert wrong_imports(tmp_path) == [
        "tests/bench/board.py imports tests.link.test_core.frames",
        "sim/heli_lab/link.py imports tests.link",
        "sim/heli_lab/page.py imports tests.page",
    ]
