"""A law's file: each mistake is one line with its remedy, a stranger's file is fenced, and it gets a rig."""

import os
import sys
import time
from pathlib import Path
from typing import Any, Final

import heli_host
import pytest
from heli_host.board.law_program import read_law
from heli_host.errors import BadLaw
from heli_lab.control import law_files
from heli_lab.control.fence import FileLimits
from heli_lab.control.law_files import RIG_VARIABLE, load_law, load_limited, run_law
from heli_lab.control.program_json import law_of_program, program_json, program_of_json
from heli_lab.law import Command, control_law, law_rig
from heli_sim.rig import load_rig, write_rig

from tests.cli.terminal import Terminal, refusal
from tests.law.flown import LAWS, law_of
from tests.running.long import samples

# ruff: noqa: E501  -- a row each

pytestmark = pytest.mark.medium

ASKED, FILE = 2, 5
START: Final = "from heli_lab.law import *\nimport math, casadi\n"


def law(body: str, options: str = "", end: str = "LAW = law") -> str:
    """A file whose law does what `body` says; the body begins in line 5."""
    lines = "".join(f"    {line}\n" for line in body.split("\n"))
    return f"{START}@control_law({options})\ndef law(now, state, parameter):\n{lines}{end}\n"


BAD: Final[dict[str, tuple[str | bytes, str, str]]] = {
    "an empty file": ("", "does not define LAW", "@control_law"),
    "a law by another name": (law("return Command(1.0, 1.0)", end=""), "does not define LAW", "LAW = law"),
    "a function for a LAW": ("def law(now):\n    pass\nLAW = law\n", "has the type function", "@control_law"),
    "no Python": ("LAW = (1,\n", "is not valid Python", "line 1"),
    "no text": (b"\x00\xff\xfe\x80", "is not valid Python", "give a Python file that ends with LAW"),
    "an exception on the way": (START + "gain = 1 / 0\n", "ZeroDivisionError", "line 3"),
    "an exception in the law": (law("return Command(now.yaw_rad, 1.0)"), "line 5 of the law law reads yaw_rad", "names are: elevation_rad"),
    "a file that ends the program": ("raise SystemExit(0)\n", "SystemExit", "line 1"),
    "an import that is not there": ("import nowhere_at_all\n", "nowhere_at_all", "line 1"),
    "one voltage": (law("return Command(1.0)"), "back_V", "line 5"),
    "three voltages": (law("return 1.0, 2.0, 3.0"), "3 values", "return Command"),
    "nothing returned": (law("pass"), "NoneType", "return Command"),
    "a word for a voltage": (law("return Command('full', 1.0)"), "output 0", "give a number"),
    "two numbers for a voltage": (law("return Command(casadi.vertcat(1, 2), 1.0)"), "2 numbers", "one number"),
    "one argument": (START + "@control_law()\ndef law(now):\n    return Command(1.0, 1.0)\n", "three", "(now, s"),
    "2,000 states": (
        law("return Command(1.0, 1.0)", "states={f'x{k}': 0.0 for k in range(2000)}"),
        "2000 states", "reduce the order",
    ),
    "300 parameters": (
        law("return Command(1.0, 1.0)", "parameters={f'k{k}': 0.0 for k in range(300)}"),
        "300 parameters", "give at most 255",
    ),
    "five signals": (law("return Command(1.0, 1.0, signals={f's{k}': 0.0 for k in range(5)})"), "5 signals", "at most 4"),
    "a state that is not there": (law("return Command(1.0, 1.0, states={'x': 0.0})"), "no state x", "name it"),
    "an unknown function": (law("return Command(casadi.erf(now.pitch_rad), 1.0)"), "erf", "use only"),
    "a function of math": (law("return Command(math.sin(now.pitch_rad), 1.0)"), "nan", "of math do not accept symbols"),
    "an if": (law("if now.pitch_rad > 0:\n    return Command(1.0, 1.0)\nreturn Command(2.0, 1.0)"), "line 5", "if_else"),
    "333 Hz": (law("return Command(1.0, 1.0)", "rate_Hz=333"), "333 Hz", "give 250 or 500 Hz"),
    "0 Hz": (law("return Command(1.0, 1.0)", "rate_Hz=0"), "0 Hz", "give"),
    "no number in it": (law("return Command(now.pitch_rad + math.nan, 1.0)"), "nan", "finite"),
    "no number for a state": (law("return Command(1.0, 1.0)", "states={'x': math.nan}"), "state x", "finite"),
    "no number for a parameter": (law("return Command(1.0, 1.0)", "parameters={'k': 1e39}"), "parameter k", "3.4e38"),
    "a word for a parameter": (law("return Command(1.0, 1.0)", "parameters={'k': 'two'}"), "parameter k", "give a n"),
    "a number of another size": (law("return Command(1e39 * now.pitch_rad, 1.0)"), "1e+39", "3.4e38"),
    "too many cells": (
        law("return Command(sum(k * 0.1 * sin(k * now.pitch_rad) for k in range(600)), 1.0)"), "512 cells", "smaller",
    ),
    "too much for a tick": (
        law("return Command(sum(sqrt(now.pitch_rad + k) for k in range(200)), 1.0)"), "instructions", "Hz it fits",
    ),
    "too much for any rate": (
        law("x = now.pitch_rad\nfor _ in range(1400): x = tanh(x)\nreturn Command(x, 1.0)", "rate_Hz=4"),
        "instructions", "fits no rate",
    ),
    "too many words": (
        law("x = now.pitch_rad\nfor _ in range(2000): x = floor(x + 0.5)\nreturn Command(x, 1.0)", "rate_Hz=4"),
        "words", "simplify",
    ),
}  # fmt: skip


