"""Load a control law from a Python file that defines ``LAW``. The file runs in a separate process.

That process runs ``python -m heli_lab.control.law_files FILE [CPU_S MEMORY_MB]``. It writes a line to
standard output when the file begins to run, and then the answer: a pickle of the law, or of the error's cause
and fix. If limits are given, the file is not trusted: its process is fenced, and the answer is JSON, which
the reader checks.
"""

from __future__ import annotations

import codecs
import json
import os
import pickle
import queue
import runpy
import signal
import subprocess
import sys
import threading
import traceback
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Final, NamedTuple

from heli_host.board.law_program import FILE_LIMIT_s, LawProgram
from heli_host.errors import BadLaw, HeliError

from heli_lab.control.fence import FileLimits, fence_process
from heli_lab.control.law import Law
from heli_lab.control.program_json import program_json, program_of_json

if TYPE_CHECKING:
    from heli_sim.rig import Rig


_MAX_START_s: Final = 120.0
"""Longest wait until a process begins with the file [s]: a busy computer imports CasADi in some seconds."""
_WAIT_PER_CPU_s: Final = 5.0
_EXTRA_WAIT_s: Final = 3.0
"""An untrusted file may run for this multiple of its processor time, plus this extra time [s]: the
processor is shared, and the system ends an endless loop up to 2 s late. With less, a busy computer
refuses valid files; with more, a file that sleeps delays a whole class."""
_MAX_ANSWER_BYTES: Final = 1 << 20
"""Longest answer of an untrusted file: a program of 1,536 words takes less than 200 kB."""
_FENCED_ENVIRONMENT: Final = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "PYTHONHASHSEED": "0"}
"""Environment of an untrusted file: threads would take memory, and random hashes would change the order of a
set from run to run."""


def check_files(paths: Sequence[Path]) -> None:
    """Check that files exist, before the work with them begins."""
    for path in paths:
        if not path.is_file():
            raise BadLaw(f"{path} is not a file", "give a Python file that ends with LAW = ...")


def load_law(path: Path, limit_s: float = FILE_LIMIT_s, rig: str | None = None) -> Law:
    """Run a file in a separate process, and return its ``LAW``."""
    check_files([path])
    try:
        pickled, status = _run_in_process(path, limit_s, rig)
    except TimeoutError:
        raise BadLaw(
            f"{path.name} did not end within {limit_s:g} s",
            "look for a loop without an end; heli-host law allows longer with --load-timeout",
        ) from None
    if not pickled:
        raise _error_of_ended_process(path, status)
    answer: dict[str, Any] = pickle.loads(pickled)
    law = answer["law"]
    if not isinstance(law, Law):
        raise BadLaw(answer["cause"], answer["remedy"])
    return law


def load_limited(path: Path, limits: FileLimits, rig: str | None = None) -> LawProgram:
    """Run an untrusted file in a fenced process, and return the program of its ``LAW``."""
    # The process has limits of time and memory, and can write no file, open no socket and start no process.
    # Its answer is checked, and everything that it prints is discarded. The file can still read all files
    # that you can read.
    check_files([path])  # Reading a pipe or a device of this name would never end.
    # The same message for an endless loop and an endless wait: the computer's load decides which limit ends
    # the process first.
    endless = BadLaw(
        f"{path.name} did not end within {limits.cpu_s:g} s of processor time",
        "look for a loop or a wait without an end; --load-timeout allows more",
    )
    try:
        answer, status = _run_in_process(path, _WAIT_PER_CPU_s * limits.cpu_s + _EXTRA_WAIT_s, rig, limits)
    except TimeoutError:
        raise endless from None
    if not answer:
        if status < 0 and signal.Signals(-status).name in ("SIGXCPU", "SIGKILL"):
            raise endless
        raise _error_of_ended_process(path, status)
    try:
        reply = json.loads(answer)
        if "program" in reply:
            return program_of_json(reply["program"])
        cause, remedy = str(reply["cause"]), str(reply["remedy"])
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise BadLaw(
            f"{path.name} did not return a law", "remove the code that replaces the output of its process"
        ) from error
    # The cause names the exception that ended the file.
    if MemoryError.__name__ in cause:
        remedy = f"use less than {limits.memory_MB} MB of memory"
    elif PermissionError.__name__ in cause:
        remedy = "a law's file only computes: remove this line"
    raise BadLaw(cause, remedy)


