"""The goals: one table, each line how many of how many, and what is wanted."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

from tests.blind.judge import CHANCE, Row
from tests.blind.reliability import holds, reliability

SURE = 0.7
"""Confidence from which on a false name is never forgiven."""
NEAR = 1.10
"""On clean flights the held-out error may be this many times that of the fit that is told the answer."""


def goals(rows: Sequence[Row]) -> dict[str, dict[str, Any]]:
    """Count how far the goals are reached.

    Parameters
    ----------
    rows : sequence of Row
        Judged cases.

    Returns
    -------
    dict
        For each goal ``count`` of ``of`` and their ``share``, what is ``wanted`` and whether it is
        ``reached``; None where nothing is wanted or nothing was counted. ``apart`` has the same counts for
        the cases that only a very good test would see.
    """
    clean, windy = _split(rows)
    named_windy = [row for row in windy if row.kind in ("one", "several")]
    off_windy = [row for row in windy if row.kind == "off_list"]
    false_windy = [sure for row in windy for _, right, sure in row.answers if not right]
    alarms = [not row.right for row in clean if row.kind == "nothing"]
    false_names = [bool(row.false_names) for row in windy]
    bins = [holds(one) for one in reliability(rows) if one["causes"]]
    return {
        "clean: named first": _least(_right(clean, "one", "several"), 0.97),
        "clean: false alarms on nothing hidden": _most(alarms, 0.0),
        "weather: every cause named": _least(_right(named_windy), 0.95, _faint(named_windy)),
        "weather: false names with confidence 0.7 or more": _most([s >= SURE for s in false_windy], 0.0),
        "weather: cases with any false name": _most(false_names, 0.03),
        "weather: nothing hidden is explained": _least(_right(windy, "nothing"), 0.95),
        "weather: off-list is unexplained": _least(_right(off_windy), 0.95, _faint(off_windy)),
        "numbers within 2 standard errors": _least(_within(rows), 0.93),
        "confidence: bins within their binomial bounds": _least(bins, 1.0),
    }


def further(rows: Sequence[Row]) -> dict[str, dict[str, Any]]:
    """Count what no goal is but a reader asks next.

    Parameters
    ----------
    rows : sequence of Row
        Judged cases.

    Returns
    -------
    dict
        As `goals` has it.
    """
    clean, windy = _split(rows)
    fair = [row for row in clean if row.kind in ("one", "several") and row.fair]
    fair_windy = [row for row in windy if row.kind in ("one", "several") and row.fair]
    causes = [name in row.found for row in windy for name in row.visible if not name.startswith("off-")]
    near = [
        row.errors["found"] <= NEAR * row.errors["told"]
        for row in fair
        if not any(name.startswith(CHANCE) for name in row.hidden)
    ]
    found_windy = [row.verdict == "cause_found" for row in fair_windy]
    return {
        "clean: off-list called unexplained": _least(_right(clean, "off_list")),
        "clean: every visible cause named": _least([not row.missed for row in fair]),
        "clean: nothing named that is not there": _least([not row.false_names for row in fair]),
        "clean: held-out error within 10 % of the fit told the answer": _least(near),
        "clean: numbers within 2 standard errors": _least(_within(clean)),
        "weather: numbers within 2 standard errors": _least(_within(windy)),
        "weather: visible causes named, one by one": _least(causes),
        "weather: cause_found where causes are hidden": _least(found_windy),
        "diagnosis died": _most([bool(row.failure) for row in rows], 0.0),
    }


def table(found: dict[str, dict[str, Any]]) -> list[str]:
    """Write goals as lines.

    Parameters
    ----------
    found : dict
        As `goals` gives them.

    Returns
    -------
    list of str
        One a goal.
    """
    lines = []
    for name, one in found.items():
        share = f"{one['share']:.1%}" if one["of"] else "-"
        wanted, mark = "", ""
        if one["wanted"] is not None:
            wanted = f"{'<=' if one['at_most'] else '>='} {one['wanted']:.0%}"
            mark = {True: "reached", False: "MISSED", None: "nothing counted"}[one["reached"]]
        beside = one.get("apart")
        apart = f"; apart {beside['count']} of {beside['of']}" if beside and beside["of"] else ""
        counts = f"{one['count']:4d} of {one['of']:4d}  {share:>6s}"
        lines.append(f"  {name:61s} {counts}  {wanted:8s} {mark}{apart}".rstrip())
    return lines


def _split(rows: Iterable[Row]) -> tuple[list[Row], list[Row]]:
    """Clean cases and those in weather."""
    found: tuple[list[Row], list[Row]] = ([], [])
    for row in rows:
        found[bool(row.disturbances)].append(row)
    return found


def _right(rows: Iterable[Row], *kinds: str) -> list[bool]:
    return [row.right for row in rows if row.fair and (not kinds or row.kind in kinds)]


def _faint(rows: Iterable[Row]) -> list[bool]:
    return [row.right for row in rows if row.apart]


def _within(rows: Iterable[Row]) -> list[bool]:
    return [ok for row in rows for ok in row.within.values()]


def _least(flags: Sequence[bool], wanted: float | None = None, apart: Sequence[bool] = ()) -> dict[str, Any]:
    share = sum(flags) / max(len(flags), 1)
    reached = None if wanted is None or not flags else share >= wanted
    beside = {"apart": {"count": sum(apart), "of": len(apart)}} if apart else {}
    return _line(flags, share, wanted, False, reached) | beside


def _most(flags: Sequence[bool], wanted: float) -> dict[str, Any]:
    share = sum(flags) / max(len(flags), 1)
    return _line(flags, share, wanted, True, share <= wanted)


def _line(
    flags: Sequence[bool], share: float, wanted: float | None, at_most: bool, reached: bool | None
) -> dict[str, Any]:
    counts = {"count": sum(flags), "of": len(flags), "share": share}
    return counts | {"wanted": wanted, "at_most": at_most, "reached": reached}
