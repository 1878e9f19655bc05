"""A seeded set of flights to each of which something happens, and what must be true of every one.

What is true is read off the line before its faults spoil it, where the board was heard; while the cable is
out, it is what was done to the board.
"""

import random
from dataclasses import dataclass, field

import heli_host
import numpy as np
from heli_host.declaration import Event, EventMessage, Fault, MessageId, State, Trigger
from heli_host.fly.plan import Plan
from heli_host.fly.runner import Progress, fly
from heli_host.link.frames import FrameParser
from heli_host.link.telemetry import LinkCounters, TelemetryDecoder, Ticks
from heli_sim import _native
from heli_sim.sil.world import SilWorld

from tests.sil.harness import world_of

PLAN = Plan.parse(
    '[start]\nsettle_s = 1\n[[segment]]\nkind = "ramp"\ntravel_deg = 5\nduration_s = 2\n'
    '[[segment]]\nkind = "hold"\nduration_s = 2\n',
    "short.toml",
)
_FLYING = (State.ARMED, State.CLOSED_LOOP, State.HOLD)
# Commands of the host, and what follows a landing whose beginning was not heard: no reasons.
_NO_REASONS = (Trigger.LAND, Trigger.STOP, Trigger.TOUCHDOWN)
# The longest landing, and the time after which the board begins it by itself.
_DOWN_S = 20.0

Row = tuple[int, bytes]


@dataclass
class Heard:
    """Bytes of the board up to the first fault of the line."""

    rows: set[Row] = field(default_factory=set)
    events: list[EventMessage] = field(default_factory=list)

    def listen(self, world: SilWorld) -> None:
        """Listen in front of the faults of a world's line."""
        parser, decoder, spoil = FrameParser(), TelemetryDecoder(), world.to_host.pass_through

        def pass_through(data: bytes) -> bytes:
            nonlocal parser
            for frame in parser.feed(data):
                if frame.id == MessageId.TELEMETRY:
                    self.rows.update(ticks_with_samples(decoder.decode([frame.payload])))
                elif frame.id == MessageId.EVENT:
                    self.events.append(EventMessage.unpack(frame.payload))
            if world.unplugged:
                # The host opens the port again after that, without the frame that the cable cut.
                parser = FrameParser()
            return spoil(data)

        world.to_host.pass_through = pass_through  # type: ignore[method-assign]

    def end(self) -> EventMessage | None:
        """The event that ended the flight, None where a command of the host did or none was heard."""
        flown = False
        for event in self.events:
            if event.kind != Event.STATE:
                continue
            flown |= event.detail == State.CLOSED_LOOP
            if flown and event.detail not in _FLYING:
                return None if event.cause in _NO_REASONS else event
        return None

    def fault(self) -> Fault:
        """The fault that was reported first."""
        return next((Fault(e.detail) for e in self.events if e.kind == Event.FAULT), Fault.NONE)


def ticks_with_samples(ticks: Ticks) -> list[Row]:
    """Ticks with their samples, to be found among others."""
    return [(tick, raw.tobytes()) for tick, raw in zip(ticks.tick.tolist(), ticks.raw, strict=True)]


@dataclass(frozen=True)
class Case:
    """What happens to one flight."""

    # `options`: Faults of the line, as in a ``sil://`` address.
    # `at_s`: When the blow comes, device time since the loops were closed.
    # `blow`: ``none``, or what `strike` does.
    # `silent_s`: How long the line carries nothing.

    number: int
    options: str
    at_s: float
    blow: str
    silent_s: float


BLOWS = ("none", "stall", "unplug", "stop", "encoder", "pushed", "power", "reset", "ctrl-c", "unplug")


def case(number: int) -> Case:
    """One of the set; the same number is always the same case."""
    chance = random.Random(number)
    blow = BLOWS[number % len(BLOWS)]
    noise = chance.choice(("flip", "drop", "double"))
    options = f"seed={number}&{noise}={10 ** chance.uniform(-5.0, -3.5):.2g}"
    at_s, silent_s = round(chance.uniform(1.0, 4.0), 2), 0.0
    if blow in ("stall", "unplug"):
        silent_s = round((0.3, 1.2, 7.0, 3.0)[number % 4] + chance.uniform(0.0, 0.4), 2)
        # The loops are closed 0.6 s after the simulation has begun.
        options += f"&{blow}={0.6 + at_s:.2f}:{silent_s}"
    return Case(number, options, at_s, blow, silent_s)


