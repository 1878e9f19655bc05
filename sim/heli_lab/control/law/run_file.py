"""Run the file of a law: ``python -m heli_lab.control.law.run_file FILE [CPU_S MEMORY_MB]``.

Standard output gets a line when the file begins to run, and then the answer: a pickle of the law, or of the
error's cause and fix. If limits are given, the file is not trusted: its process is fenced, and the answer is
JSON, which the reader checks.
"""

from __future__ import annotations

import codecs
import json
import os
import pickle
import runpy
import signal
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from heli_host.errors import BadLaw, HeliError

from heli_lab.control.law.law import Law
from heli_lab.control.law.limits import FileLimits, fence_process
from heli_lab.control.law.program_data import program_json


def answer_to(path: Path) -> dict[str, Any]:
    """Run a file; return its law, or the cause and fix of the error."""
    try:
        law = run_law(path)
        picklable_law = Law(
            law.name, law.rate_Hz, law.function, dict(law.states), dict(law.parameters), law.signals
        )
    except HeliError as error:
        return {"law": None, "cause": error.cause, "remedy": error.remedy}
    return {"law": picklable_law, "cause": "", "remedy": ""}


def program_or_error(path: Path) -> dict[str, str]:
    """Run an untrusted file, and compile its law.

    `path`: The file. The limits of this process must be set before.
    """
    answer = answer_to(path)
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
    path, limits = Path(sys.argv[1]), [float(word) for word in sys.argv[2:]]
    sys.argv = [str(path)]
    with _reserved_standard_output() as answers:
        # The limit of time counts from this line on, and not while Python imports this module.
        answers.write(b"begins\n")
        answers.flush()
        if limits:
            sys.dont_write_bytecode = True
            fence_process(FileLimits(limits[0], int(limits[1])))
            answers.write(json.dumps(program_or_error(path)).encode())
        else:
            answers.write(pickle.dumps(answer_to(path)))


if __name__ == "__main__":
    main()
