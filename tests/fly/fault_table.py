"""The table of docs/reference/failures.md: what fails, what the board does, how soon, what the host reports.

``python -m tests.fly.fault_table`` flies its rows on the emulated Due and prints it. Failures at any
moment of a flight are in `fault_sweep`.
"""

from __future__ import annotations

import argparse
import contextlib
import errno
import io
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final
from unittest.mock import patch

import numpy as np
from due_emulator import read_image
from heli_host.data.log.summary import FlightSummary
from heli_host.declaration import Axis, Event, EventMessage, MessageId, PingMessage, State, Trigger
from heli_host.fly.connection import connect
from heli_host.fly.plan import Plan
from heli_host.fly.runner import fly
from heli_host.link.frames import FrameParser, encode_frame
from heli_sim import _native
from heli_sim.sil.boards import EmulatedDue
from heli_sim.sil.world import SilWorld

from tests.firmware.desk import BRANCH_TO_SELF, SLOWEST_Hz
from tests.firmware.desk import TICK as TICK_SYMBOL
from tests.sil.harness import due_of, turn_unseen, world_of

SHORT: Final = Plan.parse(
    '[start]\nsettle_s = 1\n[[segment]]\nkind = "ramp"\ntravel_deg = 5\nduration_s = 3\n'
    '[[segment]]\nkind = "hold"\nduration_s = 4\n',
    "short.toml",
)
# The longest landing, and the time after which the board begins it by itself.

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
    acted_s, does = _first_act_and_deeds(events, begin_tick, off_s, completed=completed)
    if case.as_if is not None:
        acted_s, does = 0.0, f"{case.as_if}, motors off after {off_s:.1f} s"
    return Outcome(
        says=summary.outcome if summary is not None else "",
        acted_s=acted_s,
        off_s=off_s,
        does=does,
        volts_V=list(struck.world.native.volts_V),
        state=struck.states[-1].detail,
    )


