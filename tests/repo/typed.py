"""Runs what a document says to type: each command a process, forked from one that has read the libraries.

Most commands compute for a moment; to start Python and read NumPy, CasADi and the host takes each of them
half a second of CPU. As a program this is that process: it takes commands from its standard input, one a
line as JSON, and answers each with its exit code.
"""

from __future__ import annotations

import importlib
import json
import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Final

LIBRARIES: Final = (
    "heli_host.fly.runner",
    "heli_sim.sil.transport",
    "heli_sim.sil.world",
    "heli_lab.identify",
)
"""What nearly all commands need; matplotlib and SciPy's signals take a second, and a command that wants them
reads them itself."""
HELI_HOST: Final = "heli-host"
PYTHON: Final = "python"
PATIENCE_S: Final = 300
"""After which a command is ended by SIGALRM: no test waits for ever."""


class Typed:
    """Commands and programs, run one after the other in one folder.

    Parameters
    ----------
    folder : Path
        Where they run.
    """

    def __init__(self, folder: Path) -> None:
        self._said = folder.with_name(folder.name + ".said")
        environment = {**os.environ, "MPLBACKEND": "agg"}
        command = [sys.executable, __file__, str(self._said)]
        self._started = subprocess.Popen(
            command, cwd=folder, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )

    def __enter__(self) -> Typed:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is not None:
            self._started.kill()
        # Waited for, so that what all of them took is charged to the test.
        self._started.communicate()

    def run(self, words: Sequence[str]) -> tuple[int, str]:
        """Run ``heli-host ...`` or ``python -c ...``; its exit code, and what it said."""
        assert self._started.stdin is not None
        assert self._started.stdout is not None
        self._started.stdin.write(json.dumps(list(words)) + "\n")
        self._started.stdin.flush()
        code = int(self._started.stdout.readline() or -1)
        return code, self._said.read_text(encoding="utf-8", errors="replace")


def main() -> None:
    """Fork for each command, and in its process become it."""
    for name in LIBRARIES:
        importlib.import_module(name)
    for line in sys.stdin:
        child = os.fork()
        if child == 0:
            become(json.loads(line), sys.argv[1])
            return
        _, status = os.waitpid(child, 0)
        print(os.waitstatus_to_exitcode(status), flush=True)


def become(words: list[str], said: str) -> None:
    """Be a command, with nothing to read and its output in a file."""
    signal.alarm(PATIENCE_S)
    with Path(os.devnull).open("rb") as nothing, Path(said).open("wb") as output:
        os.dup2(nothing.fileno(), 0)
        for number in (1, 2):
            os.dup2(output.fileno(), number)
    program, *sys.argv[1:] = words
    if program == HELI_HOST:
        from heli_host.cli import main as heli_host

        sys.argv[0] = program
        heli_host()
    elif program != PYTHON:
        os.execvp(program, words)
    else:
        sys.argv[:] = ["-c"]
        exec(compile(words[-1], "<document>", "exec"), {"__name__": "__main__"})


if __name__ == "__main__":
    main()
