"""The firmware on an emulated board, with the simulated arm on its pins and a host on its port.

Tests and the bench take from here how to call single functions, make the firmware hang, and measure promises.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt
from due_emulator import new_due, read_image
from heli_host import declaration as d
from heli_host.board.heli import Heli
from heli_host.link.frames import Frame, FrameParser, encode_frame
from heli_host.link.session import Session
from heli_sim.due._due_board import motor_duty, motor_enabled, wire
from heli_sim.model import PaperModel
from heli_sim.model.plant import Plant
from heli_sim.rig import load_rig

from firmware.due.report import Image

TICK_US: Final = 1000.0
COUNTS_PER_RAD: Final = 4096.0 / (2.0 * np.pi)
# Exception numbers.
TRAVEL_INTERRUPT: Final = 16 + 14
TICK_INTERRUPT: Final = 16 + 30
STOP_PIN: Final = "PD6"
ENABLE_PINS: Final = ("PB26", "PA14", "PA15", "PD3")
# Each half bridge's PWM pin, in the order of its enable above.
PWM_PINS: Final = ("PC21", "PC22", "PC23", "PC24")
PAINT: Final = 0xA5A5A5A5
MAX_MS: Final = 300.0
"""Longest time that the motors may stay on after a hang."""
# Backup registers, in the order of firmware/due/README.md.
GPBR: Final = 0x400E1A90
MAGIC: Final = 0x48460000


class Arm:
    """The simulated helicopter: bridges in, encoder counts out."""

    def __init__(self) -> None:
        rig = load_rig("makki2024")
        self.plant = Plant(PaperModel(), rig)
        self.supply_V = rig["supply"].value
        self.state: npt.NDArray[np.float64] = self.plant.rest_state()
        # Called a thousand times a second on arrays that stay where they are: `Plant.step` takes as long to
        # bring its arguments to CasADi and back as the emulated Due takes for the millisecond.
        self._volts_V, self._after, self._seen_rad = np.zeros(2), self.state.copy(), np.zeros(3)
        function: Any = self.plant.function
        self._buffer, self._advance = function.buffer()
        self._inputs = (self.state, self._volts_V, np.zeros(3), self.plant.parameters)
        for index, array in enumerate(self._inputs):
            self._buffer.set_arg(index, array.data)
        for index, array in enumerate((self._after, self._seen_rad)):
            self._buffer.set_res(index, array.data)
        self.counts = self._read(self.state[:3])

    @staticmethod
    def _read(angles_rad: npt.NDArray[np.float64]) -> npt.NDArray[np.int64]:
        return np.floor(angles_rad * COUNTS_PER_RAD).astype(np.int64)

    def step(self, duties: list[float]) -> npt.NDArray[np.int64]:
        """One millisecond; by how many counts each axis moved."""
        self._volts_V[:] = duties
        self._volts_V *= self.supply_V
        self._advance()
        self.state[:] = self._after
        before, self.counts = self.counts, self._read(self._seen_rad)
        moved: npt.NDArray[np.int64] = self.counts - before
        return moved


class Board:
    """An emulated Due, wired up and powered; a transport for heli_host whose time passes in `read`."""

    lockstep: Final = True
    url: Final = "due://"

    def __init__(self, elf: Path, image: Image, arm: Arm | None = None) -> None:
        self.image = image
        self.arm = arm
        self.due = new_due(read_image(str(elf)))
        self.due.stop_at_hardfault(False)
        self.due.usb_line_coding(250000)
        self.connect_wires()
        self.due.power_on()
        self._start_us = self.due.now_us
        self._moved = np.zeros(3, dtype=np.int64)

    def connect_wires(self) -> None:
        """Attach encoders, pull-downs and stop switch to the pins."""
        wire(self.due)

    def advance(self, milliseconds: int) -> bytes:
        """Let time pass; the bytes that reached the host."""
        received = b""
        for _ in range(milliseconds):
            start_us = self.due.now_us
            steps = [
                (start_us + TICK_US * (k + 0.5) / abs(count), axis, 1 if count > 0 else -1)
                for axis, count in enumerate(self._moved.tolist())
                for k in range(abs(count))
            ]
            for when_us, axis, direction in sorted(steps):
                self.due.schedule_step(axis, direction, when_us)
            self.due.run_us(TICK_US)
            received += self.due.usb_read()
            if self.arm is not None:
                self._moved = self.arm.step(self.duties())
        return received

    def duties(self) -> list[float]:
        """Duty of the motors, -1 to 1; a disabled bridge gives 0."""
        return [motor_duty(self.due, motor) * motor_enabled(self.due, motor) for motor in (0, 1)]

    def off(self) -> bool:
        """Whether both bridges are off: no enable pin is high."""
        return not any(self.due.pin(pin) for pin in ENABLE_PINS)

    def on(self) -> bool:
        """Whether both bridges are on: every enable pin is high."""
        return all(self.due.pin(pin) for pin in ENABLE_PINS)

    def pwm_low(self) -> bool:
        """Whether all four PWM pins stay low."""
        return not any(self.due.pin_duty(pin) for pin in PWM_PINS)

    def milliseconds_until_off(self, step_us: float = 20.0, max_ms: float = 1000.0) -> float:
        """Let time pass until both bridges are off; how long that took."""
        start_us = self.due.now_us
        while not self.off():
            self.due.run_us(step_us)
            assert self.due.now_us - start_us < 1e3 * max_ms, "the motors stay on"
        return 1e-3 * (self.due.now_us - start_us)

    def wait_for_reset(self, resets: int) -> None:
        """Let time pass until the chip has been reset more than so many times."""
        for _ in range(500):
            if self.due.resets > resets:
                return
            self.due.run_us(1000.0)
        raise AssertionError("the board was not reset")

    def cut_power(self) -> None:
        """Cut the supply; what the flash was about to do stays half done."""
        self.due.power_off()
        self.due.usb_read()

    def restore_power(self) -> None:
        """Bring the supply back."""
        self.due.power_on()

    def register(self, address: int) -> int:
        """Value of a register of the chip."""
        return int.from_bytes(self.due.peek(address, 4), "little")

    def press_stop(self) -> None:
        """Open the stop switch, or cut its wire: the pin is left to its pull-up."""
        self.due.set_pin(STOP_PIN, "open")

    def release_stop(self) -> None:
        """Close the stop switch again."""
        self.due.set_pin(STOP_PIN, "low")

    def reset(self) -> None:
        """Press the reset button."""
        self.due.set_nrst(True)
        self.advance(10)
        self.due.set_nrst(False)
        self.advance(30)

    def stack_used_bytes(self) -> int:
        """How deep the stack has been since the reset."""
        bottom, top = self.image.symbols["__stack_bottom"], self.image.symbols["__stack_top"]
        words = np.frombuffer(self.due.peek(bottom, top - bottom), dtype="<u4")
        return top - bottom - 4 * int(np.argmax(words != PAINT))

    def connect(self) -> Heli:
        """A host's session with it."""
        session = Session(self, session_number=1)
        session.connect()
        return Heli(session)

    # -- the transport --

    def read(self, timeout_s: float) -> bytes:
        for _ in range(max(1, round(1e3 * timeout_s))):
            received = self.advance(1)
            if received:
                return received
        return b""

    def write(self, data: bytes) -> None:
        self.due.usb_write(data)

    def now_s(self) -> float:
        return 1e-6 * (self.due.now_us - self._start_us)

    def wall_ns(self) -> int:
        return round(1e9 * self.now_s())

    def close(self) -> None:
        """Nothing to let go of."""

    def reopen(self) -> Board:
        return self


