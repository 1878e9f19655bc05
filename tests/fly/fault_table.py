"""The table of docs/reference/failures.md: what fails, what the board does, how soon, what the host reports.

``python -m tests.fly.fault_table`` flies its rows on the emulated Due and prints it. Failures at any
moment of a flight are in `fault_sweep`.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import Final

import numpy as np
from due_emulator import read_image
from heli_host.declaration import MessageId, PingMessage
from heli_host.link.frames import encode_frame
from heli_sim import _native
from heli_sim.sil.boards import EmulatedDue

from tests.firmware.desk import BRANCH_TO_SELF, SLOWEST_Hz
from tests.firmware.desk import TICK as TICK_SYMBOL
from tests.fly.fault_flights import Case, KilledError, Outcome, Struck, flown
from tests.sil.harness import due_of

_UNDEFINED: Final = b"\x00\xde"
# Long enough for any watchdog of the chip, whose clock may be slow.
_HANGS_MS: Final = 300
_STANDS_STILL_MS: Final = 50
_FLOOD_MS: Final = 150
_FLOOD_EDGES_PER_MS: Final = 500
_TRAVEL: Final = 2
_LINE_BYTES_PER_MS: Final = 25
_BLOW_DEG_S: Final = 500.0
_JUMP_DEG: Final = 10.0
_STALLS_MS: Final = 1200
_DOWN_MS: Final = 15_000
_KILLED: Final = "as if the host were killed"


def wrong_edges(struck: Struck, ms: int) -> None:
    """Let both lines of the elevation encoder change at once, ten times."""
    board = struck.world.board
    if isinstance(board, EmulatedDue):
        if ms % 2 == 0 and ms < 20:
            board.sim.due.glitch_encoder(0)
    elif ms % 2 == 0 and ms < 20:
        assert isinstance(board.sim, _native.NativeBoard)
        board.sim.encoder_illegal = [ms // 2 + 1, 0, 0]


def noise(struck: Struck, ms: int) -> None:
    """Put half a million edges a second on the travel encoder's lines."""
    due = due_of(struck.world).sim.due
    if ms < _FLOOD_MS:
        for k in range(_FLOOD_EDGES_PER_MS):
            due.schedule_step(_TRAVEL, (1, -1)[k % 2], due.now_us + 1.0 + 1e3 * k / _FLOOD_EDGES_PER_MS)


def _jump(axis: int) -> Callable[[Struck, int], None]:
    """Return a blow after which an encoder counts from another angle, while the arm has not moved."""

    def blow(struck: Struck, ms: int) -> None:
        world = struck.world
        if ms > 1:
            return
        # The arm turns while the plug is out, and returns while the encoder counts.
        state = world.state
        state[axis] += np.deg2rad(_JUMP_DEG) * (1 if ms == 0 else -1)
        world.state = state
        out = [False] * 3
        out[axis] = ms == 0
        world.native.encoders_out = out

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
    ping = encode_frame(MessageId.PING, 0, PingMessage(0, 0).pack())
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


CASES: Final = (
    _sine("no encoder counts from the start", "encoder_out=elevation,pitch,travel", _ELEVATION, 1.5),
    _sine("the elevation encoder is out from the start", "encoder_out=elevation", _ELEVATION, 1.5),
    _sine("the pitch encoder is out from the start", "encoder_out=pitch", _PITCH, 12.0),
    _sine("the travel encoder is out from the start", "encoder_out=travel", _TRAVEL_DEAD, 12.0),
    _sine("no motor has a supply", "supply_out=0", _ELEVATION, 1.5),
    _wiring("the elevation encoder counts backwards", "encoder_scale=elevation:-1", "elevation_sign", 0.3),
    _wiring("the pitch encoder counts backwards", "encoder_scale=pitch:-1", "pitch_sign", 12.0),
    _wiring("the travel encoder counts backwards", "encoder_scale=travel:-1", "travel_sign", 13.0),
    _wiring("the front motor turns backwards", "motor_sign=front:-1", "pitch_sign", 0.6),
    _wiring("the back motor turns backwards", "motor_sign=back:-1", "pitch_sign", 0.6),
    _wiring("both motors turn backwards", "motor_sign=front:-1,back:-1", "elevation_following", 4.0),
    _wiring("the motors are exchanged", "motors_swapped=1", "pitch_sign", 12.0),
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
