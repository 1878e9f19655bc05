"""Run the file of a law in a separate process: ``python -m heli_lab.law.run_file FILE [CPU_S MEMORY_MB]``.

Standard output is a line when the file begins to run, then a pickle: the law, or the error's cause and fix.
With limits, the file is a stranger's: it is fenced in, and the answer is JSON, which the reader checks.
"""

from __future__ import annotations

import json
import os
import pickle
import signal
import sys
from pathlib import Path
from typing import IO, Any

from heli_host.errors import HeliError

from heli_lab.law.files import run_law
from heli_lab.law.law import Law
from heli_lab.law.limits import FileLimits, fence_process
from heli_lab.law.program_data import program_json


def answer_to(path: Path) -> dict[str, Any]:
    """Run a file; return its law, or the cause and fix of the error."""
    try:
        law = run_law(path)
        plain = Law(law.name, law.rate_Hz, law.function, dict(law.states), dict(law.parameters), law.signals)
    except HeliError as error:
        return {"law": None, "cause": error.cause, "remedy": error.remedy}
    return {"law": plain, "cause": "", "remedy": ""}


def program_or_error(path: Path) -> dict[str, str]:
    """Run a stranger's file; its program as JSON, or what is wrong.

    Parameters
    ----------
    path : Path
        The file; this process has its limits already.
    """
    answer = answer_to(path)
    law = answer["law"]
    if law is None:
        return {"cause": answer["cause"], "remedy": answer["remedy"]}
    try:
        return {"program": program_json(law.program)}
    except HeliError as error:
        return {"cause": error.cause, "remedy": error.remedy}


def _answers() -> IO[bytes]:
    """Keep standard output for the answer; what the file prints goes to standard error."""
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    return answers


def main() -> None:
    """Run the file named on the command line."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for whoever waits for the answer
    path, limits = Path(sys.argv[1]), [float(word) for word in sys.argv[2:]]
    sys.argv = [str(path)]
    with _answers() as answers:
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