def flying_board_and_host(elf: Path, image: Image) -> tuple[Board, Heli]:
    """A board that flies the arm, and its host."""
    board = Board(elf, image, Arm())
    heli = board.connect()
    heli.take_off(0.0)
    assert board.on()
    return board, heli


SCRATCH: Final = 0x2007_F000
"""Memory that no variable and no stack of the firmware uses; the linker fills SRAM0 from below."""
_STACK_POINTER, _LINK, _PC = 13, 14, 15
_MAX_STEPS_MS: Final = 100


def halt_at(board: Board, symbol: str, max_us: float = 2500.0) -> None:
    """Let time pass until the firmware comes to a function; then it goes by steps."""
    address = board.image.symbols[symbol] & ~1
    board.due.add_breakpoint(address)
    board.due.run_us(max_us)
    assert board.due.halt == "breakpoint", f"the firmware does not come to {symbol}"
    board.due.remove_breakpoint(address)
    board.due.resume()


def enter(board: Board, symbol: str, *arguments: int) -> int:
    """Set the processor to the first instruction of a function; the address that it returns to."""
    due = board.due
    back = due.reg(_PC)
    for index, argument in enumerate(arguments):
        due.set_reg(index, argument & 0xFFFF_FFFF)
    due.set_reg(_LINK, back | 1)
    due.set_reg(_PC, board.image.symbols[symbol] & ~1)
    return back


