"""Control laws in files: reading them as programs for a board.

This package does not define how a law is written. A package that does offers a function in the entry-point
group ``heli_host.laws``, which converts a file to a program.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Final

from heli_host.board.law_program import LawProgram
from heli_host.errors import BadLaw
from heli_host.plugins import plugins

ENTRY_POINT_GROUP: Final = "heli_host.laws"
FILE_LIMIT_s: Final = 30.0
"""How long the file of a law may run [s]. The laws of the documents take under 2 s. A shorter limit refuses
files that solve a large problem first; with a longer limit people wait longer for a loop without an end."""

LawReader = Callable[[Path, str | None], LawProgram]


def read_law(path: Path, rig: str | None = None) -> LawProgram:
    """Compile the law in a file to a program; the code of the file is run."""
    for entry in plugins(ENTRY_POINT_GROUP):
        reader: LawReader = entry.load()
        return reader(path, rig)
    raise BadLaw("no installed package can read control laws", "reinstall heli-host")
