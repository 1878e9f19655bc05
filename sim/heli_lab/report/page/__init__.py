"""Write reports: a self-contained HTML page from a template, and its data as JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from heli_host.data.files import RESULT_SCHEMA, write_signed, write_text

_HERE: Final = Path(__file__).parent


def folder_with(numbers: Mapping[str, Any], folder: str | Path) -> Path:
    """Create the `folder` of a report, write `numbers` into its result.json, and return the folder."""
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / "result.json", {"schema": RESULT_SCHEMA, **numbers})
    return folder


def write_json(path: Path, numbers: Any) -> None:
    """Write `numbers` as JSON to `path`; infinite values and NaN become null, because JSON has neither."""
    write_text(path, json.dumps(_finite(numbers), indent=2, allow_nan=False) + "\n")


def _finite(value: Any) -> Any:
    """Replace infinite values and NaN by None, also inside of mappings and lists."""
    if isinstance(value, Mapping):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def write_page(folder: Path, template: Path, **content: Any) -> Path:
    """Write index.html into a `folder` from a jinja2 template, and return the path of the page."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader([template.parent, _HERE]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    page = folder / "index.html"
    write_signed(page, environment.get_template(template.name).render(content))
    return page
