"""The messages of a twin, such as alarms, and their texts."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from heli_lab.watch.twin.likelihood_ratio import ChangeCandidate

NOT_THIS_MODEL: Final = "not this model from the start"
_MAX_REPORTED_ODDS: Final = 1000.0
"""Odds above which no number is reported: such odds hold only if the catalogue contains the true cause."""


@dataclass(frozen=True)
class TwinEvent:
    """A message of the twin."""

    kind: str
    """``free`` when it begins to compare, ``waits`` when it pauses, ``alarm`` when the rig has changed,
    ``diagnosed`` with the final ranking. ``contradicts`` when the flight contradicts the model from the
    start, so that no change is named. ``glitch`` when an encoder jumped and returned. ``unjudged`` when
    the flight first leaves the voltages of the nominal flights."""
    t_s: float  # Time of the message on the clock of the samples minus its zero [s]
    text: str  # Message for people
    ranking: tuple[ChangeCandidate, ...] = ()
    """For ``alarm`` and ``diagnosed``: possible changes, the most likely first."""
    onset_s: float = math.nan  # Time at which the most likely change began [s]; nan for the other kinds


def format_ranking(ranking: Sequence[ChangeCandidate], onset_s: float) -> str:
    """Describe the first change of a `ranking`, its onset (`onset_s`, s), and its odds against the second."""
    first, second = ranking[:2]
    odds = math.exp(min(first.log_evidence - second.log_evidence, 50.0))
    odds_text = f"{odds:.0f} times" if odds < _MAX_REPORTED_ODDS else f"over {_MAX_REPORTED_ODDS:.0f} times"
    if odds < 1.5:
        second_text = f"equally likely: {second.change.words(second.size, second.std)}"
    else:
        second_text = f"{odds_text} more likely than the next change ({second.change.id})"
    return f"{first.change.words(first.size, first.std)} since {onset_s:.1f} s; {second_text}"


def ranked_event(
    kind: str, t_s: float, alarm_s: float, ranking: tuple[ChangeCandidate, ...], onset_s: float
) -> TwinEvent:
    """Return the event `kind` at `t_s` of the alarm at `alarm_s`, with the ranking of the changes; the first
    of them began at `onset_s` (all times in s).
    """
    text = f"alarm at {alarm_s:.1f} s. Most likely: {format_ranking(ranking, onset_s)}."
    return TwinEvent(kind, t_s, text, ranking, onset_s)


def contradiction_event(t_s: float, calibration_s: float, reason: str) -> TwinEvent:
    """Return the event at `t_s` that the first `calibration_s` of a flight contradict the model (times in s);
    `reason` states how.
    """
    text = f"{NOT_THIS_MODEL}: in the first {calibration_s:g} s, {reason}; no change is named"
    return TwinEvent("contradicts", t_s, text)
