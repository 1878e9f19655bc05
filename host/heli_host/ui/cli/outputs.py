"""Checks of a verb's output files, made before the work begins."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Final

import typer

from heli_host.data.files import check_replaceable
from heli_host.ui.cli.say import STDOUT

FIGURE_ENDS: Final = (".png", ".pdf", ".svg")


def check_place(path: Path) -> None:
    """Check that a file can be written later, and create its folder."""
    if str(path).startswith("--"):
        raise typer.BadParameter(f"{path} is an option, but a file name is needed there; give a file")
    folder = path.absolute().parent
    for part in (folder, *folder.parents):
        if part.is_file():
            raise typer.BadParameter(f"cannot write {path}: {part} is a file; give the name of a folder")
    folder.mkdir(parents=True, exist_ok=True)
    if path.is_dir() or not os.access(path if path.exists() else folder, os.W_OK):
        reason = "it is a folder" if path.is_dir() else "you have no permission to write there"
        raise typer.BadParameter(f"cannot write {path}: {reason}; give another file")
    check_replaceable(path)


def check_parameters_place(path: Path | None) -> None:
    """Refuse to replace a file that holds no parameters, such as a rig: both are TOML."""
    if path is None:
        return
    check_place(path)
    if path.is_file():
        text = path.read_text(encoding="utf-8", errors="replace")
        if text.strip() and "[parameters]" not in text:
            raise typer.BadParameter(f"{path} exists and holds no parameters; give another file")


def check_result_places(*files: Path | None, figure: Path | None = None, report: Path | None = None) -> None:
    """Refuse places that the results of long work cannot be written to, before the work begins."""
    if figure is not None and figure.suffix.lower() not in FIGURE_ENDS:
        raise typer.BadParameter(
            f"--figure {figure} has an unknown format; give a file that ends in {', '.join(FIGURE_ENDS)}"
        )
    for target in (*files, figure):
        if target is not None and str(target) != STDOUT:
            check_place(target)
    if report is not None:
        for name in ("index.html", "result.json"):
            check_place(report / name)
