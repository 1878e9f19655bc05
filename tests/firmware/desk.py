"""The firmware on an emulated board, with the simulated arm on its pins and a host on its port."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from due_emulator import new_due, read_image
from heli_host.fly.heli import Heli
from heli_host.link.session import Session
from heli_sim.due._due_board import motor_duty, motor_enabled, wire
from heli_sim.model import PaperModel
from heli_sim.plant import Plant
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
