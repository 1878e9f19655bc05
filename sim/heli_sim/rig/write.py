"""Writes rigs as files that `load_rig` reads."""

from __future__ import annotations

import textwrap
from pathlib import Path

from heli_host.data.files import toml_string, write_signed

from heli_sim.rig.rig import Number, Rig

_DIGITS = 7


def rig_text(rig: Rig, comment: str = "", digits: int = _DIGITS) -> str:
    """Return a rig as TOML after a `comment`, with `digits` significant digits; 17 keep each number
    exactly.
    """
    lines = [f"# {line}" for line in textwrap.wrap(comment, 108)]
    lines += [f"name = {toml_string(rig.name)}", f"description = {toml_string(rig.description)}"]
    if rig.model:
        lines.append(f"model = {toml_string(rig.model)}")
    for name, number in rig.items():
        lines += _lines_of_number(name, number, digits)
    for effect, numbers in rig.effects.items():
        for short_name, number in numbers.items():
            lines += _lines_of_number(f"effects.{toml_string(effect)}.{short_name}", number, digits)
    return "\n".join(lines) + "\n"


def _lines_of_number(name: str, number: Number, digits: int) -> list[str]:
    """Return the lines of a number in a rig file."""
    return [
        "",
        f"[{name}]",
        f"value = {number.value:.{digits}g}",
        f"unit = {toml_string(number.unit)}",
        f"tolerance = {number.tolerance:.{digits}g}",
        f"source = {toml_string(number.source)}",
    ]


def write_rig(rig: Rig, path: str | Path, comment: str = "") -> None:
    """Write a rig into the file at `path`, under a `comment`."""
    write_signed(path, rig_text(rig, comment))
