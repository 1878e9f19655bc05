"""Flights in which something fails at a known millisecond, and what board, motors and host did then."""

from __future__ import annotations

import contextlib
import errno
import io
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final
from unittest.mock import patch

from heli_host.data.log.summary import FlightSummary
from heli_host.declaration import Event, EventMessage, MessageId, State, Trigger
from heli_host.fly.connection import connect
from heli_host.fly.plan import Plan
from heli_host.fly.runner import fly
from heli_host.link.frames import FrameParser
from heli_sim.sil.world import SilWorld

from tests.sil.harness import world_of

SHORT: Final = Plan.parse(
    '[start]\nsettle_s = 1\n[[segment]]\nkind = "ramp"\ntravel_deg = 5\nduration_s = 3\n'
    '[[segment]]\nkind = "hold"\nduration_s = 4\n',
    "short.toml",
)
# The longest landing, and the time after which the board begins it by itself.
_DOWN_MS: Final = 15_000
_FLYING: Final = (State.ARMED, State.CLOSED_LOOP)
_DOWN: Final = (State.IDLE, State.FAULT)
_LANDING: Final = (State.LANDING, State.EMERGENCY_LANDING)


class KilledError(BaseException):
    """The host is no more: nothing of it runs on, its landing neither."""


class Struck:
    """A world to which something happens."""

    # `world`: From now on it passes a millisecond at a time, from `at_tick` on.
    # `at_tick`: When it happens, ms since the simulation started.
    # `blow`: What happens: called before every millisecond from `at_tick` on, with how many have passed
    # since.
    # `states`: Changes of state that the board reported.
    # `last_on_tick`: Newest millisecond in which a motor had a voltage.
    # `disk_full`: Whether the log's disk takes nothing more.

    def __init__(
        self, world: SilWorld, at_tick: int, blow: Callable[[Struck, int], bytes | None] | None
    ) -> None:
        self.world = world
        self.states: list[EventMessage] = []
        self.last_on_tick = 0
        self.disk_full = False
        self._at_tick = at_tick
        self._blow = blow
        self._blown_tick = -1
        self._advance = world.advance
        self._parser = FrameParser()
        self._spoil = world.to_host.pass_through
        world.advance = self.advance  # type: ignore[method-assign]
        world.to_host.pass_through = self._listen  # type: ignore[method-assign]

    def advance(
        self, ticks: int, rx: bytes = b"", *, until_output: bool = False, min_ticks: int = 1
    ) -> bytes:
        """Stand in for the world's own."""
        received = b""
        while ticks > 0 and not (until_output and received and min_ticks <= 0):
            begin_tick = self.world.tick
            stretch = min(ticks, max(1, min_ticks)) if until_output and received else ticks
            if begin_tick < self._at_tick:
                stretch = min(stretch, self._at_tick - begin_tick)
                received += self._advance(stretch, rx, until_output=until_output, min_ticks=min_ticks)
            else:
                received += self._one_ms(rx)
            rx = b""
            ticks -= self.world.tick - begin_tick
            min_ticks -= self.world.tick - begin_tick
        return received

    def alone(self, milliseconds: int) -> None:
        """Let time pass without a host."""
        for _ in range(milliseconds):
            self._one_ms(b"")

    def _one_ms(self, rx: bytes) -> bytes:
        tick = self.world.tick
        if self._blow is not None and tick > self._blown_tick:
            self._blown_tick = tick
            rx += self._blow(self, tick - self._at_tick) or b""
        received = self._advance(1, rx)
        if any(self.world.native.volts_V):
            self.last_on_tick = tick
        return received

    def _listen(self, data: bytes) -> bytes:
        """Listen in front of the faults of the line."""
        for frame in self._parser.feed(data):
            if frame.id == MessageId.EVENT:
                event = EventMessage.unpack(frame.payload)
                if event.kind == Event.STATE:
                    self.states.append(event)
        return self._spoil(data)


Blow = Callable[[Struck, int], bytes | None]


