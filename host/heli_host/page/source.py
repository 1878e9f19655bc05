"""What a page shows and commands: a board that flies, or a log that is played again."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum, auto
from typing import Any, Protocol

from heli_host.declaration import CHANNELS, FAULTS, PARAMS, ParamSpec, State
from heli_host.errors import ParameterError, range_text
from heli_host.link.channels import is_whole, rad_per_count
from heli_host.page.tape import Tape

KEPT_S = 600.0
"""How much of the past a page that is opened now still finds [s]; 38 MB of memory."""

UNKNOWN = (255, 0)
"""State and fault of a board that is not heard: no state has this number."""

News = Callable[[Mapping[str, Any]], None]


class Need(Enum):
    """Who may do something."""

    ANYBODY = auto()
    PILOT = auto()
    TUNER = auto()
    """The pilot, and others while he lets them."""


class Lane(Enum):
    """Which thread does something; what is in one waits for what is before it, and for no other."""

    FLIGHT = auto()
    QUICK = auto()
    SETPOINT = auto()


@dataclass(frozen=True)
class Action:
    """Something that can be asked for.

    Parameters
    ----------
    run : callable taking a mapping, returning a mapping
        Does it, in the thread of `lane`; what it returns goes into the answer.
    lane : Lane
        Where it is done.
    need : Need
        Who may ask for it.
    """

    run: Callable[[Mapping[str, Any]], Mapping[str, Any]]
    lane: Lane
    need: Need


class Source(Protocol):
    """What a page is about.

    Attributes
    ----------
    tape : Tape
        Its newest minutes.
    actions : mapping of str to Action
        What can be asked for, by name.
    """

    tape: Tape
    actions: Mapping[str, Action]

    def describe(self) -> dict[str, Any]:
        """Return what a page needs to know once, as JSON."""
        ...

    def status(self) -> dict[str, Any]:
        """Return what a page shows in words, as JSON; asked ten times a second, so it must not wait."""
        ...

    def state(self) -> tuple[int, int]:
        """Return the board's state and fault now, for every frame; `UNKNOWN` while nothing is heard of it."""
        ...

    def listen(self, news: News) -> None:
        """Have what happens told, as JSON, from any thread.

        Parameters
        ----------
        news : callable taking a mapping
            Is told.
        """
        ...

    def stop(self) -> None:
        """Switch the motors off, before everything else; called in the thread that hears of it."""
        ...

    def wish(self) -> int:
        """Return a number that another stop changes: what was wished for before it is not begun after it."""
        ...

    def begin(self, wish: int) -> bool:
        """Whether what was wished for at `wish` may begin: no stop has come since.

        Parameters
        ----------
        wish : int
            As `wish` returned it.
        """
        ...

    def watch_pilot(self, present: Callable[[], bool]) -> None:
        """Let setpoints out only while the pilot is there.

        Parameters
        ----------
        present : callable returning bool
            Whether he is.
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


def number(arguments: Mapping[str, Any], name: str) -> float:
    """Return a number that was asked with; a ParameterError when there is none.

    Parameters
    ----------
    arguments : Mapping of str to object
        As they came.
    name : str
        Which.
    """
    value = arguments.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ParameterError(f"{name} is not a number", "give a number")
    return finite(name, value)


def finite(name: str, value: float) -> float:
    """Return a number as a float; a ParameterError unless it is finite.

    Parameters
    ----------
    name : str
        What it is, for the message.
    value : float
        As it came; JSON has whole numbers of any length, and Python's also NaN and Infinity.
    """
    try:
        converted = float(value)
    except OverflowError:
        converted = math.inf if value > 0 else -math.inf
    if not math.isfinite(converted):
        raise ParameterError(f"{name} is {converted}, not a finite number", "give a finite number")
    return converted


def text(arguments: Mapping[str, Any], name: str, most: int = 200) -> str:
    """Return a text that was asked with, at most `most` characters; a ParameterError when there is none.

    Parameters
    ----------
    arguments : Mapping of str to object
        As they came.
    name : str
        Which.
    most : int
        Characters that are kept.
    """
    value = arguments.get(name)
    if not isinstance(value, str) or not value.strip():
        raise ParameterError(f"{name} is missing", "give a text")
    return value.strip()[:most]


def channel_rows(
    parameters: Mapping[str, float], signals: Mapping[str, str] | None = None
) -> list[dict[str, Any]]:
    """Return what the raw numbers of a frame mean: name, unit and scale of each channel.

    Parameters
    ----------
    parameters : Mapping of str to float
        The board's parameters: how many counts an encoder has.
    signals : Mapping of str to str, optional
        What a law of one's own tells in ``signal_1`` and those behind it; they are then drawn.
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
    """Return what the declaration says of each parameter."""
    return [_parameter_row(spec) for spec in PARAMS]


def _parameter_row(spec: ParamSpec) -> dict[str, Any]:
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


def state_rows() -> dict[int, dict[str, str]]:
    """Return each state's name and what it means for who looks at it."""
    return {int(state): {"name": state.name.lower(), "words": STATE_WORDS[state]} for state in State}


def fault_rows() -> dict[int, dict[str, str]]:
    """Return each fault's name, meaning and remedy."""
    return {spec.code: {"name": spec.name, "meaning": spec.meaning, "remedy": spec.remedy} for spec in FAULTS}
