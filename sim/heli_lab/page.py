"""Pieces of a report: one HTML page that needs nothing else."""

from __future__ import annotations

import base64
import html
import io
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_DPI: Final = 110


def folder_with(numbers: Mapping[str, Any], folder: str | Path) -> Path:
    """Make the folder of a report, and keep its numbers there as result.json.

    Parameters
    ----------
    numbers : Mapping
        What the page is made of, as JSON has it.
    folder : str or Path
        Where to; made if it is missing.

    Returns
    -------
    Path
        The folder.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "result.json").write_text(json.dumps(numbers, indent=2) + "\n", encoding="utf-8")
    return folder


def table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Write a table.

    Parameters
    ----------
    heads : sequence of str
        Cells of its first row.
    rows : iterable of sequence of str
        Cells of the others.
    """
    head = "".join(f"<th>{escaped(cell)}</th>" for cell in heads)
    body = "".join(f"<tr>{''.join(f'<td>{escaped(cell)}</td>' for cell in row)}</tr>" for row in rows)
    return f"<table><tr>{head}</tr>{body}</table>"


def image(figure: Figure, path: Path, meaning: str) -> str:
    """Keep a figure as PNG and put it into the page.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        Drawn; it is written at 110 dots per inch.
    path : Path
        File to write.
    meaning : str
        What it shows, for those who cannot see it.

    Returns
    -------
    str
        HTML that needs no other file.
    """
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=_DPI)
    path.write_bytes(buffer.getvalue())
    data = base64.b64encode(buffer.getvalue()).decode("ascii")
    return f'<p><img alt="{escaped(meaning)}" src="data:image/png;base64,{data}"></p>'


def escaped(value: object) -> str:
    """Write a value as text.

    Parameters
    ----------
    value : object
        Anything.

    Returns
    -------
    str
        Its text, safe in HTML; a dash for a number that is none.
    """
    if isinstance(value, float) and not math.isfinite(value):
        return "–"
    return html.escape(str(value))
