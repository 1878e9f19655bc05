"""Files that a verb is going to write: refused before the work, not after it."""

from __future__ import annotations

import os
from pathlib import Path

import typer


def check_place(path: Path) -> None:
    """Refuse a file that could not be written, and make its folder.

    Parameters
    ----------
    path : Path
        File to be written later.

    Raises
    ------
    typer.BadParameter
        When it is a folder, or may not be written.
    """
    folder = path.absolute().parent
    folder.mkdir(parents=True, exist_ok=True)
    if path.is_dir() or not os.access(path if path.exists() else folder, os.W_OK):
        raise typer.BadParameter(f"{path} cannot be written; choose another place")