class _EndedProcess(NamedTuple):
    """What the process of a law file has left."""

    answer: bytes  # Empty if the file ended the process
    status: int  # Exit status; minus the number of the signal that ended the process


def _run_in_process(
    path: Path, limit_s: float, rig: str | None, limits: FileLimits | None = None
) -> _EndedProcess:
    """Run a law file in another process, which is fenced if there are `limits`."""
    is_fenced = limits is not None
    # `main` reads these words.
    limit_words = (f"{limits.cpu_s}", f"{limits.memory_MB}") if limits is not None else ()
    no_limit = -1
    max_bytes = _MAX_ANSWER_BYTES if is_fenced else no_limit
    process = subprocess.Popen(
        # -P: a file in the present folder cannot replace a module of Python.
        [
            sys.executable,
            "-P",
            "-m",
            "heli_lab.control.law_files",
            # A fenced process starts in the file's folder, so that it needs the absolute path.
            str(path.absolute() if is_fenced else path),
            *limit_words,
        ],
        env={
            **os.environ,
            # A relative entry, as of `sys.path.insert(0, ".")`, would be the present folder too.
            "PYTHONPATH": os.pathsep.join(filter(os.path.isabs, sys.path)),
            **_rig_environment(rig),
            **(_FENCED_ENVIRONMENT if is_fenced else {}),
        },
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL if is_fenced else None,
        cwd=path.parent if is_fenced else None,
        # A separate session, so that processes started by the file can be ended together with it.
        start_new_session=True,
    )
    answers: queue.SimpleQueue[bytes] = queue.SimpleQueue()
    # Windows cannot wait for a pipe with a time limit, so a thread reads the pipe.
    threading.Thread(target=_read_answer, args=(process.stdout, answers, max_bytes), daemon=True).start()
    try:
        # First the line that is written when the file begins, then the answer.
        answers.get(timeout=_MAX_START_s)
        answer = answers.get(timeout=limit_s)
        # Without an answer, the process has closed its output and is about to end.
        return _EndedProcess(answer, 0 if answer else process.wait(timeout=limit_s))
    except (queue.Empty, subprocess.TimeoutExpired):
        raise TimeoutError from None
    finally:
        _kill_process_group(process)


def _error_of_ended_process(path: Path, status: int) -> BadLaw:
    """Describe the error that the file at `path` ended its process with an exit `status`."""
    reason = f"exit status {status}" if status >= 0 else signal.Signals(-status).name
    return BadLaw(f"{path.name} ended Python ({reason})", "correct the file; python FILE shows details")


def _read_answer(pipe: IO[bytes], answers: queue.SimpleQueue[bytes], max_bytes: int) -> None:
    """Read the output of a process into a queue: first its first line, then up to `max_bytes` that follow."""
    with pipe:
        answers.put(pipe.readline())
        answers.put(pipe.read(max_bytes))


def _kill_process_group(process: subprocess.Popen[bytes]) -> None:
    """End a process, and all processes that it has started."""
    with suppress(ProcessLookupError, PermissionError):
        if hasattr(os, "killpg"):
            os.killpg(process.pid, signal.SIGKILL)
        else:
            process.kill()
    process.wait()


def load_program(path: Path, rig: str | None = None) -> LawProgram:
    """Compile the ``LAW`` of a file; the entry point ``heli_host.laws``."""
    return load_law(path, rig=rig).program


def _answer_to(path: Path) -> dict[str, Any]:
    """Run a file; return its law, or the cause and fix of the error."""
    try:
        law = run_law(path)
        picklable_law = Law(
            law.name, law.rate_Hz, law.function, dict(law.states), dict(law.parameters), law.signals
        )
    except HeliError as error:
        return {"law": None, "cause": error.cause, "remedy": error.remedy}
    return {"law": picklable_law, "cause": "", "remedy": ""}


def _program_or_error(path: Path) -> dict[str, str]:
    """Run an untrusted file, and compile its law."""
    # `path`: The file. The limits of this process must be set before.
    answer = _answer_to(path)
    law = answer["law"]
    if law is None:
        return {"cause": answer["cause"], "remedy": answer["remedy"]}
    try:
        return {"program": program_json(law.program)}
    except HeliError as error:
        return {"cause": error.cause, "remedy": error.remedy}


