"""Causes of a change of state in words for the page: "no setpoint arrived" instead of ``stale_land``."""

from __future__ import annotations

import re

from heli_host.declaration import Trigger

CAUSE_WORDS: dict[Trigger, str] = {
    Trigger.ARM: "the drivers were switched on",
    Trigger.STOP: "a stop",
    Trigger.CLOSE_LOOP: "the control loops were closed",
    Trigger.OPEN_LOOP: "fixed voltages were commanded",
    Trigger.STREAM: "a program streams the voltages",
    Trigger.LAND: "a landing was commanded",
    Trigger.SETPOINT_FRESH: "setpoints came back",
    Trigger.STALE_HOLD: "no setpoint arrived",
    Trigger.STALE_LAND: "no setpoint arrived for too long",
    Trigger.TOUCHDOWN: "the arm rests on the table",
    Trigger.TRIP: "a fault",
    Trigger.CLEAR: "the fault was cleared",
    Trigger.AXIS_LOST: "a fault of travel alone",
    Trigger.START: "the board has started",
}
_WITHOUT_SETPOINTS = frozenset((Trigger.STALE_HOLD, Trigger.STALE_LAND))
_CAUSE = re.compile(r", because of (\w+)")
_STATE = re.compile(r"\bstate \w+")


def is_without_setpoints(text: str) -> bool:
    """Return whether the text of an event names missing setpoints as the cause."""
    return any(_trigger_named(name) in _WITHOUT_SETPOINTS for name in _CAUSE.findall(text))


def cause(text: str, absence: str = "") -> str:
    """Return the cause that the text of an event names, in words; empty if it names none."""
    names = _CAUSE.findall(text)
    return _trigger_in_words(names[0], absence) if names else ""


def in_words(text: str, absence: str = "") -> str:
    """Return the text of an event with its cause in words.

    Examples
    --------
    >>> in_words("state hold, because of stale_hold", "the pilot's page was closed")
    "state hold: the pilot's page was closed"
    """
    with_cause = _CAUSE.sub(lambda match: f": {_trigger_in_words(match[1], absence)}", text)
    return _STATE.sub(lambda match: match[0].replace("_", " "), with_cause)


def _trigger_named(name: str) -> Trigger | None:
    return Trigger.__members__.get(name.upper())


def _trigger_in_words(name: str, absence: str) -> str:
    """Return a trigger in words; one that means "no setpoint arrived" becomes `absence`."""
    trigger = _trigger_named(name)
    if trigger is None:
        return name.replace("_", " ")
    return absence if absence and trigger in _WITHOUT_SETPOINTS else CAUSE_WORDS[trigger]