def strike(blow: str, world: SilWorld) -> None:
    """Do to a flight what its case says."""
    board = world.board.sim
    assert isinstance(board, _native.NativeBoard)
    if blow == "stop":
        board.set_stop(True)
    elif blow == "encoder":
        board.encoder_illegal = [0, 9, 0]
    elif blow == "pushed":
        state = world.state
        state[1] = np.deg2rad(60.0)
        world.state = state
    elif blow == "power":
        world.cycle_power()
    elif blow == "reset":
        world.reset_board()
    elif blow == "ctrl-c":
        raise KeyboardInterrupt


@dataclass(frozen=True)
class Flown:
    """How a case went."""

    # `delivered`: Bytes that the host received.
    # `since_tick`: Newest tick before the first of them.
    # `volts_V`: On the motors, when the board had time to land by itself.

    case: Case
    outcome: str
    heard: Heard
    delivered: list[Ticks]
    counters: LinkCounters
    since_tick: int
    volts_V: list[float]


def flown(case: Case) -> Flown:
    """Fly one case in lockstep."""
    received = Heard()
    delivered: list[Ticks] = []

    def on_progress(progress: Progress) -> None:
        if progress.t_s >= case.at_s and waiting:
            strike(waiting.pop(), world)

    with heli_host.connect(f"sil://?{case.options}") as heli:
        world = world_of(heli)
        received.listen(world)
        # The frame that was on its way is heard from its middle on.
        heli.wait(0.1)
        waiting = [case.blow]
        heli.session.subscribe_ticks(delivered.append)
        before, newest = heli.counters, heli.session.latest
        summary = fly(heli, PLAN, on_progress=on_progress)
        after = heli.counters
        counters = LinkCounters(
            ticks_received=after.ticks_received - before.ticks_received,
            ticks_lost=after.ticks_lost - before.ticks_lost,
            restarts=after.restarts,
        )
    world.advance(round(1e3 * _DOWN_S))
    since = newest.tick if newest is not None else 0
    return Flown(
        case=case,
        outcome=summary.outcome,
        heard=received,
        delivered=delivered,
        counters=counters,
        since_tick=since,
        volts_V=list(world.native.volts_V),
    )


def mistakes_of(flight: Flown) -> list[str]:
    """What is not as it must be, in words; empty for a flight that was handled right."""
    complaints = []
    rows = [row for ticks in flight.delivered for row in ticks_with_samples(ticks)]
    if invented := [tick for tick, raw in rows if (tick, raw) not in flight.heard.rows]:
        complaints.append(f"{len(invented)} wrong ticks, the first {invented[0]}")
    counted, tick = flight.counters, np.array([tick for tick, _ in rows], np.int64)
    if counted.ticks_received != len(rows):
        complaints.append(f"{len(rows)} ticks were delivered, {counted.ticks_received} counted")
    if not counted.restarts:
        steps = np.diff(tick, prepend=flight.since_tick)
        if (steps <= 0).any():
            complaints.append("ticks go backwards")
        if counted.ticks_lost != int(np.sum(steps - 1)):
            complaints.append(f"{int(np.sum(steps - 1))} ticks are missing, {counted.ticks_lost} counted")
    if any(flight.volts_V):
        complaints.append(f"the motors run: {flight.volts_V} V")
    true_reason = reason(flight)
    if true_reason not in flight.outcome or (true_reason != "completed" and "completed" in flight.outcome):
        complaints.append(f"reported {flight.outcome!r}, true is {true_reason!r}")
    return complaints


def reason(flight: Flown) -> str:
    """Words that the outcome of a flight must contain."""
    blow, silent_s = flight.case.blow, flight.case.silent_s
    if blow in ("power", "reset"):
        return f"restarted ({'power_up' if blow == 'power' else 'user'})"
    if blow == "ctrl-c":
        return "aborted: Ctrl-C"
    end = flight.heard.end()
    if end is not None and end.cause in (Trigger.TRIP, Trigger.AXIS_LOST):
        return f"fault {flight.heard.fault().name.lower()}"
    if end is not None:
        return f"because of {Trigger(end.cause).name.lower()}"
    if silent_s > 2.5:
        return "because of stale_land"
    return "completed"
