"""Goals: one table with a count, a total and a required share in each line."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from heli_benchmark.scoring.judge import RANDOM_TORQUE, Row
from heli_benchmark.scoring.reliability import holds, reliability

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
    goal = _share_goal(flags, share, wanted, False, reached)
    if borderline_cases:
        goal["borderline"] = {"count": sum(borderline_cases), "of": len(borderline_cases)}
    return goal


def _at_most(flags: Sequence[bool], wanted: float) -> dict[str, Any]:
    """Return the goal that at most the share `wanted` of the `flags` is true."""
    share = sum(flags) / max(len(flags), 1)
    return _share_goal(flags, share, wanted, True, share <= wanted)


def _share_goal(
    flags: Sequence[bool], share: float, wanted: float | None, at_most: bool, reached: bool | None
) -> dict[str, Any]:
    """Return one goal as `goals` describes it; `at_most` says on which side of `wanted` the share must be."""
    counts = {"count": sum(flags), "of": len(flags), "share": share}
    return counts | {"wanted": wanted, "at_most": at_most, "reached": reached}
