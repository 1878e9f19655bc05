"""A law in a file of its own: a Python module with a ``LAW``."""

from __future__ import annotations

import runpy
from pathlib import Path

from heli_host.errors import BadLaw, HeliError
from heli_host.tape import Tape

from heli_lab.law.law import Law


def load_law(path: Path) -> Law:
    """Run a file and take its ``LAW``.

    Parameters
    ----------
    path : Path
        The file; its code is run.

    Raises
    ------
    BadLaw
        It is missing, fails, or holds no law.
    """
    if not path.is_file():
        raise BadLaw(f"there is no file {path}", "name a Python file that ends with LAW = ...")
    try:
        law = runpy.run_path(str(path)).get("LAW")
    except HeliError:
        raise
    except Exception as error:
        text = str(error).split("\n")[0]
        raise BadLaw(
            f"{path.name} fails: {type(error).__name__}: {text}", "run it with python to see where"
        ) from error
    if not isinstance(law, Law):
        raise BadLaw(f"{path.name} has no LAW", "end it with LAW = ..., a law of heli_lab.law")
    return law


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
