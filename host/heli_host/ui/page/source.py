"""The interface between the page's server and its subject, and the words and tables that a page shows.

The subject is a connected board (`heli_host.ui.page.cockpit`) or a replayed log (`heli_host.ui.page.replay`).
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum, auto
from typing import Any, Final, NamedTuple, Protocol

from heli_host.declaration import CHANNELS, FAULTS, PARAMS, Param, ParamSpec, State, Trigger
from heli_host.errors import ParameterError, range_text
from heli_host.link.channels import is_whole, rad_per_count
from heli_host.link.installation import plugins
from heli_host.ui.page.telemetry import TelemetryBuffer

KEPT_S = 600.0
"""Length of the history that a newly opened page shows [s]. It takes 38 MB of memory."""


class BoardState(NamedTuple):
    """Numbers of the board's state and fault, as the page gets them."""

    state: int
    fault: int


UNKNOWN = BoardState(state=255, fault=0)
"""State and fault that mean "no telemetry"; 255 is not the number of a supervisor state."""
News = Callable[[Mapping[str, Any]], None]
_STATE_WORDS: dict[State, str] = {
    State.IDLE: "Motors are off. Take off, or start a plan.",
    State.ARMED: "The drivers are on, at zero voltage.",
    State.CLOSED_LOOP: "It flies: the loops follow the setpoint.",
    State.OPEN_LOOP: "Fixed voltages drive the motors; no loop is closed.",
    State.STREAMED: "A program streams the motors' voltages.",
    State.HOLD: "No setpoint comes: it hovers level, and lands soon unless one does.",
    State.LANDING: "It descends; on the table the motors go off.",
    State.FAULT: "A fault switched the motors off. Remove its cause, then clear it.",
    State.EMERGENCY_LANDING: "It lands because of a fault; travel is not held.",
}
REPLAY_WORDS: dict[State, str] = {
    State.IDLE: "The log shows the motors off.",
    State.ARMED: "The log shows the drivers on, at zero voltage.",
    State.CLOSED_LOOP: "The log shows a flight: the loops follow the setpoint.",
    State.OPEN_LOOP: "The log shows fixed voltages; no loop is closed.",
    State.STREAMED: "The log shows voltages that a program streams.",
    State.HOLD: "The log shows a level hover, because no setpoint arrives.",
    State.LANDING: "The log shows a descent to the table.",
    State.FAULT: "The log shows a fault, which switched the motors off.",
    State.EMERGENCY_LANDING: "The log shows a landing because of a fault; travel is not held.",
}
"""A log is the past: these sentences give no command, and do not claim that a rig flies now."""
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
ENTRY_POINT_GROUP: Final = "heli_host.rigs"
Outline = Callable[[str], Mapping[str, float]]

_WITHOUT_SETPOINTS = frozenset((Trigger.STALE_HOLD, Trigger.STALE_LAND))
_CAUSE = re.compile(r", because of (\w+)")
_STATE = re.compile(r"\bstate \w+")


class Role(Enum):
    """Least role that a client needs for an action."""

    OBSERVER = auto()
    """Every connected client."""
    PILOT = auto()
    """The client that holds the control lease."""
    TUNER = auto()
    """The pilot; also every other client while the pilot shares the tuning of parameters."""


class CommandQueue(Enum):
    """Queue in which an action runs."""

    # Each queue has one thread and runs its actions in order.
    # The queues are independent: an action waits for earlier actions of its own queue only. A stop uses none
    # of them.

    FLIGHT = auto()
    """Actions that take as long as a flight: take off, fly plans."""
    QUICK = auto()
    """Actions that end with one answer of the board, such as a parameter."""
    SETPOINT = auto()
    """Setpoints, which must not wait for a parameter to be written."""


@dataclass(frozen=True)
class Action:
    """A request that a source accepts from clients."""

    run: Callable[[Mapping[str, Any]], Mapping[str, Any]]
    """Called with the request's arguments in the thread of `queue`. The result is merged into the answer to
    the client; a HeliError becomes an error answer."""
    queue: CommandQueue
    role: Role  # Least role of a client that may request it


