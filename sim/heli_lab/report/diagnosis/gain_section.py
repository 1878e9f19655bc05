"""Section of the page about the gain of the extended model over the baseline on validation flights."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from heli_lab.explain.wording import display_unit
from heli_lab.report.diagnosis.cause_sections import plus_minus


def gain_rows(gain: Mapping[str, Mapping[str, Any]]) -> list[list[str]]:
    """Return a table row for each axis: errors before and after [deg], their ratio and its 95 % interval."""
    return [
        [
            axis,
            f"{reduction['before']:.3g}",
            f"{reduction['after']:.3g}",
            f"{reduction['ratio']:.2f}",
            f"{reduction['interval95'][0]:.2f} to {reduction['interval95'][1]:.2f}",
        ]
        for axis, reduction in gain.items()
    ]


def calibration_tables(flights: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """Return a table for each calibrated validation flight, with the zeros and constant torques of baseline
    and extended model.
    """
    tables = []
    for flight in flights:
        if not flight["after"]:
            continue
        rows = []
        for name, after in flight["after"].items():
            unit = after["unit"]
            cells = [name]
            for constant in (flight["before"][name], after):
                cells += [plus_minus(constant["prior"], unit), plus_minus(constant, unit)]
            rows.append([*cells, display_unit(unit)[1]])
        note = (
            f"{flight['flight']}: zeros and constant torques from its first "
            f"{flight['calibrated_s']:.1f} s of free flight; "
            f"the next {flight['evaluated_s']:.1f} s are evaluated."
        )
        tables.append({"rows": rows, "note": note})
    return tables