def call(board: Board, symbol: str, *arguments: int) -> int:
    """The result of a function, called at the processor's present instruction, to which it returns."""
    due = board.due
    saved = [due.reg(index) for index in range(16)]
    back = enter(board, symbol, *arguments)
    due.add_breakpoint(back)
    # Interrupts go on meanwhile, and come back to where they were.
    for _ in range(_MAX_STEPS_MS):
        due.run_us(1000.0)
        if due.halt == "breakpoint":
            break
    assert due.halt == "breakpoint", f"{symbol} does not return"
    due.remove_breakpoint(back)
    due.resume()
    assert due.reg(_STACK_POINTER) == saved[_STACK_POINTER]
    result = due.reg(0)
    for index, value in enumerate(saved):
        due.set_reg(index, value)
    return result


GIVE_UP: Final = "_ZN4heli3due6faults7give_upEv"
TICK: Final = "_ZN4heli4Core4tickENS_10TickTimingE"
POLL: Final = "_ZN4heli4Core4pollEv"
BRANCH_TO_SELF: Final = b"\xfe\xe7"
MASKED_BRANCH_TO_SELF: Final = b"\x72\xb6\xfe\xe7"
RETURN: Final = b"\x70\x47"
TICK_TIMER_CONTROL: Final = 0x40084000
CLOCK_DISABLE: Final = 1 << 1
TRAVEL: Final = 2
SLOWEST_Hz, FASTEST_Hz = 20_000, 44_000
"""Range of the slow clock, over parts and temperature."""
KICK_INTERVAL_MS: Final = 16


@dataclass(frozen=True)
class Hang:
    """One way to hang."""

    name: str
    # Linker symbol of the function whose first instructions are overwritten; empty for none
    function: str = ""
    code: bytes = b""  # With what
    edge: bool = False  # Whether an edge of the travel encoder sets it off
    stopped_timer: bool = False  # Whether the tick's timer is stopped

    @contextmanager
    def of(self, board: Board) -> Iterator[None]:
        """Hang now; on the way out the program is whole again."""
        address = board.image.symbols[self.function] & ~1 if self.function else 0
        original_code = board.due.peek(address, len(self.code)) if self.code else b""
        if self.code:
            board.due.poke(address, self.code)
        if self.edge:
            board.due.schedule_step(TRAVEL, direction=1, when_us=board.due.now_us + 1.0)
        if self.stopped_timer:
            board.due.poke(TICK_TIMER_CONTROL, struct.pack("<I", CLOCK_DISABLE))
        try:
            yield
        finally:
            if original_code:
                board.due.poke(address, original_code)

    def __str__(self) -> str:
        return self.name


HANGS: Final = (
    Hang("tick hangs", TICK, BRANCH_TO_SELF),
    Hang("idle loop hangs", POLL, BRANCH_TO_SELF),
    Hang("idle loop hangs with interrupts masked", POLL, MASKED_BRANCH_TO_SELF),
    Hang("encoder interrupt is stuck", "encoder_interrupt", RETURN, edge=True),
    Hang("tick interrupt is stuck", "tick_interrupt", RETURN),
    Hang("tick never comes again", stopped_timer=True),
)


