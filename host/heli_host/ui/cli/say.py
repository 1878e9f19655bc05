"""Output of the verbs: lines with escaped control characters, results as JSON, and data."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterable, Mapping
from contextvars import ContextVar
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from heli_host.errors import printable

if TYPE_CHECKING:
    from heli_host.data.log.summary import FlightSummary

QUIET: Final[ContextVar[bool]] = ContextVar("quiet", default=False)
"""Whether progress and lists of files are left out; `heli_host.ui.cli.entry` runs each command line in a
separate context."""
DATA_ONLY: Final[ContextVar[bool]] = ContextVar("data_only", default=False)
"""Whether standard output is for data alone, so that words go to standard error."""
STDOUT: Final = "-"
"""In the place of a file: standard output."""


def say(*lines: str) -> None:
    """Print `lines`, each with its control characters as escapes; to standard error where standard output is
    for data.
    """
    stream = sys.stderr if DATA_ONLY.get() else sys.stdout
    for line in lines:
        print(printable(line), file=stream)
    stream.flush()


def say_error(*lines: str) -> None:
    """Print `lines` to standard error, where they are not mixed with data."""
    for line in lines:
        print(printable(line), file=sys.stderr)


def say_progress(*lines: str) -> None:
    """Print `lines` on how far something is, unless ``--quiet`` was given."""
    if not QUIET.get():
        say(*lines)


def data_on_stdout(*files: Path | None) -> None:
    """Keep standard output for data from now on if one of these `files` is ``-``."""
    if any(str(file) == STDOUT for file in files):
        DATA_ONLY.set(True)


def write_result(file: Path | None, content: Mapping[str, Any]) -> bool:
    """Write a verb's result as JSON, with the number of its schema. Return whether it went to standard
    output, where nothing else may follow.
    """
    import json

    from heli_host.data.files import RESULT_SCHEMA, write_text

    if file is None:
        return False
    data_on_stdout(file)
    text = (
        json.dumps(_with_null_for_non_finite({"schema": RESULT_SCHEMA, **content}), indent=2, allow_nan=False)
        + "\n"
    )
    if str(file) == STDOUT:
        say_data(text)
        return True
    file.parent.mkdir(parents=True, exist_ok=True)
    write_text(file, text)
    return False


def say_dropped(reasons: Iterable[str], file: Path | None = None) -> None:
    """Print the `reasons` why values of a parameter `file` of another schema are not used, one line each."""
    file_text = f"{file}: " if file is not None else ""
    say(*(f"{file_text}dropped: {reason}" for reason in reasons))


def say_data(text: str) -> None:
    """Write `text` to standard output as it is, for another program."""
    sys.stdout.write(text)
    sys.stdout.flush()


def _with_null_for_non_finite(content: Any) -> Any:
    """Return content for JSON, with null for each number that is not finite."""
    if isinstance(content, Mapping):
        return {str(name): _with_null_for_non_finite(value) for name, value in content.items()}
    if isinstance(content, list | tuple):
        return [_with_null_for_non_finite(value) for value in content]
    if isinstance(content, float) and not math.isfinite(content):
        return None
    return content


def say_files(files: Iterable[Path | None]) -> None:
    """Print the names of `files` that were written, without None and ``-`` among them; nothing where none
    was, nor where ``--quiet`` was given.
    """
    if names := [str(file) for file in files if file is not None and str(file) != STDOUT]:
        say_progress(f"files: {', '.join(names)}")


def summary_lines(summary: FlightSummary) -> list[str]:
    """Return a few lines with the plans, the outcome, the tracking error and the lost ticks."""
    plans = " + ".join(summary.plans) or "no plan"
    rig = f" on {summary.rig}" if summary.rig else ""
    errors = ", ".join(
        f"{axis} {'not flown' if error is None else f'{error:.2f} deg'}"
        for axis, error in summary.rms_error_deg.items()
    )
    link = summary.link
    lines = [
        f"{plans}{rig}: {summary.outcome}, {summary.duration_s:.1f} s",
        f"tracking error (rms): {errors}",
        f"{summary.ticks_logged} ticks logged, {summary.ticks_lost} lost; {link.get('frames_bad', 0)} bad "
        f"frames, {link.get('retries', 0)} retries, {link.get('reconnects', 0)} reconnects",
        *(f"note: {note}" for note in summary.notes),
        *(f"warning: {finding.text}" for finding in summary.findings),
    ]
    return [printable(line) for line in lines]
