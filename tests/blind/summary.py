"""All cases together, for people: confusion table, misses, reliability, goals."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from tests.blind.goals import further, goals, table
from tests.blind.judge import SEEN, Row
from tests.blind.reliability import holds, reliability


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
            answer = f"{answer} ({_faint(row)})"
        counts[answer] += 1
    return {hidden: dict(counts) for hidden, counts in sorted(table.items())}


def text(rows: Sequence[Row]) -> str:
    """Write everything for people.

    Parameters
    ----------
    rows : sequence of Row
        Judged cases.

    Returns
    -------
    str
        Confusion table, reliability, misses and goals.
    """
    lines = ["", "hidden: what was said first, and how often"]
    for hidden, counts in confusion(rows).items():
        said = ", ".join(f"{answer} {n}" for answer, n in sorted(counts.items(), key=lambda one: -one[1]))
        lines.append(f"  {hidden:44s} {said}")
    lines += ["", "misses"]
    for row in rows:
        line = _miss(row)
        if line:
            lines.append(f"  {row.case} (seed {row.seed}): {line}")
    lines += ["", "confidence   causes   mean   right   within the bounds of chance"]
    for one in reliability(rows):
        said = (
            f"{one['least']:.0f} to {one['most']:.0f}: {'yes' if holds(one) else 'NO'}"
            if one["causes"]
            else "-"
        )
        lines.append(
            f"  {one['from']:.2f}-{one['to']:.2f}  {one['causes']:6.0f}   {one['mean_confidence']:.2f}   "
            f"{one['right']:5.0f}   {said}"
        )
    lines += ["", "besides", *table(further(rows))]
    lines += ["", f"goals, {len(rows)} cases, {_minutes(rows)}", *table(goals(rows))]
    return "\n".join(lines)


def _minutes(rows: Sequence[Row]) -> str:
    return f"{sum(row.cpu_seconds for row in rows) / 60.0:.0f} minutes of CPU in the diagnosis"


def _faint(row: Row) -> str:
    return f"counted apart, below {SEEN:g} standard deviations" if row.apart else "too small to be seen"


def _miss(row: Row) -> str:
    if row.failure:
        return f"died: {row.failure}"
    said = f"{row.verdict}: {', '.join(row.named) or 'no cause'}"
    if not row.right:
        note = "" if row.fair else f" ({_faint(row)})"
        return f"said {said}{note}"
    parts = []
    if row.kind in ("one", "several"):
        if row.verdict == "explained":
            parts.append("though the verdict is explained")
        if row.false_names:
            parts.append(f"besides {', '.join(row.false_names)}")
        if row.missed:
            parts.append(f"without {', '.join(row.missed)}")
    parts += [
        f"{name} = {value:.4g} +- {std:.2g}, truth {truth:.4g}"
        for name, (value, std, truth) in row.parameters.items()
        if not row.within[name]
    ]
    return "; ".join(parts)
