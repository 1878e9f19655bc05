"""Events of the board and of the link, with a sentence for each."""

from __future__ import annotations

import math
from dataclasses import dataclass

from heli_host.declaration import (
    Axes,
    Event,
    EventMessage,
    Excitation,
    Probe,
    Reset,
    Result,
    State,
    Takeover,
    Trigger,
)
from heli_host.errors import fault_text

LINK_LOST = "link_lost"
LINK_SILENT = "link_silent"
LINK_RESTORED = "link_restored"
BOARD_RESTARTED = "board_restarted"
CALLBACK_FAILED = "callback_failed"
LAW_SIGNAL_NAMES = "law_signals"


@dataclass(frozen=True)
class LinkEvent:
    """Something that happened on the board or on the link."""

    tick: int  # Device time [tick]; for the link's own events the newest tick known
    wall_ns: int  # Unix time at which this host learned of it [ns]
    kind: str
    """Name of the board's event (``state``, ``fault``, ``setpoint_stale``, ...), or ``link_lost``,
    ``link_silent``, ``link_restored``, ``board_restarted``, ``callback_failed``, ``law_signals``."""
    text: str  # One line for a person, with the reason
    message: EventMessage | None = None
    """The board's message, received or reconstructed from telemetry; None for an event of the link."""
    names: tuple[str, ...] = ()
    """For ``law_signals``: names of the channels ``signal_1``, ``signal_2``, ... from this event on."""


def event_text(message: EventMessage) -> str:
    """Describe a board's event in one line."""
    detail, value = message.detail, message.value
    match message.kind:
        case Event.BOOT:
            return f"board started ({_name_of_value(Reset, detail)}), boot id {value:.0f}"
        case Event.STATE:
            return state_text(detail, message.cause)
        case Event.FAULT:
            measured = "" if math.isnan(value) else f"; seen: {value:.4g}"
            return f"fault {fault_text(detail)}{measured}"
        case Event.SETPOINT_STALE:
            return f"setpoints stopped coming; they came at {value:.0f} Hz in the second before"
        case Event.SETPOINT_FRESH:
            return "setpoints came back"
        case Event.PARAMS_SAVED:
            return f"parameters saved, generation {value:.0f}"
        case Event.EXCITATION_END:
            return f"excitation {_name_of_value(Excitation, detail)} ended"
        case Event.SETPOINT_REJECTED:
            return f"a streamed value was refused: {_name_of_value(Result, detail)}"
        case Event.ZEROED:
            axes = [axis.name.lower() for axis in Axes if axis.name and axis & detail]
            return f"zero taken: {', '.join(axes)}"
        case Event.LAW_ENGAGED:
            return f"the law of the link flies, a call each {value:.0f} ticks"
        case Event.LAW_TAKEN_OVER:
            return f"the board's own law took over ({_name_of_value(Takeover, detail)}; {value:.4g})"
        case Event.TRAVEL_PROBE:
            return (
                f"tilt to check the travel encoder: {_name_of_value(Probe, detail)}; tilt {value:.1f} degrees"
            )
        case _:
            return f"event {message.kind}, unknown to this host (detail {detail}, value {value:.4g})"


def event_kind(message: EventMessage) -> str:
    """Return the name of a board's event."""
    return _name_of_value(Event, message.kind, "event_")


def state_text(state: int, trigger: int) -> str:
    """Describe a state of the board and what led to it."""
    return f"state {_name_of_value(State, state)}, because of {_name_of_value(Trigger, trigger)}"


def _name_of_value(
    kind: type[Event | Probe | Reset | State | Takeover | Trigger | Excitation | Result],
    value: int,
    prefix: str = "",
) -> str:
    """Return the name of an enumerated value in small letters; `prefix` and the number for an unknown one."""
    try:
        return kind(value).name.lower()
    except ValueError:
        return f"{prefix}{value}"