@dataclass(frozen=True)
class Case:
    """Something that fails in a flight."""

    # `what`: The first column of the table.
    # `says`: Words that the outcome of the flight must contain.
    # `within_s`: Bound of the time until the board acts; 0 where it has nothing to do.
    # `at_s`: When, simulated seconds; 0 for before take-off.
    # `options`: Options in the address of the simulated board, where these cause the failure.
    # `blow`: What does it otherwise, as `Struck` takes it.
    # `plan`: What is flown.
    # `due_only`: Whether only the emulated Due has what fails.
    # `as_if`: Case with the same behaviour of the board, which nobody can observe here.

    what: str
    says: str
    within_s: float
    at_s: float = 6.0
    options: str = ""
    blow: Blow | None = None
    plan: Plan | str = field(default=SHORT, repr=False)
    due_only: bool = False
    as_if: str | None = None


@dataclass(frozen=True)
class Outcome:
    """How such a flight went."""

    # `says`: Report of the host; empty for a host that was killed.
    # `acted_s`: From the fault, or from closing the loops, until the board cut the motors or went to another
    # state; 0 where it did neither.
    # `off_s`: The same until the motors were off, or the time they ran on where the flight was not ended.
    # `does`: Behaviour of the board in words.
    # `volts_V`: On the motors long after.
    # `state`: Newest state that the board reported.

    says: str
    acted_s: float
    off_s: float
    does: str
    volts_V: list[float]
    state: int


def flown(case: Case, board: str = "native", elf: str = "") -> Outcome:
    """Fly a case in lockstep."""
    summary = None
    options = filter(None, (f"board={board}", f"elf={elf}" if elf else "", case.options))
    with connect(f"sil://?seed=1&speed=max&{'&'.join(options)}") as heli:
        struck = Struck(world_of(heli), round(1e3 * case.at_s), case.blow)

        class Disk(io.FileIO):
            def write(self, data: object) -> int:
                if struck.disk_full:
                    raise OSError(errno.ENOSPC, "No space left on device")
                return super().write(data)  # type: ignore[arg-type]

        with patch("heli_host.data.log.disk.io.FileIO", Disk), contextlib.suppress(KilledError):
            summary = fly(heli, case.plan)
        struck.alone(0 if summary is None or summary.completed else _DOWN_MS)
    return outcome_of_case(case, struck, summary)


def outcome_of_case(case: Case, struck: Struck, summary: FlightSummary | None) -> Outcome:
    """What happened, from the board's events and the motors' voltages."""
    closed_tick = next(event.tick for event in struck.states if event.detail == State.CLOSED_LOOP)
    begin_tick = round(1e3 * case.at_s) if case.at_s else closed_tick
    events = [event for event in struck.states if event.tick >= begin_tick]
    # Without a supply there is no voltage long before the board cuts it.
    downs = [event.tick for event in events if event.detail in _DOWN]
    off_s = max(0.001, 1e-3 * (max([struck.last_on_tick, *downs[:1]]) - begin_tick))
    completed = summary is not None and summary.completed
    acted_s, does = _deeds(events, begin_tick, off_s, completed=completed)
    if case.as_if is not None:
        acted_s, does = 0.0, f"{case.as_if}, motors off after {off_s:.1f} s"
    return Outcome(
        summary.outcome if summary is not None else "",
        acted_s,
        off_s,
        does,
        list(struck.world.native.volts_V),
        struck.states[-1].detail,
    )


def _deeds(
    events: list[EventMessage], begin_tick: int, off_s: float, *, completed: bool
) -> tuple[float, str]:
    """When the board acted first [s], 0 where it had not to, and what it did."""
    does: list[str] = []
    acted_s = 0.0
    for event in events:
        after_s = 1e-3 * max(1, event.tick - begin_tick)
        if event.detail in _DOWN:
            break
        if event.detail in _FLYING and not does:
            continue
        if event.detail == State.CLOSED_LOOP:
            return acted_s, f"{', '.join(does)}, goes on after {after_s:.1f} s"
        if completed and event.cause == Trigger.LAND:
            return 0.0, "flies on"
        if event.detail == State.HOLD:
            does.append("holds level")
        elif event.detail in _LANDING:
            does.append(f"lands after {after_s:.1f} s" if does else "lands")
        acted_s = acted_s or after_s
    if not does:
        return off_s, "cuts the motors"
    return acted_s, f"{', '.join(does)}, motors off after {off_s:.1f} s"
