"""A stranger's law file is run behind a fence: it costs its own result, and nothing else."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any, Final

import pytest
from heli_host.errors import BadLaw
from heli_lab.control.fence import FileLimits
from heli_lab.control.law_files import load_law, load_limited
from heli_lab.control.program_json import law_of_program, program_json, program_of_json
from heli_lab.law import Command, control_law

from tests.law.flown import law_of

pytestmark = pytest.mark.medium

LAWS: Final = Path(__file__).resolve().parents[2] / "docs" / "laws"
LAW: Final = (
    "from heli_lab.law import *\n@control_law()\ndef law(now, state, parameter):\n"
    "    return Command(1.0, 1.0 + now.pitch_rad)\nLAW = law\n"
)
HOSTILE: Final = {
    "an endless loop": ("while True: pass\n", "did not end within 0.2 s of processor time"),
    "1 GB": ("data = bytearray(1 << 30)\n", "use less than 1024 MB"),
    "a file": ("open('written.txt', 'w')\n", "may not write a file"),
    "a socket": ("import socket\nsocket.socket()\n", "may not open a socket"),
    "an end without an answer": ("import os\nos._exit(0)\n", "ended Python (exit status 0)"),
    "an answer of its own": (
        'import os\nfor pipe in range(3, 60):\n    try: os.write(pipe, b\'{"program": "[]"}\')\n'
        "    except OSError: pass\nos._exit(0)\n",
        "did not return a program",
    ),
    "pickled code for an answer": (
        "import os\nfor pipe in range(3, 60):\n"
        "    try: os.write(pipe, b'cos\\nsystem\\n(S\"touch written.txt\"\\ntR.')\n"
        "    except OSError: pass\nos._exit(0)\n",
        "did not return a law",
    ),
}
PYTHON: Final = (
    "import os, socket, subprocess\n"
    "for wish in (lambda: os.remove('kept.txt'), lambda: os.rename('kept.txt', 'written.txt'), os.fork,\n"
    "        lambda: os.kill(os.getppid(), 9), lambda: os.mkdir('written.txt'), socket.socket,\n"
    "        lambda: subprocess.run(['true']), lambda: os.open('kept.txt', os.O_RDWR)):\n"
    "    try: wish()\n"
    "    except PermissionError as error: assert 'may not' in str(error)\n"
    "    else: raise AssertionError(wish)\n"
)
RAW: Final = (
    "import ctypes, os\nlibc = ctypes.CDLL(None, use_errno=True)\n"
    "pipe = os.open('kept.txt', os.O_RDONLY)\n"
    "for name, arguments in (('socket', (2, 1, 0)), ('fork', ()), ('creat', (b'written.txt', 0o644)),\n"
    "        ('open', (b'kept.txt', 1)), ('unlink', (b'kept.txt',)), ('kill', (os.getppid(), 0)),\n"
    "        ('setsid', ()), ('rename', (b'kept.txt', b'written.txt'))):\n"
    "    assert getattr(libc, name)(*arguments) == -1, name\n"
    "    assert ctypes.get_errno() == 1, (name, ctypes.get_errno())\n"
)


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_file_is_one_line_with_its_reason(name: str, tmp_path: Path) -> None:
    text, reason = HOSTILE[name]
    (tmp_path / "kept.txt").write_text("kept")
    (tmp_path / "law.py").write_text(text)
    with pytest.raises(BadLaw) as refused:
        load_limited(tmp_path / "law.py", FileLimits(0.2))
    assert reason in str(refused.value)
    assert refused.value.remedy
    assert sorted(path.name for path in tmp_path.iterdir()) == ["kept.txt", "law.py"]


@pytest.mark.skipif(os.uname().sysname != "Linux", reason="the filter of system calls is of Linux")
def test_neither_python_nor_the_c_library_leads_around_the_fence(tmp_path: Path) -> None:
    (tmp_path / "kept.txt").write_text("kept")
    (tmp_path / "law.py").write_text(PYTHON + RAW + LAW)
    assert load_limited(tmp_path / "law.py", FileLimits(10.0)).name == "law"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["kept.txt", "law.py"]
    assert (tmp_path / "kept.txt").read_text() == "kept"


def test_a_module_in_the_present_folder_replaces_none_of_the_reader(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "casadi.py").write_text("raise SystemExit(7)\n")
    (tmp_path / "student").mkdir()
    (tmp_path / "student" / "law.py").write_text(LAW)
    monkeypatch.chdir(tmp_path)
    # As a program does that puts the folder in which it was started on its own path.
    monkeypatch.setattr(sys, "path", ["", ".", *sys.path])
    assert load_limited(Path("student/law.py"), FileLimits(10.0)).name == "law"
    assert load_law(Path("student/law.py")).name == "law"


def test_a_program_as_data_is_the_same_law() -> None:
    law = law_of(LAWS / "lqi.py")
    program = law.program
    read = program_of_json(program_json(program))
    assert read.words == program.words
    inputs = [0.01 * place for place in range(17)]
    ours = law_of_program(read).runner()(inputs)
    assert ours == pytest.approx(law.runner()(inputs), abs=1e-6)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"divisor": 1', '"divisor": 300'),
        ('"divisor": 1', '"divisor": true'),
        ('"outputs": [', '"outputs": [600, '),
        ('"outputs": [', '"outputs": [0, '),
        ('"constants": [', '"constants": [NaN, '),
        ('"constants": [', '"constants": [1e39, '),
        ('"instructions": [', '"instructions": [[99, 0, 0, 0, []], '),
        ('"instructions": [', '"instructions": [[1, 400, 401, 0, []], '),
        ('"instructions": [', '"instructions": [[1, 20, 0, 0, [[0, 0, 0]]], '),
        ("{", "[" * 100_000 + "{"),
    ],
)
def test_a_forged_program_is_refused(old: str, new: str) -> None:
    @control_law(states={"x": 0.0})
    def law(now: Any, state: Any, parameter: Any) -> Command:
        return Command(now.pitch_rad + state.x, 1.5 * now.pitch_rad)

    text = program_json(law.program)
    assert old in text
    with pytest.raises(BadLaw):
        program_of_json(text.replace(old, new, 1))
