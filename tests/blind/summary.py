"""All cases together: goals, confusion table, calibration curve."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Any

from tests.blind.judge import Row

BINS = (0.0, 0.5, 0.7, 0.85, 0.95, 1.0)
NEAR = 1.10
"""The held-out error may be this many times that of the fit that is told the answer."""


def goals(rows: Sequence[Row]) -> dict[str, dict[str, Any]]:
    """Count how far the goals are reached.

    Parameters
    ----------
    rows : sequence of Row
        Judged cases.

    Returns
    -------
    dict
        For each goal how many of how many, and what is wanted.
    """
    ran = [row for row in rows if not row.failure]
    named = [row for row in rows if row.kind in ("one", "several") and row.fair]
    several = [row for row in named if row.kind == "several"]
    within = [ok for row in ran for ok in row.within.values()]
    near = [
        row.errors["found"] <= NEAR * row.errors["told"]
        for row in named
        if not any(name.startswith("random_torque") for name in row.hidden)
    ]
    return {
        "cause named first": _of((row.right for row in named), 0.95),
        "false alarms on nothing hidden": _of((not row.right for row in ran if row.kind == "nothing"), 0.0),
        "off-list called unexplained": _of(
            (row.right for row in rows if row.kind == "off_list" and row.fair), 0.90
        ),
        "parameter within 3 std": _of(within, 0.90),
        "held-out error within 10 % of the fit told the answer": _of(near, 1.0),
        "nothing named that is not there": _of((not row.spurious for row in named), None),
        "all of several named": _of((not row.missed for row in several), None),
        "given with confidence 0.9 and right": _of(
            (name in row.hidden for row in ran for name, sure in _sure(row) if sure >= 0.9), 0.90
        ),
        "diagnosis died": _of((bool(row.failure) for row in rows), 0.0),
    }


def confusion(rows: Sequence[Row]) -> dict[str, dict[str, int]]:
    """Count what was said first about what was hidden.

    Parameters
    ----------
    rows : sequence of Row
        Judged cases.

    Returns
    -------
    dict of dict of int
        By what was hidden, then by answer.
    """
    table: dict[str, Counter[str]] = {}
    for row in rows:
        counts = table.setdefault(" + ".join(row.hidden) or "nothing", Counter())
        answer = "died" if row.failure else row.answer
        if not row.failure and row.right and row.kind in ("one", "several"):
            answer = "right, ambiguous" if row.verdict == "ambiguous" else "right"
            if row.verdict == "unexplained":
                answer = "right, and more that is unexplained"
        elif not row.failure and row.right:
            answer = "right"
        elif not row.fair:
            answer = f"{answer} (too small to be seen)"
        counts[answer] += 1
    return {hidden: dict(counts) for hidden, counts in sorted(table.items())}


def calibration(rows: Sequence[Row]) -> list[dict[str, float]]:
    """Compare confidence with how often it was right.

    Parameters
    ----------
    rows : sequence of Row
        Judged cases, those with nothing or something off the list hidden included.

    Returns
    -------
    list of dict
        For each bin its bounds, number of causes, mean confidence and share that is right.
    """
    given = [(sure, name in row.hidden) for row in rows for name, sure in _sure(row)]
    curve = []
    for low, high in pairwise(BINS):
        inside = [
            (sure, right) for sure, right in given if low <= sure < high or (sure == high and high == 1.0)
        ]
        if inside:
            curve.append(
                {
                    "from": low,
                    "to": high,
                    "causes": len(inside),
                    "mean_confidence": sum(sure for sure, _ in inside) / len(inside),
                    "share_right": sum(right for _, right in inside) / len(inside),
                }
            )
    return curve


def text(rows: Sequence[Row]) -> str:
    """Write everything for people.

    Parameters
    ----------
    rows : sequence of Row
        Judged cases.

    Returns
    -------
    str
        Confusion table, calibration curve, misses and goals.
    """
    lines = ["", "hidden: what was said first, and how often"]
    for hidden, counts in confusion(rows).items():
        said = ", ".join(f"{answer} {n}" for answer, n in sorted(counts.items(), key=lambda one: -one[1]))
        lines.append(f"  {hidden:44s} {said}")
    lines += ["", "confidence   causes   mean   right"]
    for one in calibration(rows):
        lines.append(
            f"  {one['from']:.2f}-{one['to']:.2f}  {one['causes']:6d}   {one['mean_confidence']:.2f}   "
            f"{one['share_right']:.2f}"
        )
    lines += ["", "misses"]
    for row in rows:
        line = _miss(row)
        if line:
            lines.append(f"  {row.case} (seed {row.seed}): {line}")
    lines += ["", "goals"]
    for name, one in goals(rows).items():
        wanted = "" if one["wanted"] is None else f", wanted {one['wanted']:.0%}"
        lines.append(f"  {name}: {one['count']} of {one['of']} ({one['share']:.0%}{wanted})")
    return "\n".join(lines)


def _sure(row: Row) -> Iterable[tuple[str, float]]:
    return zip(row.named, row.confidence, strict=True)


def _of(flags: Iterable[bool], wanted: float | None) -> dict[str, Any]:
    found = list(flags)
    return {"count": sum(found), "of": len(found), "share": sum(found) / max(len(found), 1), "wanted": wanted}


def _miss(row: Row) -> str:
    if row.failure:
        return f"died: {row.failure}"
    said = f"{row.verdict}: {', '.join(row.named) or 'no cause'}"
    if not row.right:
        note = "" if row.fair else " (too small to be seen)"
        return f"said {said}{note}"
    parts = []
    if row.kind in ("one", "several"):
        if row.verdict == "explained":
            parts.append("though the verdict is explained")
        if row.spurious:
            parts.append(f"besides {', '.join(row.spurious)}")
        if row.missed:
            parts.append(f"without {', '.join(row.missed)}")
    parts += [
        f"{name} = {value:.4g} +- {std:.2g}, truth {truth:.4g}"
        for name, (value, std, truth) in row.parameters.items()
        if not row.within[name]
    ]
    return "; ".join(parts)