def armed_board(elf: Path, image: Image, slow_Hz: int) -> Board:
    """A board with both bridges on and nothing on its motors."""
    board = Board(elf, image)
    board.due.set_slow_clock(slow_Hz)
    board.connect().arm()
    assert board.on()
    return board


def off_after_ms(elf: Path, image: Image, hang: Hang, slow_Hz: int, phase_ms: int) -> float:
    """How long after a hang the bridges are off [ms]."""
    board = armed_board(elf, image, slow_Hz)
    board.advance(phase_ms)
    with hang.of(board):
        return board.milliseconds_until_off(step_us=100.0)


RX_BYTES: Final = 20_000
EDGES: Final = 20_000
EDGE_INTERVAL_US: Final = 5.0
"""200,000 edges a second."""
EDGES_ONE_WAY: Final = 10
HELLO_INTERVAL_MS: Final = 2
PATIENCE_MS: Final = 1000


def boot_to_first_frame_ms(board: Board) -> float:
    """Switch the power off and on; how long until a host that greets has the first frame [ms]."""
    board.cut_power()
    board.restore_power()
    start_us = board.due.now_us
    parser = FrameParser()
    for k in range(PATIENCE_MS):
        if k % HELLO_INTERVAL_MS == 0:
            board.write(
                encode_frame(
                    d.MessageId.HELLO,
                    k & 0xFF,
                    d.HelloMessage(request=1, link_hash=d.LINK_HASH, session=1).pack(),
                )
            )
        if parser.feed(board.advance(1)):
            return 1e-3 * (board.due.now_us - start_us)
    raise AssertionError("the board sends nothing")


def _exchange(board: Board, sent: bytes, wanted: d.MessageId) -> Frame:
    board.write(sent)
    parser = FrameParser()
    for _ in range(PATIENCE_MS):
        for frame in parser.feed(board.advance(1)):
            if frame.id == wanted:
                return frame
    raise AssertionError(f"the board does not answer with {wanted.name}")


def _frames_ok(board: Board) -> int:
    request = encode_frame(d.MessageId.STATUS_READ, 0, d.StatusReadMessage(1).pack())
    return d.StatusMessage.unpack(_exchange(board, request, d.MessageId.STATUS).payload).frames_ok


