"""Runs ``heli-host`` in this process, and in one of its own where signals or limits are meant."""

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

import pytest
from heli_host.ui.cli import run


@dataclass(frozen=True)
class Ended:
    """How a command ended, and what it printed."""

    code: int  # Exit code
    out: str
    err: str


PATIENCE_S = 60.0
Terminal = Callable[..., Ended]


@pytest.fixture
def terminal(capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Terminal:
    """Run a command in an empty folder."""
    monkeypatch.chdir(tmp_path)

    def type_in(*arguments: str | Path) -> Ended:
        capsys.readouterr()
        code = run([str(argument) for argument in arguments])
        output = capsys.readouterr()
        return Ended(code, output.out, output.err)

    return type_in


def command(*arguments: str | Path) -> list[str]:
    """Return the command line of a process of its own."""
    return [sys.executable, "-c", "from heli_host.ui.cli import main; main()", *map(str, arguments)]


class Process(subprocess.Popen[str]):
    """A process that does not outlive a block that failed: the run would wait for it for ever."""

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is not None:
            self.kill()
        super().__exit__(kind, value, trace)


def process(folder: Path, *arguments: str | Path, prepare: Callable[[], object] | None = None) -> Process:
    """Start a command in a process of its own, which does `prepare` before."""
    return Process(
        command(*arguments),
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=prepare,
    )


def until_open(running: Process, port: str) -> None:
    """Wait until a process has opened a port, which on a busy machine takes it seconds."""
    device, end_s = os.path.realpath(port), time.monotonic() + PATIENCE_S
    files = Path(f"/proc/{running.pid}/fd")
    while device not in {os.path.realpath(file) for file in files.iterdir()}:
        assert running.poll() is None and time.monotonic() < end_s, f"{port} is not opened"
        time.sleep(0.02)


def refusal(ended: Ended, *, code: int) -> str:
    """Return the one line of a command that was refused with an exit code."""
    assert ended.code == code, ended
    lines = ended.err.splitlines()
    assert len(lines) == 1, ended.err
    assert lines[0].startswith("error: ")
    return lines[0]


def listed_commands(group: Any, name: str = "") -> Iterator[tuple[str, Any]]:
    """Each command that the help lists, verbs and their parts, with its words; groups come first."""
    yield name or "heli-host", group
    for part, command in getattr(group, "commands", {}).items():
        if not command.hidden:
            yield from listed_commands(command, f"{name} {part}".strip())
