"""Run the file of a law in a separate process: ``python -m heli_lab.law.run_file FILE``.

Standard output is a line when the file begins to run, then a pickle: the law, or the error's cause and fix.
"""

from __future__ import annotations

import os
import pickle
import signal
import sys
from pathlib import Path
from typing import IO, Any

from heli_host.errors import HeliError

from heli_lab.law.files import run_law
from heli_lab.law.law import Law


def answer_to(path: Path) -> dict[str, Any]:
    """Run a file; return its law, or the cause and fix of the error.

    Parameters
    ----------
    path : Path
        The file.
    """
    try:
        law = run_law(path)
        plain = Law(law.name, law.rate_Hz, law.function, dict(law.states), dict(law.parameters), law.signals)
    except HeliError as error:
        return {"law": None, "cause": error.cause, "remedy": error.remedy}
    return {"law": plain, "cause": "", "remedy": ""}


def _answers() -> IO[bytes]:
    """Keep standard output for the answer; what the file prints goes to standard error."""
    kept = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    return kept


def main() -> None:
    """Run the file named on the command line."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for whoever waits for the answer
    path = Path(sys.argv[1])
    sys.argv = [str(path)]
    with _answers() as answers:
        answers.write(b"begins\n")
        answers.flush()
        answers.write(pickle.dumps(answer_to(path)))


if __name__ == "__main__":
    main()
