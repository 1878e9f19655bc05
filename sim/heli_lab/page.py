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
_STYLE: Final = """
body { font: 15px/1.5 system-ui, sans-serif; color: #222 }
body { max-width: 64rem; margin: 2rem auto; padding: 0 1rem }
h1 { font-size: 1.6rem; margin-bottom: .3rem } h2 { font-size: 1.15rem; margin-top: 2.2rem }
h2 { border-bottom: 1px solid #ddd } table { border-collapse: collapse; margin: .8rem 0 }
td, th { padding: .15rem .7rem; text-align: right } th { border-bottom: 1px solid #999; font-weight: 600 }
td:first-child, th:first-child { text-align: left } tr:nth-child(even) { background: #f6f6f6 }
img { max-width: 100% } .note { color: #666 } code, pre { background: #f6f6f6; font-size: .9em }
pre { padding: .6rem } .taken { font-weight: 600 }
.verdict { font-size: 1.15rem; background: #f2f6fa; padding: .7rem 1rem; border-left: 4px solid #0b5fa5 }
.unexplained { border-color: #d1495b; background: #fbf2f3 } .ambiguous { border-color: #d9952b }
.explained { border-color: #4a9c5d; background: #f2f9f4 }
"""


def folder_with(numbers: Mapping[str, Any], folder: str | Path) -> Path:
    """Make the `folder` of a report, keep its `numbers` there as result.json, and return it."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / "result.json", numbers)
    return folder


def write_json(path: Path, numbers: Any) -> None:
    """Write `numbers` into the file at `path`; JSON has no infinity, so what is not finite becomes null."""
    path.write_text(json.dumps(_finite(numbers), indent=2, allow_nan=False) + "\n", encoding="utf-8")


def _finite(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def write_page(folder: Path, title: str, sections: Sequence[str]) -> Path:
    """Write index.html with a `title` and the HTML of its `sections` into a `folder`; return the page."""
    page = folder / "index.html"
    page.write_text(
        f'<!doctype html>\n<html lang="en"><meta charset="utf-8"><title>{escaped(title)}</title>'
        f"<style>{_STYLE}</style>\n" + "\n".join(sections) + "\n</html>\n",
        encoding="utf-8",
    )
    return page


def table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Write a table with the cells of its first row, `heads`, and those of the other `rows`."""
    head = "".join(f"<th>{escaped(cell)}</th>" for cell in heads)
    body = "".join(f"<tr>{''.join(f'<td>{escaped(cell)}</td>' for cell in row)}</tr>" for row in rows)
    return f"<table><tr>{head}</tr>{body}</table>"


def image(figure: Figure, path: Path, meaning: str) -> str:
    """Keep a figure as PNG and put it into the page, as HTML that needs no other file.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        Drawn; it is written at 110 dots per inch.
    path : Path
        File to write.
    meaning : str
        What it shows, for those who cannot see it.
    """
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=_DPI)
    path.write_bytes(buffer.getvalue())
    data = base64.b64encode(buffer.getvalue()).decode("ascii")
    return f'<p><img alt="{escaped(meaning)}" src="data:image/png;base64,{data}"></p>'


def escaped(value: object) -> str:
    """Write any `value` as text that is safe in HTML; a dash for a number that is none."""
    if isinstance(value, float) and not math.isfinite(value):
        return "–"
    return html.escape(str(value))