def ends(process_id: int, within_s: float) -> bool:
    """Whether a process that is nobody's child here ends in time (a zombie has ended)."""
    give_up_s = time.monotonic() + within_s
    while time.monotonic() < give_up_s:
        try:
            if Path(f"/proc/{process_id}/stat").read_text().rpartition(")")[2].split()[0] == "Z":
                return True
        except (FileNotFoundError, ProcessLookupError):
            return True
        time.sleep(0.01)
    return False


@pytest.fixture
def nothing_sent(monkeypatch: pytest.MonkeyPatch) -> None:
    def connect(*_: object, **__: object) -> None:
        raise AssertionError("a board was asked")

    monkeypatch.setattr(heli_host, "connect", connect)


def write_bad_file(name: str, folder: Path) -> Path:
    content = BAD[name][0]
    path = folder / "bad.py"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


@pytest.mark.parametrize("name", BAD)
def test_a_file_without_a_law_to_fly_is_one_line_with_its_remedy(name: str, tmp_path: Path) -> None:
    """The file runs in this process, as the process of a file runs it."""
    with pytest.raises(BadLaw) as refused:
        run_law(write_bad_file(name, tmp_path)).program  # noqa: B018  -- compiled when it is asked for
    _, cause, remedy = BAD[name]
    line = str(refused.value)
    assert cause in line and remedy in line and refused.value.remedy and "\n" not in line
    assert "heli_lab" not in line.replace("of heli_lab.law", "")


@pytest.mark.usefixtures("nothing_sent")
@pytest.mark.parametrize("name", ["no Python", "one voltage", "too much for a tick"])
def test_the_command_says_the_same_of_a_bad_file_and_sends_nothing(name: str, terminal: Terminal) -> None:
    line = refusal(terminal("law", "check", write_bad_file(name, Path())), code=ASKED)
    _, cause, remedy = BAD[name]
    assert cause in line and remedy in line


@pytest.mark.usefixtures("nothing_sent")
@pytest.mark.parametrize(
    ("verb", "more"),
    [("check", ()), ("fly", ("--sil",)), ("compare", ("--sil",)), ("export", ("--output", "law.c"))],
)
def test_every_verb_names_a_file_that_is_not_there_or_never_ends(
    verb: str, more: tuple[str, ...], terminal: Terminal
) -> None:
    Path("folder.py").mkdir()
    assert "folder.py is not a file" in refusal(terminal("law", verb, "folder.py", *more), code=ASKED)
    Path("endless.py").write_text("n = 0\nwhile True:\n    n += 1\n")
    line = refusal(terminal("law", verb, "endless.py", "--load-timeout", "0.3", *more), code=ASKED)
    assert "endless.py did not end within 0.3 s; look for a loop without an end" in line
    assert "--load-timeout" in line


def test_what_an_endless_file_has_started_ends_with_it(tmp_path: Path) -> None:
    pid_file = tmp_path / "pid"
    (tmp_path / "law.py").write_text(
        "import pathlib, subprocess, sys\n"
        "child = subprocess.Popen([sys.executable, '-c', 'import time; time.sleep(3600)'])\n"
        f"pathlib.Path({str(pid_file)!r}).write_text(str(child.pid))\n"
        "child.wait()\n"
    )
    with pytest.raises(BadLaw, match="did not end within 3 s"):
        load_law(tmp_path / "law.py", 3.0)
    # The kernel delivers the signal, but the child may be scheduled a moment later: nobody here can wait for it.
    assert ends(int(pid_file.read_text()), within_s=30.0)