def rx_lost_bytes(board: Board) -> int:
    """Send 20,000 bytes in a row under full telemetry; how many of them the firmware did not get."""
    board.advance(20)
    hello = encode_frame(
        d.MessageId.HELLO, 0, d.HelloMessage(request=1, link_hash=d.LINK_HASH, session=1).pack()
    )
    _exchange(board, hello, d.MessageId.WELCOME)
    before = _frames_ok(board)
    size = len(encode_frame(d.MessageId.PING, 0, d.PingMessage(0, 0).pack()))
    frames = [
        encode_frame(d.MessageId.PING, k % 256, d.PingMessage(0, k).pack())
        for k in range(RX_BYTES // size + 1)
    ]
    board.write(b"".join(frames))
    board.advance(round(sum(map(len, frames)) / 25) + 50)
    # The second question for the count is a frame too.
    received = _frames_ok(board) - before - 1
    return (len(frames) - received) * size + board.due.uart_overruns


def travel_counts_lost(board: Board) -> int:
    """Turn the travel encoder to and fro at 200,000 edges a second while the law flies; edges not counted."""
    heli = board.connect()
    heli.arm()
    heli.control()
    board.due.clear_stats()
    # To and fro, so that no limit on rate or angle ends the flight meanwhile.
    start_us = board.due.now_us
    net = 0
    for k in range(EDGES):
        direction = 1 if k // EDGES_ONE_WAY % 2 == 0 else -1
        net += direction
        board.due.schedule_step(d.Axis.TRAVEL, direction, start_us + 10.0 + EDGE_INTERVAL_US * k)
    heli.wait(1e-6 * EDGES * EDGE_INTERVAL_US + 0.02)
    assert heli.motors_may_run, "the flight ended while edges came"
    handled = board.due.exception_stats(TRAVEL_INTERRUPT).count
    latest = heli.session.latest
    assert latest is not None
    miscounted = abs(int(latest.raw[d.Channel.TRAVEL_COUNT]) - net)
    return EDGES - handled + miscounted + heli.session.status().illegal_travel


def longest_off_after_hang_ms(elf: Path, image: Image) -> float:
    """Return the longest time [ms] that motors stay on, over all hangs, slow clocks and phases."""
    return max(
        off_after_ms(elf, image, hang, slow_Hz, phase_ms)
        for hang in HANGS
        for slow_Hz in (SLOWEST_Hz, FASTEST_Hz)
        for phase_ms in range(KICK_INTERVAL_MS)
    )


# A and B of elevation, pitch and travel.
ENCODERS: Final = (("PC25", "PC26"), ("PD0", "PD1"), ("PB25", "PB27"))
# RPWM, LPWM, R_EN, L_EN of front and back; low means on.
FRONT: Final = ("PC24", "PC23", "PC1", "PB21")
BACK: Final = ("PC22", "PC21", "PA19", "PD2")
STOP: Final = "PD6"


class RewiredBoard(Board):
    """A board with inverting stages before its drivers, and a stop that closes to ground."""

    def __init__(self, elf: Path, image: Image) -> None:
        super().__init__(elf, image, Arm())

    def connect_wires(self) -> None:
        """Attach encoders, pull-ups of the enables, and an open stop switch."""
        for a, b in ENCODERS:
            self.due.attach_encoder(a, b)
        for _, _, right, left in (FRONT, BACK):
            self.due.set_pin(right, "pull-up")
            self.due.set_pin(left, "pull-up")
        self.due.set_pin(STOP, "open")

    def duties(self) -> list[float]:
        """Return what acts on the motors, -1 to 1."""
        return [
            (self.due.pin_duty(left_pwm) - self.due.pin_duty(right_pwm))
            * (not self.due.pin(right) and not self.due.pin(left))
            for right_pwm, left_pwm, right, left in (FRONT, BACK)
        ]

    def off(self) -> bool:
        """Return whether every enable is high."""
        return all(self.due.pin(pin) for _, _, *enables in (FRONT, BACK) for pin in enables)

    def on(self) -> bool:
        """Return whether every enable is low."""
        return not any(self.due.pin(pin) for _, _, *enables in (FRONT, BACK) for pin in enables)

    def bridges_idle(self) -> bool:
        """Return whether all four PWM pins stay high."""
        return all(self.due.pin_duty(pin) == 1.0 for pins in (FRONT, BACK) for pin in pins[:2])

    def pwm_high(self) -> bool:
        """Return whether all four PWM pins are high now."""
        return all(self.due.pin(pin) for pins in (FRONT, BACK) for pin in pins[:2])

    def press_stop(self) -> None:
        """Close the stop switch to ground."""
        self.due.set_pin(STOP, "low")

    def angles_deg(self) -> tuple[float, float, float]:
        """Return elevation, pitch and travel of the arm."""
        assert self.arm is not None
        elevation, pitch, travel = (math.degrees(angle) for angle in self.arm.state[:3])
        return elevation, pitch, travel


def open_loop(heli: Heli, front_V: float, back_V: float) -> None:
    heli.session.command(d.ParamSetMessage(0, d.Param.BUMPLESS_S, 0.02))
    heli.session.command(d.ParamSetMessage(0, d.Param.MOTOR_MIN_V, -24.0))
    heli.arm()
    heli.control(d.Axes(0), front_V=front_V, back_V=back_V)
    heli.wait(0.5)


def store(board: Board, address: int, value: int) -> None:
    board.due.poke(address, struct.pack("<I", value))


class FaultRecord(NamedTuple):
    """The record of a fault that outlasts a reset, in the order of the backup registers."""

    record: int
    pc: int
    lr: int
    cfsr: int
    bfar: int
    boots: int


def recorded(board: Board) -> FaultRecord:
    return FaultRecord(*(board.register(GPBR + 4 * k) for k in range(6)))
