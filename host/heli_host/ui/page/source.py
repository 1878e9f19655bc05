"""The interface between the page's server and its subject: a connected board, or a log that is replayed."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum, auto
from typing import Any, Protocol

from heli_host.declaration import CHANNELS, FAULTS, PARAMS, ParamSpec, State
from heli_host.errors import ParameterError, range_text
from heli_host.link.channels import is_whole, rad_per_count
from heli_host.ui.page.telemetry_buffer import TelemetryBuffer

KEPT_S = 600.0
"""Length of the history that a newly opened page shows [s]. It takes 38 MB of memory."""

UNKNOWN = (255, 0)
"""State and fault that mean "no telemetry"; 255 is not the number of a supervisor state."""

News = Callable[[Mapping[str, Any]], None]


class Role(Enum):
    """Least role that a client needs for an action."""

    OBSERVER = auto()
    """Every connected client."""
    PILOT = auto()
    """The client that holds the control lease."""
    TUNER = auto()
    """The pilot; also every other client while the pilot shares the tuning of parameters."""


class CommandQueue(Enum):
    """Queue in which an action runs. Each queue has one thread and runs its actions in order.

    The queues are independent: an action waits for earlier actions of its own queue only. A stop uses none of
    them.
    """

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

    def state(self) -> tuple[int, int]:
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

        `present`: True while the pilot's page has answered within `heli_host.ui.page.control_lease.PRESENT_S`
        seconds. Called before each setpoint and each pair of voltages, with the link's lock held: it must not
        block.
        """
        ...


STATE_WORDS: dict[State, str] = {
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
    from heli_host.declaration import Param

    return {
        "name": spec.name,
        "unit": spec.unit,
        "min": spec.min,
        "max": spec.max,
        "default": spec.default,
        "idle_only": spec.idle_only,
        "meaning": spec.meaning,
        "takes": range_text(Param(spec.index)),
    }


def state_rows(words: Mapping[State, str] = STATE_WORDS) -> dict[int, dict[str, str]]:
    """Return for each supervisor state, by number, its name and one sentence for the operator."""
    return {int(state): {"name": state.name.lower(), "words": words[state]} for state in State}


def fault_rows() -> dict[int, dict[str, str]]:
    """Return for each fault, by number, its name, its meaning and how to fix it."""
    return {spec.code: {"name": spec.name, "meaning": spec.meaning, "remedy": spec.remedy} for spec in FAULTS}
