"""JSON files from other people, with errors in one line."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from heli_host.data.files import read_file

from heli_benchmark.errors import BenchmarkError

_MOST_BYTES: Final = 1 << 24
"""Largest file. The names of a split need 10 kB, and an answer with a predicted flight at 500 Hz 2 MB."""


def read_json(path: Path, remedy: str, keys: Sequence[str] = ()) -> dict[str, Any]:
    """Read a JSON object.

    `keys`: Keys that the object must have.
    """
    try:
        content = json.loads(read_file(path, _MOST_BYTES))
    except OSError as error:
        raise BenchmarkError(f"cannot read {path}: {error.strerror or error}", remedy) from None
    except (ValueError, RecursionError):
        raise BenchmarkError(f"{path} is not valid JSON", remedy) from None
    if not isinstance(content, dict):
        raise BenchmarkError(f"{path} is not a JSON object", remedy)
    for key in keys:
        if key not in content:
            raise BenchmarkError(f"{path} has no '{key}'", remedy)
    return content


def write_json(path: Path, content: object) -> None:
    """Write JSON; the file is complete or absent."""
    unfinished = path.with_name(f"unfinished-{path.name}")
    unfinished.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    unfinished.replace(path)
