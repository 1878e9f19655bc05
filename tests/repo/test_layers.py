"""The contracts of layers notice what breaks them, and the host knows its packages by entry points alone."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tomllib
from dataclasses import dataclass
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[2]
HOST, SIM = ROOT / "host" / "heli_host", ROOT / "sim" / "heli_sim"
LINT = """
import sys
from importlinter.cli import lint_imports
sys.exit(lint_imports(no_cache=True, no_logo=True))
"""


@dataclass(frozen=True)
class Wrong:
    """An import that a contract forbids: a line put at the end of a file, and what the report says of it."""

    file: str
    line: str
    report: str


WRONG = {
    "packages": Wrong(
        "host/heli_host/board/setpoints.py",
        "def _wrong() -> None:\n    import heli_lab.report.page",
        "heli_host.board.setpoints -> heli_lab.report.page",
    ),
    "the emulated Due": Wrong(
        "sim/due/due_emulator/gdb.py",
        "from heli_host import errors",
        "due_emulator.gdb -> heli_host.errors",
    ),
    "emulated Due: ": Wrong(
        "sim/due/due_emulator/image.py",
        "from due_emulator import machine",
        "due_emulator.image -> due_emulator.machine",
    ),
    "benchmark: commands": Wrong(
        "sim/heli_benchmark/engine/bodies.py",
        "from heli_benchmark.effects import listed",
        "heli_benchmark.engine.bodies -> heli_benchmark.effects.listed",
    ),
    "benchmark: what flies": Wrong(
        "sim/heli_benchmark/effects/disturbances.py",
        "from heli_sim.model import parts",
        "heli_benchmark.effects.disturbances -> heli_sim.model.parts",
    ),
    "benchmark: methods know": Wrong(
        "sim/heli_benchmark/methods/base_rates.py",
        "from heli_benchmark.cases import published",
        "heli_benchmark.methods.base_rates -> heli_benchmark.cases.published",
    ),
    "benchmark: only our own": Wrong(
        "sim/heli_benchmark/task/case.py",
        "from heli_lab import code_digest",
        "heli_benchmark.task.case -> heli_lab.code_digest",
    ),
    "host": Wrong(
        "host/heli_host/link/frames.py",
        "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from heli_host.fly import plan",
        "heli_host.link.frames -> heli_host.fly.plan",
    ),
    "command line": Wrong(
        "host/heli_host/ui/cli/options.py",
        "from heli_host.ui.cli import board",
        "heli_host.ui.cli.options -> heli_host.ui.cli.board",
    ),
    "simulation": Wrong(
        "sim/heli_sim/rig/compare.py",
        "from heli_sim import plant",
        "heli_sim.rig.compare -> heli_sim.plant",
    ),
    "laboratory": Wrong(
        "sim/heli_lab/fit/identify/free_run/interface.py",
        "from heli_lab.control.tune import loops",
        "heli_lab.fit.identify.free_run.interface -> heli_lab.control.tune.loops",
    ),
    "diagnosis: ": Wrong(
        "sim/heli_lab/explain/search/exchange.py",
        "from heli_lab.explain import evaluate",
        "heli_lab.explain.search.exchange -> heli_lab.explain.evaluate",
    ),
    "search of a diagnosis": Wrong(
        "sim/heli_lab/watch/twin/changes.py",
        "from heli_lab.explain.search import screening",
        "heli_lab.watch.twin.changes -> heli_lab.explain.search.screening",
    ),
    "evaluation of a diagnosis": Wrong(
        "sim/heli_lab/report/diagnosis/sentences.py",
        "from heli_lab.explain.evaluate import verdict",
        "heli_lab.report.diagnosis.sentences -> heli_lab.explain.evaluate.verdict",
    ),
    "discovery of a diagnosis": Wrong(
        "sim/heli_lab/report/diagnosis/sentences.py",
        "from heli_lab.explain.discover import terms",
        "heli_lab.report.diagnosis.sentences -> heli_lab.explain.discover.terms",
    ),
    "report of a diagnosis": Wrong(
        "sim/heli_lab/verbs/diagnose.py",
        "from heli_lab.report.diagnosis import page",
        "heli_lab.verbs.diagnose -> heli_lab.report.diagnosis.page",
    ),
    "the estimation core": Wrong(
        "sim/heli_lab/fit/estimation/arrowhead.py",
        "from heli_sim.model import parts",
        "heli_lab.fit.estimation.arrowhead -> heli_sim.model.parts",
    ),
    "verbs do not know": Wrong(
        "host/heli_host/ui/cli/verbs/plot.py",
        "from heli_host.ui.cli.verbs import info",
        "heli_host.ui.cli.verbs.plot -> heli_host.ui.cli.verbs.info",
    ),
    "a flight is studied": Wrong(
        "host/heli_host/data/log/clock.py",
        "from heli_host.link import session",
        "heli_host.data.log.clock -> heli_host.link.session",
    ),
    "the simulation knows no": Wrong(
        "sim/heli_sim/sil/clock.py",
        "from heli_host.data.log import table",
        "heli_sim.sil.clock -> heli_host.data.log.table",
    ),
    "only verbs and checks": Wrong(
        "sim/heli_lab/control/tune/shaping.py",
        "from heli_host.ui.cli import report",
        "heli_lab.control.tune.shaping -> heli_host.ui.cli.report",
    ),
    "identification knows": Wrong(
        "sim/heli_lab/fit/identify/estimation_problem/grid.py",
        "from heli_host.link import frames",
        "heli_lab.fit.identify.estimation_problem.grid -> heli_host.link.frames",
    ),
    "no circles": Wrong(
        "host/heli_host/fly/route.py",
        "from heli_host.fly import runner",
        "No cycles are allowed in heli_host.fly.",
    ),
}


def contracts() -> list[str]:
    table = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    return [contract["name"] for contract in table["tool"]["importlinter"]["contracts"]]


def copy_to(folder: Path) -> None:
    """Copy what the linter reads."""
    ignore = shutil.ignore_patterns("__pycache__", "*.so", "*.elf", "firmware")
    for package in (
        *(HOST, SIM, ROOT / "sim" / "heli_lab", ROOT / "sim" / "heli_benchmark"),
        ROOT / "sim" / "due" / "due_emulator",
    ):
        shutil.copytree(package, folder / package.relative_to(ROOT), ignore=ignore)
    shutil.copy(ROOT / "pyproject.toml", folder)


def lint(folder: Path) -> dict[str, str]:
    """Messages of the linter by the name of the broken contract.

    Without the module `site`, the file that hooks in the installed packages is not read, and the copy is what
    is found.
    """
    packages = dict.fromkeys((sysconfig.get_path("purelib"), sysconfig.get_path("platlib")))
    path = [folder / "host", folder / "sim", folder / "sim" / "due", *packages]
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


@pytest.fixture(scope="module")
def spoiled(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Messages of the linter about a copy with every wrong import, and a module in no layer."""
    pytest.importorskip("importlinter", reason="skipped: no import-linter, which make setup installs")
    folder = tmp_path_factory.mktemp("layers")
    copy_to(folder)
    for wrong in WRONG.values():
        with (folder / wrong.file).open("a", encoding="utf-8") as file:
            file.write(f"\n{wrong.line}\n")
    (folder / "host" / "heli_host" / "stray.py").write_text("")
    return lint(folder)