def _first_act_and_deeds(
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


_UNDEFINED: Final = b"\x00\xde"
# Long enough for any watchdog of the chip, whose clock may be slow.
_HANGS_MS: Final = 300
_STANDS_STILL_MS: Final = 50
_FLOOD_MS: Final = 150
_FLOOD_EDGES_PER_MS: Final = 500
_LINE_BYTES_PER_MS: Final = 25
_BLOW_DEG_S: Final = 500.0
_JUMP_DEG: Final = 10.0
_STALLS_MS: Final = 1200
_DOWN_MS: Final = 15_000
_KILLED: Final = "as if the host were killed"


def wrong_edges(struck: Struck, ms: int) -> None:
    """Let both lines of the elevation encoder change at once, ten times."""
    board = struck.world.board
    if ms % 2 != 0 or ms >= 20:
        return
    if isinstance(board, EmulatedDue):
        board.sim.due.glitch_encoder(Axis.ELEVATION)
    else:
        assert isinstance(board.sim, _native.NativeBoard)
        changes_up_to_now = ms // 2 + 1
        board.sim.encoder_illegal = [changes_up_to_now, 0, 0]


def noise(struck: Struck, ms: int) -> None:
    """Put half a million edges a second on the travel encoder's lines."""
    due = due_of(struck.world).sim.due
    if ms < _FLOOD_MS:
        for k in range(_FLOOD_EDGES_PER_MS):
            due.schedule_step(Axis.TRAVEL, (1, -1)[k % 2], due.now_us + 1.0 + 1e3 * k / _FLOOD_EDGES_PER_MS)


def _jump(axis: int) -> Callable[[Struck, int], None]:
    """Return a blow after which an encoder counts from another angle, while the arm has not moved."""

    def blow(struck: Struck, ms: int) -> None:
        # The arm turns while the plug is out, and returns while the encoder counts.
        if ms <= 1:
            turn_unseen(struck.world, axis, _JUMP_DEG if ms == 0 else -_JUMP_DEG, unseen=ms == 0)

    return blow


elevation_jump, pitch_jump, travel_jump = (_jump(axis) for axis in range(3))


def struck_by_a_hand(struck: Struck, ms: int) -> None:
    if ms == 0:
        state = struck.world.state
        state[4] = np.deg2rad(_BLOW_DEG_S)
        struck.world.state = state


def power(struck: Struck, ms: int) -> None:
    if ms == 0:
        struck.world.cycle_power()


def reset(struck: Struck, ms: int) -> None:
    if ms == 0:
        struck.world.reset_board()


def hang(struck: Struck, ms: int) -> None:
    """Let the control tick run in a circle, while the watchdog's clock is as slow as it may be."""
    due_of(struck.world).sim.due.set_slow_clock(SLOWEST_Hz)
    _overwrite(struck, ms, BRANCH_TO_SELF)


def wrong_instruction(struck: Struck, ms: int) -> None:
    """Let the control tick meet an instruction that there is none of."""
    _overwrite(struck, ms, _UNDEFINED)


def _overwrite(struck: Struck, ms: int, code: bytes) -> None:
    if ms not in (0, _HANGS_MS):
        return
    image = read_image(struck.world.options.elf)
    address = image.address(TICK_SYMBOL)
    start, data = next(piece for piece in image.segments if 0 <= address - piece[0] < len(piece[1]))
    original_code = data[address - start :][: len(code)]
    due_of(struck.world).sim.due.poke(address, code if ms == 0 else original_code)


def full_receiver(struck: Struck, ms: int) -> bytes:
    """Send without a pause while the processor stands still, more than the receiver's ring takes."""
    if ms in (0, _STANDS_STILL_MS):
        due_of(struck.world).sim.due.hold_processor(ms == 0)
    ping = encode_frame(message_id=MessageId.PING, seq=0, payload=PingMessage(0, 0).pack())
    return ping * (_LINE_BYTES_PER_MS // len(ping)) if ms < _STANDS_STILL_MS else b""


def stalled(struck: Struck, ms: int) -> None:
    if ms == 0:
        struck.alone(_STALLS_MS)


def killed(struck: Struck, ms: int) -> None:
    if ms == 0:
        struck.alone(_DOWN_MS)
        raise KilledError


def ctrl_c(struck: Struck, ms: int) -> None:
    if ms == 0:
        raise KeyboardInterrupt


def sigterm(struck: Struck, ms: int) -> None:
    if ms == 0:
        raise KeyboardInterrupt("SIGTERM")


def sighup(struck: Struck, ms: int) -> None:
    if ms == 0:
        raise KeyboardInterrupt("SIGHUP")


def ctrl_c_twice(struck: Struck, ms: int) -> None:
    if ms in (0, 1000):
        raise KeyboardInterrupt


def full_disk(struck: Struck, ms: int) -> None:
    struck.disk_full = True


_ELEVATION: Final = "fault elevation_motionless"
_PITCH: Final = "fault pitch_motionless"
_TRAVEL_DEAD: Final = "fault travel_motionless"


def _sine(what: str, options: str, says: str, within_s: float) -> Case:
    """A fault from the start in a flight of `sine`, in which every axis moves."""
    return Case(what, says, within_s, 0.0, options, plan="sine")


def _wiring(what: str, options: str, says: str, within_s: float) -> Case:
    """A wrong sign, from the start; `within_s` begins when the control loops close."""
    return Case(what, f"fault {says}", within_s, 0.0, options, plan="step")


WIRINGS: Final = (
    _wiring("the elevation encoder counts backwards", "encoder_scale=elevation:-1", "elevation_sign", 0.3),
    _wiring("the pitch encoder counts backwards", "encoder_scale=pitch:-1", "pitch_sign", 12.0),
    _wiring("the travel encoder counts backwards", "encoder_scale=travel:-1", "travel_sign", 13.0),
    _wiring("the front motor turns backwards", "motor_sign=front:-1", "pitch_sign", 0.6),
    _wiring("the back motor turns backwards", "motor_sign=back:-1", "pitch_sign", 0.6),
    _wiring("both motors turn backwards", "motor_sign=front:-1,back:-1", "elevation_following", 4.0),
    _wiring("the motors are exchanged", "motors_swapped=1", "pitch_sign", 12.0),
)
CASES: Final = (
    _sine("no encoder counts from the start", "encoder_out=elevation,pitch,travel", _ELEVATION, 1.5),
    _sine("the elevation encoder is out from the start", "encoder_out=elevation", _ELEVATION, 1.5),
    _sine("the pitch encoder is out from the start", "encoder_out=pitch", _PITCH, 12.0),
    _sine("the travel encoder is out from the start", "encoder_out=travel", _TRAVEL_DEAD, 12.0),
    _sine("no motor has a supply", "supply_out=0", _ELEVATION, 1.5),
    *WIRINGS,
    Case(
        "the plug of the elevation encoder falls off for 1 s in flight",
        "fault elevation_rest",
        6.0,
        options="encoder_out=elevation:6:1",
    ),
    Case(
        "the count of the elevation encoder jumps by 10 degrees",
        "fault elevation_step",
        0.005,
        blow=elevation_jump,
    ),
    Case("the count of the pitch encoder jumps by 10 degrees", "fault pitch_step", 0.005, blow=pitch_jump),
    Case("the count of the travel encoder jumps by 10 degrees", "fault travel_step", 0.005, blow=travel_jump),
    Case(
        "the stop switch is pressed, or its wire breaks",
        "fault hardware_stop",
        0.002,
        options="stop_switch=6",
    ),
    Case(
        "an encoder's lines change six times in an impossible order",
        "fault encoder_elevation",
        0.02,
        blow=wrong_edges,
    ),
    Case(
        "noise on the lines of travel, 500,000 edges per second",
        "fault encoder_overload",
        0.003,
        blow=noise,
        due_only=True,
    ),
    Case("a hand strikes the short arm", "fault pitch_step", 0.05, blow=struck_by_a_hand),
    Case("the control tick hangs", "restarted (watchdog)", 0.18, blow=hang, due_only=True),
    Case(
        "the program reaches an invalid instruction",
        "restarted (software)",
        0.003,
        blow=wrong_instruction,
        due_only=True,
    ),
    Case("the board loses its power", "restarted (power_up)", 0.002, blow=power),
    Case("the board's RESET is pressed", "restarted (user)", 0.002, blow=reset),
    Case(
        "the processor stands still, so that bytes of the host are lost",
        "completed",
        0.0,
        blow=full_receiver,
        due_only=True,
    ),
    Case("bits flip on the line, 1 in 10,000", "completed", 0.0, options="flip=1e-4"),
    Case("the cable is out for 0.3 s", "completed", 0.0, options="unplug=6:0.3"),
    Case("the host, or its computer, stalls for 1.2 s", "completed", 0.6, blow=stalled),
    Case("the host is killed (`kill -9`)", "", 0.6, blow=killed),
    Case("the cable is out for 5 s", "because of stale_land", 0.0, options="unplug=6:5", as_if=_KILLED),
    Case("the cable stays out", "link lost", 0.0, options="unplug=6:100", as_if=_KILLED),
    Case("Ctrl-C in `heli-host`", "aborted: Ctrl-C", 0.1, blow=ctrl_c),
    Case("SIGTERM", "aborted: SIGTERM", 0.1, blow=sigterm),
    Case("its terminal is closed (SIGHUP)", "aborted: SIGHUP", 0.1, blow=sighup),
    Case("Ctrl-C twice, a second apart", "Ctrl-C again, motors stopped in the air", 1.1, blow=ctrl_c_twice),
    Case("the disk is full", "aborted: cannot write the log", 1.5, blow=full_disk),
)
"""In the order of the table. A signal is here what `heli_host.ui.cli.entry` makes of it."""

ELSEWHERE: Final = {
    "the disk blocks for seconds": "test_a_disk_that_blocks_for_seconds_is_not_noticed_by_the_board",
    "the disk has no room for the flight": "test_without_space_for_the_flight_nothing_is_armed",
}
"""Rows that cannot be flown in lockstep, or end before the flight; each with the test that shows it."""


HEAD: Final = "| fault | the board | within, s | the host reports |"


def row(case: Case, outcome: Outcome) -> str:
    """Return a row of the table, as Markdown."""
    within = f"{outcome.acted_s:.3g}" if outcome.acted_s else ""
    says = f"`{case.says}`" if case.says else ""
    return f"| {case.what} | {outcome.does} | {within} | {says} |"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--board", default="due", help="native or due")
    parser.add_argument("--elf", default="", help="flight code of the emulated Due, not the newest")
    given = parser.parse_args()
    print(f"{HEAD}\n|---|---|---|---|")
    for case in CASES:
        if given.board == "due" or not case.due_only:
            print(row(case, flown(case, given.board, given.elf)), flush=True)


if __name__ == "__main__":
    main()