def run_law(path: Path) -> Law:
    """Run a file in this process and return its ``LAW``."""
    try:
        with _importing_from(path.parent):
            variables = runpy.run_path(str(path))
    except HeliError:
        raise
    except SyntaxError as error:
        if path.read_bytes().startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
            raise BadLaw(
                f"{path.name} is text in UTF-16, which Python does not read", "save it as UTF-8"
            ) from error
        raise BadLaw(
            f"{path.name} is not valid Python: {error.msg}{_line_number_text(error.lineno)}",
            "correct this line" if error.lineno else "give a Python file that ends with LAW = ...",
        ) from error
    # SystemExit too: a file that calls sys.exit would otherwise end this process without a message.
    except (Exception, SystemExit) as error:
        text = str(error).split("\n")[0]
        lines = [
            frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(path)
        ]
        raise BadLaw(
            f"{path.name} fails: {type(error).__name__}: {text}"
            f"{_line_number_text(lines[-1] if lines else None)}",
            "correct the file; python FILE shows details",
        ) from error
    law = variables.get("LAW")
    if isinstance(law, Law):
        return law
    variable = next((name for name, value in variables.items() if isinstance(value, Law)), "")
    if law is not None:
        raise BadLaw(
            f"the LAW of {path.name} has the type {type(law).__name__}", _remedy_for_missing_law(variable)
        )
    raise BadLaw(f"{path.name} does not define LAW", _remedy_for_missing_law(variable))


def _reserved_standard_output() -> IO[bytes]:
    """Reserve standard output for the answer; what the file prints goes to standard error."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    return answers


def _remedy_for_missing_law(variable: str) -> str:
    """Say how to define LAW, if possible by the `variable` that already holds a law."""
    if variable:
        return f"end it with LAW = {variable}"
    return "end it with LAW = ..., what @control_law or from_gain of heli_lab.law makes"


def _line_number_text(line: int | None) -> str:
    """Words for the number of a line; empty if it is unknown."""
    return "" if line is None else f" (line {line})"


@contextmanager
def _importing_from(folder: Path) -> Iterator[None]:
    """Search a folder for imported modules before all others, until the block ends."""
    path = str(folder.resolve())
    sys.path.insert(0, path)
    try:
        yield
    finally:
        sys.path.remove(path)


def main() -> None:
    """Run the file named on the command line."""
    # Ctrl-C ends the process that waits for the answer, and that process ends this one.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    path, limit_words = Path(sys.argv[1]), sys.argv[2:]
    sys.argv = [str(path)]
    with _reserved_standard_output() as answers:
        # The limit of time counts from this line on, and not while Python imports this module.
        answers.write(b"begins\n")
        answers.flush()
        if limit_words:
            cpu_s, memory_MB = limit_words
            sys.dont_write_bytecode = True
            fence_process(FileLimits(float(cpu_s), int(memory_MB)))
            answers.write(json.dumps(_program_or_error(path)).encode())
        else:
            answers.write(pickle.dumps(_answer_to(path)))


RIG_VARIABLE: Final = "HELI_LAW_RIG"
"""Environment variable with the name or the file of the rig."""


def law_rig(default: str | Path = "makki2024") -> Rig:
    """Return the rig that ``--rig`` of the command names, otherwise the default.

    Without a command, as in ``python mine.py``, the environment variable ``HELI_LAW_RIG`` names the rig.

    Parameters
    ----------
    default : str or Path
        Name of a shipped rig, or path of a TOML file.

    Raises
    ------
    RigError
        There is no such rig, or its file is invalid.

    Examples
    --------
    >>> law_rig("quanser-course").name
    'quanser-course'
    """
    from heli_sim.rig import load_rig

    return load_rig(os.environ.get(RIG_VARIABLE) or default)


def _rig_environment(rig: str | None) -> Mapping[str, str]:
    """Return the environment variable that states the rig for `law_rig` in another process."""
    if rig is None:
        return {}  # the law file has its default rig
    path = Path(rig)
    # The process may run in another folder.
    return {RIG_VARIABLE: str(path.absolute()) if path.is_file() else rig}


if __name__ == "__main__":
    main()
