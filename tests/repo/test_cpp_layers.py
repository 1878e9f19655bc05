"""The contract of the C++ layers notices a forbidden include."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FORBIDDEN = {
    "firmware/core/params/store.cpp": "control/controller.hpp",
    "firmware/core/control/cascade.hpp": "law/simplex.hpp",
    "firmware/core/link/bytes.hpp": "params/params.hpp",
    "firmware/core/flight/limits.hpp": "law/guard.hpp",
    "firmware/core/law/tape.hpp": "control/controller.hpp",
    "firmware/core/core.hpp": "due_board.hpp",
    "firmware/due/motors.cpp": "control/mixer.hpp",
    "sim/native/world.cpp": "flight/supervisor.hpp",
}


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("layers")
    for folder in ("firmware/core", "firmware/due", "firmware/proofs", "sim/native"):
        shutil.copytree(ROOT / folder, root / folder)
    shutil.copy(ROOT / "pyproject.toml", root)
    return root


def checked(root: Path) -> tuple[int, str]:
    command = [sys.executable, str(ROOT / ".ci" / "includes"), str(root)]
    process = subprocess.run(command, capture_output=True, text=True, check=False)
    return process.returncode, process.stdout + process.stderr


def test_the_sources_keep_the_contract(tree: Path) -> None:
    code, output = checked(tree)
    assert code == 0, output


@pytest.mark.parametrize(("file", "included"), FORBIDDEN.items())
def test_a_forbidden_include_fails(tree: Path, file: str, included: str) -> None:
    path = tree / file
    text = path.read_text(encoding="utf-8")
    path.write_text(f'#include "{included}"\n{text}', encoding="utf-8")
    try:
        code, output = checked(tree)
    finally:
        path.write_text(text, encoding="utf-8")
    assert code == 1
    assert f"{file}: layer" in output
    assert included in output


def test_a_file_without_a_layer_fails(tree: Path) -> None:
    text = (tree / "pyproject.toml").read_text(encoding="utf-8")
    (tree / "pyproject.toml").write_text(
        text.replace('"firmware/due/*"', '"firmware/due/m*"'), encoding="utf-8"
    )
    code, output = checked(tree)
    (tree / "pyproject.toml").write_text(text, encoding="utf-8")
    assert code == 1
    assert "firmware/due/clock.cpp: no layer" in output
