"""Results of all cases as text: confusion table, misses, calibration, goals."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

from heli_benchmark.scoring.goals import further_counts, goals, table
from heli_benchmark.scoring.judge import MIN_VISIBILITY_STD, Row
from heli_benchmark.scoring.reliability import holds, reliability


def confusion(rows: Sequence[Row]) -> dict[str, dict[str, int]]:
    """Count the first answers by what was hidden."""
    table: dict[str, Counter[str]] = {}
    for row in rows:
        counts = table.setdefault(" + ".join(row.hidden) or "nothing", Counter())
        counts[_answer_label(row)] += 1
    return {hidden: dict(counts) for hidden, counts in sorted(table.items())}


def _answer_label(row: Row) -> str:
    """Return what the confusion table calls an answer: right, if so with its doubt, or the first name."""
    if row.right and not row.failure:
        has_causes = row.kind in ("one", "several")
        if has_causes and row.verdict == "unexplained":
            return "right, but unexplained"
        if has_causes and row.verdict == "ambiguous":
            return "right, ambiguous"
        return "right"
    answer = "failed" if row.failure else row.answer
    return answer if row.counts else f"{answer} ({_reason_not_counted(row)})"


def text(rows: Sequence[Row]) -> str:
    """Format all results as text."""
    lines = ["", "hidden: first answers and their number"]
    for hidden, counts in confusion(rows).items():
        answers = ", ".join(
            f"{answer} {n}" for answer, n in sorted(counts.items(), key=lambda item: -item[1])
        )
        lines.append(f"  {hidden:44s} {answers}")
    lines += ["", "misses"]
    for row in rows:
        line = _miss_text(row)
        if line:
            lines.append(f"  {row.case} (seed {row.seed}): {line}")
    lines += ["", "confidence   causes   mean   right   within binomial bounds"]
    for bin_ in reliability(rows):
        answers = (
            f"{bin_['least']:.0f} to {bin_['most']:.0f}: {'yes' if holds(bin_) else 'NO'}"
            if bin_["causes"]
            else "-"
        )
        lines.append(
            f"  {bin_['from']:.2f}-{bin_['to']:.2f}  {bin_['causes']:6.0f}   {bin_['mean_confidence']:.2f}   "
            f"{bin_['right']:5.0f}   {answers}"
        )
    lines += ["", "further results", *table(further_counts(rows))]
    lines += ["", f"goals, {len(rows)} cases, {_cpu_minutes_text(rows)}", *table(goals(rows))]
    return "\n".join(lines)


def _cpu_minutes_text(rows: Sequence[Row]) -> str:
    return f"{sum(row.cpu_seconds for row in rows) / 60.0:.0f} minutes of CPU in the diagnosis"


def _reason_not_counted(row: Row) -> str:
    """Return why a case does not count."""
    return (
        f"borderline, below {MIN_VISIBILITY_STD:g} standard deviations"
        if row.is_borderline
        else "too small to be visible"
    )


def _miss_text(row: Row) -> str:
    """Describe the answer to a case, and what is wrong with it."""
    if row.failure:
        return f"failed: {row.failure}"
    result = f"{row.verdict}: {', '.join(row.named) or 'no cause'}"
    if not row.right:
        note = "" if row.counts else f" ({_reason_not_counted(row)})"
        return f"{result}{note}"
    parts = []
    if row.kind in ("one", "several"):
        if row.verdict == "explained":
            parts.append("but the verdict is explained")
        if row.false_names:
            parts.append(f"false names {', '.join(row.false_names)}")
        if row.missed:
            parts.append(f"missed {', '.join(row.missed)}")
    parts += [
        f"{name} = {value:.4g} ± {std:.2g}, truth {truth:.4g}"
        for name, (value, std, truth) in row.parameters.items()
        if not row.within[name]
    ]
    return "; ".join(parts)
