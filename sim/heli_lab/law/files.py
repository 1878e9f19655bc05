"""A law in a file of its own: a Python module with a ``LAW``."""

from __future__ import annotations

import runpy
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from heli_host.errors import BadLaw, HeliError
from heli_host.tape import Tape

from heli_lab.law.law import Law


def load_law(path: Path) -> Law:
    """Run a file and take its ``LAW``.

    Parameters
    ----------
    path : Path
        The file; its code is run, with its folder on the path of imports.

    Raises
    ------
    BadLaw
        It is missing, fails, or holds no law.
    """
    if not path.is_file():
        raise BadLaw(f"there is no file {path}", "name a Python file that ends with LAW = ...")
    try:
        with _importing_from(path.parent):
            held = runpy.run_path(str(path))
    except HeliError:
        raise
    except SyntaxError as error:
        raise BadLaw(f"{path.name} is no Python: {error.msg}{_at(error.lineno)}", "correct it") from error
    # SystemExit: a file that ends the program would otherwise end with its own code, and no word.
    except (Exception, SystemExit) as error:
        text = str(error).split("\n")[0]
        lines = [
            frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(path)
        ]
        raise BadLaw(
            f"{path.name} fails: {type(error).__name__}: {text}{_at(lines[-1] if lines else None)}",
            "correct it; run alone with python, it says more",
        ) from error
    law = held.get("LAW")
    if isinstance(law, Law):
        return law
    variable = next((name for name, value in held.items() if isinstance(value, Law)), "")
    if law is not None:
        raise BadLaw(f"the LAW of {path.name} is a {type(law).__name__}", _remedy(variable))
    raise BadLaw(f"{path.name} has no LAW", _remedy(variable))


def load_tape(path: Path) -> Tape:
    """Make a tape of the ``LAW`` of a file; the entry point ``heli_host.laws``.

    Parameters
    ----------
    path : Path
        The file; its code is run.

    Raises
    ------
    BadLaw
        It is missing, fails, holds no law, or one that a board does not take.
    """
    return load_law(path).tape


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