def test_a_page_refuses_a_law_whose_file_never_ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(law_files.load_law, "__defaults__", (0.3, None))
    (tmp_path / "endless.py").write_text("while True: pass\n")
    with pytest.raises(BadLaw, match=r"endless\.py did not end within 0\.3 s"):
        read_law(tmp_path / "endless.py")


@pytest.mark.usefixtures("nothing_sent")
def test_a_file_that_crashes_python_is_one_line(terminal: Terminal) -> None:
    Path("crash.py").write_text("import ctypes\nctypes.string_at(0)\n")
    assert "crash.py ended Python (SIGSEGV)" in refusal(terminal("law", "check", "crash.py"), code=ASKED)
    Path("exits.py").write_text("import os\nos._exit(3)\n")
    assert "exits.py ended Python (exit status 3)" in refusal(
        terminal("law", "check", "exits.py"), code=ASKED
    )


@pytest.mark.slow
def test_a_law_of_another_process_has_the_same_tape_and_may_print(tmp_path: Path) -> None:
    for path in sorted(LAWS.glob("*.py"))[::4]:
        assert load_law(path).program.words == law_of(path).program.words
    (tmp_path / "talks.py").write_text(law("return Command(1.0, 1.0)") + "print('x' * 200_000)\n")
    assert load_law(tmp_path / "talks.py").name == "law"


def test_a_law_may_import_a_file_of_its_folder(terminal: Terminal) -> None:
    Path("gains_of_mine.py").write_text("KP = 2.5\n")
    text = law("return Command(KP * now.pitch_rad + 1.0, 1.0)")
    Path("law.py").write_text("from gains_of_mine import KP\n" + text)
    result = terminal("law", "export", "law.py", "--output", "law.c")
    assert result.code == 0, result
    assert "2.5" in Path("law.c").read_text()


def test_c_that_cannot_be_written_is_one_line(terminal: Terminal) -> None:
    Path("law.py").write_text(law("return Command(1.0, 1.0)"))
    assert "nowhere" in refusal(terminal("law", "export", "law.py", "--output", "nowhere/law.c"), code=FILE)


def test_a_log_without_a_law_is_one_line(terminal: Terminal) -> None:
    Path("a.csv").write_text("t_s,front_V,back_V,elevation_rad,pitch_rad,travel_rad\n")
    assert "a.csv" in refusal(terminal("law", "compare", "a.csv", "b.csv"), code=FILE)
    assert "give two logs" in refusal(terminal("law", "compare", "a.csv"), code=FILE)


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


SHIPPED = [path for path in sorted(LAWS.glob("*.py")) if path.stem != "cascade"]
PRINTS_ITS_RIG = """
from heli_lab.law import Command, control_law, law_rig

@control_law(parameters={"weight": law_rig("quanser-course")["M_w"].value})
def law(now, state, parameter):
    return Command(parameter.weight, parameter.weight)

LAW = law
"""


def test_the_default_counts_where_no_rig_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(RIG_VARIABLE, raising=False)
    assert law_rig("quanser-course").name == "quanser-course"
    monkeypatch.setenv(RIG_VARIABLE, "makki2024-identified")
    assert law_rig("quanser-course").name == "makki2024-identified"


@pytest.mark.slow
def test_a_file_gets_a_rig_by_name_and_by_a_relative_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "student").mkdir()
    file = Path("student/law.py")
    file.write_text(PRINTS_ITS_RIG)
    write_rig(load_rig("makki2024").replace(M_w=1.7), Path("mine.toml"))
    assert load_law(file, rig="mine.toml").parameters["weight"] == 1.7
    assert load_law(file).parameters["weight"] == load_rig("quanser-course")["M_w"].value
    # A stranger's file runs in its own folder.
    fenced = load_limited(file, FileLimits(10.0), "mine.toml")
    assert fenced.words == load_law(file, rig="mine.toml").program.words


@pytest.mark.slow
@pytest.mark.parametrize("path", SHIPPED[:: samples(1, len(SHIPPED) - 1)], ids=lambda path: path.stem)
def test_each_shipped_law_is_another_on_another_rig(path: Path) -> None:
    programs = [load_law(path, rig=rig).program.words for rig in ("makki2024", "quanser-course")]
    assert list(programs[0]) != list(programs[1])


@pytest.mark.slow
def test_a_shipped_law_is_checked_for_the_rig_that_is_named(terminal: Terminal) -> None:
    checked = terminal("law", "check", LAWS / "lqi.py", "--rig", "quanser-course", "--rigs", 0)
    assert checked.code == 0 and "stable around level" in checked.out