def test_every_contract_has_an_import_that_breaks_it() -> None:
    assert [name for name in contracts() if not any(name.startswith(start) for start in WRONG)] == []


def test_no_contract_has_an_exception() -> None:
    table = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]
    assert not [
        contract["name"]
        for contract in table["contracts"]
        if {"ignore_imports", "exhaustive_ignores", "skip_descendants", "depth"} & set(contract)
        or ("containers" in contract and not contract.get("exhaustive"))
    ]
    assert not table.get("exclude_type_checking_imports", False)


@pytest.mark.parametrize("start", WRONG)
def test_a_wrong_import_breaks_its_contract(start: str, spoiled: dict[str, str]) -> None:
    (name,) = (name for name in contracts() if name.startswith(start))
    assert WRONG[start].report in re.sub(r"\s+", " ", spoiled.get(name, "")), f"{name} did not notice"


def test_a_module_in_no_layer_is_noticed(spoiled: dict[str, str]) -> None:
    (name,) = (name for name in contracts() if name.startswith("host: "))
    assert "heli_host.stray" in spoiled[name]


def test_the_host_names_no_package_above_it() -> None:
    imports = [
        f"{path.relative_to(ROOT)}:{number}"
        for path in HOST.rglob("*.py")
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1)
        if re.search(r"heli_sim|heli_lab", line)
    ]
    assert not imports, "a package above the host comes in by an entry point"


@pytest.mark.parametrize(
    ("included", "layer"), [("board.hpp", "board"), ("sim_board.hpp", "native"), ("wiring.hpp", "wired Due")]
)
def test_the_emulator_s_sources_include_nothing_of_the_project(
    included: str, layer: str, tmp_path: Path
) -> None:
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    for name in ("firmware/core/board.hpp", "sim/native/sim_board.hpp", "sim/due_board/wiring.hpp"):
        (tmp_path / name).parent.mkdir(parents=True)
        (tmp_path / name).touch()
    (tmp_path / "sim" / "due" / "chip").mkdir(parents=True)
    (tmp_path / "sim" / "due" / "chip" / "uart.cpp").write_text(f'#include "{included}"\n')
    process = subprocess.run(
        [sys.executable, ROOT / ".ci" / "includes", tmp_path], capture_output=True, text=True, check=False
    )
    assert process.returncode == 1
    assert (
        f"sim/due/chip/uart.cpp: layer emulated Due may not include {included} of layer {layer}"
        in process.stdout
    )


def test_the_emulator_s_tests_import_nothing_of_the_project() -> None:
    sources = sorted((ROOT / "tests" / "due").rglob("*.py"))
    assert len(sources) > 20
    assert not [
        path.name for path in sources if re.search(r"^\s*(from|import) heli_", path.read_text(), re.M)
    ]
