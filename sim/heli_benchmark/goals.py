"""Results over all cases: calibration, goals with a required share, and a summary as text."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from heli_host.data.files import save_figure
from scipy.special import bdtr

from heli_benchmark.judge import MIN_VISIBILITY_STD, RANDOM_TORQUE, Row

BINS = (0.0, 0.5, 0.7, 0.85, 0.95, 1.0)
"""Bounds of the five bins."""
_OUTSIDE_PROBABILITY = 0.05
"""Probability that a bin of a calibrated diagnosis is outside of its bounds, both sides together."""


def reliability(rows: Sequence[Row]) -> list[dict[str, float]]:
    """Compare confidence with the share of right causes."""
    causes = [cause for row in rows for cause in row.answers]
    curve = []
    for low, high in pairwise(BINS):
        # The last bin includes its upper end, 1.
        end = np.inf if high == 1.0 else high
        in_bin = [cause for cause in causes if low <= cause.confidence < end]
        cause_count, hidden_count = len(in_bin), sum(cause.is_hidden for cause in in_bin)
        mean = sum(cause.confidence for cause in in_bin) / cause_count if cause_count else 0.5 * (low + high)
        curve.append(
            {
                "from": low,
                "to": high,
                "causes": cause_count,
                "mean_confidence": mean,
                "right": hidden_count,
                "share_right": hidden_count / cause_count if cause_count else mean,
                "least": _quantile(_OUTSIDE_PROBABILITY / 2.0, cause_count, mean),
                "most": _quantile(1.0 - _OUTSIDE_PROBABILITY / 2.0, cause_count, mean),
            }
        )
    return curve


def _quantile(share: float, count: int, mean: float) -> int:
    """Return the quantile `share` of a binomial distribution of `count` trials with success rate `mean`."""
    # scipy.stats also has this quantile, but its import takes a second of CPU time.
    return int(np.searchsorted(bdtr(np.arange(count + 1), count, mean), share))


def holds(bin_: dict[str, float]) -> bool:
    """Return whether a bin of `reliability` is within its bounds; an empty `bin_` is."""
    return bin_["least"] <= bin_["right"] <= bin_["most"]


def draw(curve: Sequence[dict[str, float]], path: Path) -> None:
    """Draw the reliability diagram."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.2, 4.0), layout="constrained")
    axes = figure.subplots()
    axes.plot([0, 1], [0, 1], color="0.7", lw=1)
    for confidence_bin in curve:
        if not confidence_bin["causes"]:
            continue
        count, mean = confidence_bin["causes"], confidence_bin["mean_confidence"]
        low, high = confidence_bin["least"] / count, confidence_bin["most"] / count
        axes.plot([mean, mean], [low, high], color="0.6", lw=6, solid_capstyle="butt")
        axes.plot(mean, confidence_bin["share_right"], "o", color="C0" if holds(confidence_bin) else "C3")
        axes.annotate(
            f"{count:.0f}", (mean, confidence_bin["share_right"]), (5, -10), textcoords="offset points"
        )
    axes.set(xlabel="confidence given", ylabel="share that is right", xlim=(-0.03, 1.03), ylim=(-0.03, 1.03))
    axes.set_title("grey: range of 95 % of calibrated bins; numbers: causes", fontsize=8)
    save_figure(figure, path, dpi=110)


CONFIDENT = 0.7
"""Confidence from which a false name counts as confident."""
MAX_ERROR_RATIO = 1.10
"""Largest ratio of held-out errors, diagnosis to fit with the true causes, on clean flights."""


def goals(rows: Sequence[Row]) -> dict[str, dict[str, Any]]:
    """Count the results for each goal."""
    clean, disturbed = _clean_and_disturbed(rows)
    with_causes = [row for row in disturbed if row.kind in ("one", "several")]
    unlisted = [row for row in disturbed if row.kind == "off_list"]
    false_confidences = [name.confidence for row in disturbed for name in row.answers if not name.is_hidden]
    alarms = [not row.right for row in clean if row.kind == "nothing"]
    false_names = [bool(row.false_names) for row in disturbed]
    bins = [holds(confidence_bin) for confidence_bin in reliability(rows) if confidence_bin["causes"]]
    return {
        "clean: named first, or listed as too small": _at_least(
            _is_right_by_case(clean, "one", "several"), 0.97
        ),
        "clean: false alarms on nothing hidden": _at_most(alarms, 0.0),
        "disturbed: every cause named": _at_least(
            _is_right_by_case(with_causes), 0.95, _is_right_by_borderline_case(with_causes)
        ),
        "disturbed: false names with confidence 0.7 or more": _at_most(
            [confidence >= CONFIDENT for confidence in false_confidences], 0.0
        ),
        "disturbed: cases with any false name": _at_most(false_names, 0.03),
        "disturbed: nothing hidden is explained": _at_least(_is_right_by_case(disturbed, "nothing"), 0.95),
        "disturbed: unlisted is unexplained": _at_least(
            _is_right_by_case(unlisted), 0.95, _is_right_by_borderline_case(unlisted)
        ),
        "numbers within 2 standard errors": _at_least(_estimates_right(rows), 0.93),
        "confidence: bins within their binomial bounds": _at_least(bins, 1.0),
    }