class Source(Protocol):
    """Subject of a page: a connected board (`Cockpit`) or a replayed log (`Replay`).

    The server calls all methods from its event-loop thread, except `stop`, which it
    calls in the thread of the stop, and `clear_stop`, which it calls in the thread
    of a `CommandQueue`. No method may block.
    """

    buffer: TelemetryBuffer  # Telemetry of the newest `KEPT_S` seconds
    actions: Mapping[str, Action]  # Requests that clients may send, by name

    def describe(self) -> dict[str, Any]:
        """Return the constant facts that each client gets once when it connects, as JSON: kind
        (``simulation``, ``real`` or ``replay``), name of the rig, board, channels, states, faults,
        parameters, limits, plans, laws.
        """
        ...

    def status(self) -> dict[str, Any]:
        """Return the present status as JSON: state, fault, link, recording, flight. Called ten times per
        second.
        """
        ...

    def state(self) -> BoardState:
        """Return the numbers of the board's present state and fault; `UNKNOWN` if no telemetry arrives."""
        ...

    def listen(self, news: News) -> None:
        """Register the callback for events.

        `news`: Called with each event as JSON, from any thread, possibly several threads at a time. It must
        not block.
        """
        ...

    def stop(self) -> None:
        """Send the board the command that switches both motors off, ahead of all other commands.

        The call returns without waiting for the board's answer; the command is repeated until the answer
        comes. An arm in the air falls. From this call on, the source refuses every command that could start
        the motors, until `clear_stop` succeeds. May be called from any thread.
        """
        ...

    def stop_epoch(self) -> int:
        """Return the stop epoch: the number of stops so far.

        The server reads it when a request arrives, and passes it to `clear_stop` before the request runs.
        Therefore a request that arrived before a stop cannot start the motors after it.
        """
        ...

    def clear_stop(self, epoch: int) -> bool:
        """Accept commands again after a stop, if no further stop came since `epoch`.

        Motors stay off: this only permits commands. May be called from any thread.
        """
        ...

    def watch_pilot(self, present: Callable[[], bool], absence: Callable[[], str] = lambda: "") -> None:
        """Send setpoints and voltages to the board only while the pilot's page answers.

        Without setpoints the board itself holds level after ``setpoint_hold_s`` and lands after
        ``setpoint_land_s``, which are parameters of the board in seconds. The motors keep running meanwhile.

        `present`: True while the pilot's page has answered within `heli_host.ui.page.clients.PRESENT_S`
        seconds. Called before each setpoint and each pair of voltages, with the link's lock held: it must not
        block.
        """
        ...


def number(arguments: Mapping[str, Any], name: str) -> float:
    """Return the numeric argument `name` of a request as a finite float."""
    value = arguments.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ParameterError(f"{name} is not a number", "give a number")
    return finite(name, value)


def finite(name: str, value: float) -> float:
    """Convert a number to a finite float."""
    try:
        converted = float(value)
    except OverflowError:
        converted = math.inf if value > 0 else -math.inf
    if not math.isfinite(converted):
        raise ParameterError(f"{name} is {converted}, not a finite number", "give a finite number")
    return converted


def text(arguments: Mapping[str, Any], name: str, max_characters: int = 200) -> str:
    """Return the text argument `name` of a request without surrounding white space."""
    value = arguments.get(name)
    if not isinstance(value, str) or not value.strip():
        raise ParameterError(f"{name} is missing", "give a text")
    return value.strip()[:max_characters]


def channel_rows(
    parameters: Mapping[str, float], signals: Mapping[str, str] | None = None
) -> list[dict[str, Any]]:
    """Return name, unit, scale and meaning of each telemetry channel. A raw number times its scale is the
    value in that unit.
    """
    rad = rad_per_count(parameters).tolist()
    rows = []
    for spec in CHANNELS:
        scale = rad[spec.axis] if spec.axis is not None else 1.0 if is_whole(spec) else spec.scale
        unit = "rad" if spec.axis is not None else spec.unit
        row = {"name": spec.column, "unit": unit, "scale": scale, "meaning": spec.meaning}
        rows.append(row | {"signal": (signals or {}).get(spec.column, "")})
    return rows


def parameter_rows() -> list[dict[str, Any]]:
    """Return name, unit, range, default and meaning of each parameter of the board."""
    return [_parameter_row(spec) for spec in PARAMS]


def _parameter_row(spec: ParamSpec) -> dict[str, Any]:
    """Return the declaration of a parameter for the page."""
    return {
        "name": spec.name,
        "unit": spec.unit,
        "min": spec.min,
        "max": spec.max,
        "default": spec.default,
        "idle_only": spec.idle_only,
        "meaning": spec.meaning,
        "valid_values": range_text(Param(spec.index)),
    }


def state_rows(words: Mapping[State, str] = _STATE_WORDS) -> dict[int, dict[str, str]]:
    """Return for each supervisor state, by number, its name and one sentence for the operator."""
    return {int(state): {"name": state.name.lower(), "words": words[state]} for state in State}


def fault_rows() -> dict[int, dict[str, str]]:
    """Return for each fault, by number, its name, its meaning and how to fix it."""
    return {spec.code: {"name": spec.name, "meaning": spec.meaning, "remedy": spec.remedy} for spec in FAULTS}


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


def outline(rig: str) -> dict[str, float]:
    """Return lengths [m] and masses [kg] of a rig by name; empty if no installed package can read rigs."""
    for entry in plugins(ENTRY_POINT_GROUP):
        read_outline: Outline = entry.load()
        return dict(read_outline(rig))
    return {}
