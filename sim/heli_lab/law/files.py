"""A law in a separate file: a Python module with a ``LAW``, run in a separate process."""

from __future__ import annotations

import os
import pickle
import queue
import runpy
import signal
import subprocess
import sys
import threading
import traceback
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any, Final

from heli_host.errors import BadLaw, HeliError
from heli_host.law_program import LawProgram
from heli_host.laws import FILE_LIMIT_s

from heli_lab.law.law import Law

_START_s: Final = 120.0
"""Longest wait until a process begins with the file [s]: a busy machine imports CasADi in some seconds."""


def load_law(path: Path, limit_s: float = FILE_LIMIT_s) -> Law:
    """Run a file in a separate process, and return its ``LAW``.

    Parameters
    ----------
    path : Path
        The file; its code is run, with its folder on the path of imports. Its output goes to standard error.
    limit_s : float
        Longest time that the file may run [s].

    Raises
    ------
    BadLaw
        The file is missing, fails, does not end in time, or holds no law.
    """
    if not path.is_file():
        raise BadLaw(f"{path} is not a file", "give a Python file that ends with LAW = ...")
    answer = _run_apart(path, limit_s)
    law = answer["law"]
    if not isinstance(law, Law):
        raise BadLaw(answer["cause"], answer["remedy"])
    return law


def _run_apart(path: Path, limit_s: float) -> dict[str, Any]:
    """Run a file in another process: its law, or what is wrong."""
    process = subprocess.Popen(
        [sys.executable, "-m", "heli_lab.law.run_file", str(path)],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        # A session of its own, so that what the file has started ends with it.
        start_new_session=True,
    )
    answers: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    # Windows waits for sockets only, so a thread waits for the pipe.
    threading.Thread(target=_pass_on, args=(process.stdout, answers), daemon=True).start()
    try:
        answers.get(timeout=_START_s)
        answer = answers.get(timeout=limit_s)
        # It has ended without a word, so it ends now.
        status = 0 if answer else process.wait()
    except queue.Empty:
        raise BadLaw(
            f"{path.name} did not end within {limit_s:g} s",
            "look for a loop without an end; heli-host law allows longer with --load-timeout",
        ) from None
    finally:
        _end(process)
    if answer:
        reply: dict[str, Any] = pickle.loads(answer)
        return reply
    how = f"exit status {status}" if status >= 0 else signal.Signals(-status).name
    raise BadLaw(f"{path.name} ended Python ({how})", "correct the file; python FILE shows details")


def _pass_on(pipe: IO[bytes], answers: queue.SimpleQueue[bytes]) -> None:
    """Put the line that says that the file begins, then all that follows, into a queue."""
    with pipe:
        answers.put(pipe.readline())
        answers.put(pipe.read())


def _end(process: subprocess.Popen[bytes]) -> None:
    with suppress(ProcessLookupError, PermissionError):
        if hasattr(os, "killpg"):
            os.killpg(process.pid, signal.SIGKILL)
        else:
            process.kill()
    process.wait()


def run_law(path: Path) -> Law:
    """Run a file here and take its ``LAW``.

    Parameters
    ----------
    path : Path
        The file.

    Raises
    ------
    BadLaw
        It fails, or holds no law.
    """
    try:
        with _importing_from(path.parent):
            held = runpy.run_path(str(path))
    except HeliError:
        raise
    except SyntaxError as error:
        raise BadLaw(
            f"{path.name} is not valid Python: {error.msg}{_at(error.lineno)}", "correct this line"
        ) from error
    # SystemExit: a file that ends the program would otherwise end with its own code, and no word.
    except (Exception, SystemExit) as error:
        text = str(error).split("\n")[0]
        lines = [
            frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(path)
        ]
        raise BadLaw(
            f"{path.name} fails: {type(error).__name__}: {text}{_at(lines[-1] if lines else None)}",
            "correct the file; python FILE shows details",
        ) from error
    law = held.get("LAW")
    if isinstance(law, Law):
        return law
    variable = next((name for name, value in held.items() if isinstance(value, Law)), "")
    if law is not None:
        raise BadLaw(f"the LAW of {path.name} is a {type(law).__name__}", _remedy(variable))
    raise BadLaw(f"{path.name} does not define LAW", _remedy(variable))


def load_program(path: Path) -> LawProgram:
    """Make a program of the ``LAW`` of a file; the entry point ``heli_host.laws``.

    Parameters
    ----------
    path : Path
        The file; its code is run.

    Raises
    ------
    BadLaw
        It is missing, fails, does not end, holds no law, or one that a board does not take.
    """
    return load_law(path).program


def _remedy(name: str) -> str:
    if name:
        return f"end it with LAW = {name}"
    return "end it with LAW = ..., what @control_law or from_gain of heli_lab.law makes"


def _at(line: int | None) -> str:
    return "" if line is None else f" (line {line})"


@contextmanager
def _importing_from(folder: Path) -> Iterator[None]:
    where = str(folder.resolve())
    sys.path.insert(0, where)
    try:
        yield
    finally:
        sys.path.remove(where)
