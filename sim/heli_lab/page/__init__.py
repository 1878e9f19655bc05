"""Reports: one HTML page that needs no other file, from a template, and its numbers as JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

_HERE: Final = Path(__file__).parent


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


def write_page(folder: Path, template: Path, **content: Any) -> Path:
    """Write index.html into a `folder` from a jinja2 `template`, which extends this room's ``base.html`` and
    is given the `content` by name; return the page. All content is escaped.
    """
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader([template.parent, _HERE]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    page = folder / "index.html"
    page.write_text(environment.get_template(template.name).render(content), encoding="utf-8")
    return page