def further_counts(rows: Sequence[Row]) -> dict[str, dict[str, Any]]:
    """Count further results, without a requirement."""
    clean, disturbed = _clean_and_disturbed(rows)
    visible_clean = [row for row in clean if row.kind in ("one", "several") and row.counts]
    visible_disturbed = [row for row in disturbed if row.kind in ("one", "several") and row.counts]
    is_named = [
        name in row.named_correctly
        for row in disturbed
        for name in row.visible
        if not name.startswith("off-")
    ]
    predicts_well = [
        row.errors["found"] <= MAX_ERROR_RATIO * row.errors["informed"]
        for row in visible_clean
        if not any(name.startswith(RANDOM_TORQUE) for name in row.hidden)
    ]
    cause_found = [row.verdict == "cause_found" for row in visible_disturbed]
    return {
        "clean: unlisted called unexplained": _at_least(_is_right_by_case(clean, "off_list")),
        "clean: listed as too small": _at_least([row.listed_as_too_small for row in visible_clean]),
        "clean: every visible cause named": _at_least([not row.missed for row in visible_clean]),
        "clean: nothing named that is not there": _at_least([not row.false_names for row in visible_clean]),
        "clean: held-out error within 10 % of the fit with the true causes": _at_least(predicts_well),
        "clean: numbers within 2 standard errors": _at_least(_estimates_right(clean)),
        "disturbed: numbers within 2 standard errors": _at_least(_estimates_right(disturbed)),
        "disturbed: visible causes named, one by one": _at_least(is_named),
        "disturbed: cause_found where causes are hidden": _at_least(cause_found),
        "diagnosis failed": _at_most([bool(row.failure) for row in rows], 0.0),
    }


def table(goals: dict[str, dict[str, Any]]) -> list[str]:
    """Format goals as lines."""
    lines = []
    for name, goal in goals.items():
        share = f"{goal['share']:.1%}" if goal["of"] else "-"
        wanted_text, mark_text = "", ""
        if goal["wanted"] is not None:
            wanted_text = f"{'<=' if goal['at_most'] else '>='} {goal['wanted']:.0%}"
            mark_text = {True: "reached", False: "MISSED", None: "nothing counted"}[goal["reached"]]
        cases = goal.get("borderline")
        borderline = f"; borderline {cases['count']} of {cases['of']}" if cases and cases["of"] else ""
        counts = f"{goal['count']:4d} of {goal['of']:4d}  {share:>6s}"
        lines.append(f"  {name:61s} {counts}  {wanted_text:8s} {mark_text}{borderline}".rstrip())
    return lines


def _clean_and_disturbed(rows: Iterable[Row]) -> tuple[list[Row], list[Row]]:
    """Split rows into clean and disturbed cases."""
    rows_by_disturbance: tuple[list[Row], list[Row]] = ([], [])
    for row in rows:
        rows_by_disturbance[bool(row.disturbances)].append(row)
    return rows_by_disturbance


def _is_right_by_case(rows: Iterable[Row], *kinds: str) -> list[bool]:
    """Return for each case that counts whether its answer is right; only cases of `kinds`, if given."""
    return [row.right for row in rows if row.counts and (not kinds or row.kind in kinds)]


def _is_right_by_borderline_case(rows: Iterable[Row]) -> list[bool]:
    """Return for each borderline case whether its answer is right."""
    return [row.right for row in rows if row.is_borderline]


def _estimates_right(rows: Iterable[Row]) -> list[bool]:
    """Return for each estimate of all cases whether it agrees with the truth."""
    return [is_right for row in rows for is_right in row.within.values()]


def _at_least(
    flags: Sequence[bool], wanted: float | None = None, borderline_cases: Sequence[bool] = ()
) -> dict[str, Any]:
    """Return the goal that at least the share `wanted` of the `flags` is true; without `wanted`, a count."""
    share = sum(flags) / max(len(flags), 1)
    reached = None if wanted is None or not flags else share >= wanted
    goal = _share_goal(flags, share, wanted, at_most=False, reached=reached)
    if borderline_cases:
        goal["borderline"] = {"count": sum(borderline_cases), "of": len(borderline_cases)}
    return goal


def _at_most(flags: Sequence[bool], wanted: float) -> dict[str, Any]:
    """Return the goal that at most the share `wanted` of the `flags` is true."""
    share = sum(flags) / max(len(flags), 1)
    return _share_goal(flags, share, wanted, at_most=True, reached=share <= wanted)


def _share_goal(
    flags: Sequence[bool], share: float, wanted: float | None, at_most: bool, reached: bool | None
) -> dict[str, Any]:
    """Return one goal as `goals` describes it; `at_most` says on which side of `wanted` the share must be."""
    counts = {"count": sum(flags), "of": len(flags), "share": share}
    return counts | {"wanted": wanted, "at_most": at_most, "reached": reached}


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
