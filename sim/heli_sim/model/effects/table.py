"""Write the table of docs/reference/effects.md: ``python -m heli_sim.model.effects.table``."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import Final

from heli_sim.model.effects.catalogue import catalogue
from heli_sim.model.effects.spec import EffectSpec, Parameter

BEGIN: Final = "<!-- table of effects, written by python -m heli_sim.model.effects.table -->"
END: Final = "<!-- end of the table -->"
_HEAD: Final = "| effect | in words | equation | numbers: unit, range, typical |\n|---|---|---|---|"


def table() -> str:
    """Return the table in Markdown, one row per effect."""
    return "\n".join([_HEAD, *(_row_of_effect(kind) for kind in catalogue().values())])


def with_table(text: str) -> str:
    """Replace the table between its marks in a document's `text` by the present one. A ValueError when a mark
    is missing.
    """
    before, _, rest = text.partition(BEGIN)
    _, mark, after = rest.partition(END)
    if not mark:
        raise ValueError(f"the document lacks {BEGIN} or {END}; add them")
    return f"{before}{BEGIN}\n{table()}\n{END}{after}"


def _row_of_effect(kind: EffectSpec) -> str:
    equation = kind.equation.replace("|", r"\vert ")
    numbers = "; ".join(_parameter_text(parameter) for parameter in kind.numbers)
    return f"| `{kind.id}` | {kind.describe(kind.typical)} | ${equation}$ | {numbers} |"


def _parameter_text(parameter: Parameter) -> str:
    """Describe a parameter of an effect: meaning, unit, range and typical value."""
    low, high = (
        (parameter.prior.low, parameter.prior.high) if parameter.prior is not None else (math.nan, math.nan)
    )
    unit = "" if parameter.unit == "1" else f" {parameter.unit}"
    bounds = "fixed" if parameter.prior is None else f"{_bound_text(low, '-')} to {_bound_text(high, '')}"
    grid = ", grid" if parameter.grid is not None else ""
    return f"`{parameter.name}` {parameter.meaning}:{unit} {bounds}{grid}, {parameter.typical:g}"


def _bound_text(value: float, sign: str) -> str:
    return f"{value:g}" if math.isfinite(value) else f"{sign}any"


def main(path: str = "docs/reference/effects.md") -> None:
    """Write the table into the document at `path`."""
    document = Path(path)
    document.write_text(with_table(document.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
