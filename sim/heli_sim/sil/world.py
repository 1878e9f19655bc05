"""One simulated rig with its board and link, with simulated time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
from heli_host.arrays import Floats

from heli_sim import _native
from heli_sim.due.errors import BoardStopped
from heli_sim.plant import Plant
from heli_sim.rig import Rig
from heli_sim.rig.board import in_simulation, parameters_of
from heli_sim.rig.encoders import count_rad, directions
from heli_sim.sil.arm_support import support_arm
from heli_sim.sil.boards import make_board, resolved
from heli_sim.sil.faults import FaultyStream
from heli_sim.sil.flash_pages import saved
from heli_sim.sil.options import SilOptions
from heli_sim.sil.plant_factory import plant_of

# Counters of the encoders stand anywhere at power-up.
_OFFSET_COUNTS: Final = 50_000.0
ERASING_BAUD: Final = 1200


def set_from_rig(options: SilOptions, rig: Rig) -> dict[str, float]:
    """Return the parameters that a simulated board takes from its rig instead of the defaults. Return none if
    `options` name an existing flash file: then its parameters are used.
    """
    if options.flash_file and Path(options.flash_file).exists():
        return {}
    return in_simulation(rig)


class SilWorld:
    """A board, its serial line with faults, power stage and plant.

    Parameters
    ----------
    plant : Plant or None
        Plant to fly instead of the one that the options ask for.
    boot_seed : int or None
        Seed of the boot ids. None takes the options' seed, so that a simulation repeats; who serves a board
        to other processes gives a random one, as two power-ups of a real board have nothing in common.

    Raises
    ------
    RigError
        When the rig cannot be read, or its board cannot be set to its counts, rest angle or supply.
    EffectError
        When an effect is unknown or has a value that it may not have.
    PlantError
        When the plant cannot be compiled.
    DueError
        When there is no firmware for the emulated Due, or only for another version of the link.
    """

    def __init__(
        self, options: SilOptions, plant: Plant | None = None, *, boot_seed: int | None = None
    ) -> None:
        self.options = options = resolved(options)
        self.rig_faults = options.rig_faults
        """What goes wrong on the rig; may be replaced while time stands, for what comes then."""
        self.plant = plant if plant is not None else plant_of(options)
        self.rig: Rig = self.plant.rig
        random = np.random.default_rng(options.seed)
        scales = np.array(options.rig_faults.encoder_scales)
        counts_per_rad = directions(self.rig) * scales / count_rad(self.rig)
        self.board = make_board(options, options.seed if boot_seed is None else boot_seed)
        """The board; its ``sim`` is what the world drives."""
        self.rig_source = options.rig if plant is None else self.rig.name
        """Name or file of the rig."""
        self.rig_parameters: Mapping[str, float] = (
            parameters_of(self.rig) | options.rig_faults.uncompared_signs
        )
        """Parameters of the board that the rig determines."""
        self.set_from_rig: Mapping[str, float] = set_from_rig(options, self.rig)
        """Those that the board starts with instead of its defaults."""
        if self.set_from_rig:
            self.board.fill_flash(saved(self.set_from_rig))
        self.native = _native.World(
            self.plant.native_step(),
            self.plant.rest_state().tolist(),
            self.plant.parameters.tolist(),
            supply_V=self.rig["supply"].value,
            dead_band=self.rig["driver_dead_band"].value,
            counts_per_rad=counts_per_rad.tolist(),
            offset_count=random.uniform(-_OFFSET_COUNTS, _OFFSET_COUNTS, 3).tolist(),
            board=self.board.sim,
        )
        wiring = options.rig_faults
        self.native.wire_motors(wiring.motors_swapped, wiring.motor_signs)
        support_arm(self.plant, self.native)
        self.to_board = FaultyStream(options.faults, options.seed, 0)
        self.to_host = FaultyStream(options.faults, options.seed, 1)
        self.host_reading = True
        """Whether the host takes bytes; while it does not, the bridge towards it overflows."""
        self._held = b""
        self._was_unplugged = False

    @property
    def tick(self) -> int:
        """Simulated milliseconds so far."""
        return self.native.tick

    @property
    def time_s(self) -> float:
        """Simulated seconds so far."""
        return self.native.tick * 1e-3

    @property
    def unplugged(self) -> bool:
        """Whether the plan of faults has the cable unplugged now."""
        return self.options.faults.unplugged(self.native.tick)

    @property
    def state(self) -> Floats:
        """True state of the plant, in the order of ``plant.rest_state()``. Set it to push the arm."""
        return np.array(self.native.state)

    @state.setter
    def state(self, state: Sequence[float] | Floats) -> None:
        self.native.state = [float(value) for value in state]

    def advance(
        self, ticks: int, rx: bytes = b"", *, until_output: bool = False, min_ticks: int = 1
    ) -> bytes:
        """Simulate some time and return the bytes that reached the host.

        Parameters
        ----------
        ticks : int
            Largest number of ticks (1 ms each) to simulate.
        rx : bytes
            Bytes that the host writes now.
        until_output : bool
            Return as soon as bytes reached the host.
        min_ticks : int
            With `until_output`: number of ticks that are simulated in any case.

        Raises
        ------
        BoardStopped
            When the emulated Due met what the chip does not promise to take.
        """
        faults = self.options.faults
        self._held += self.to_board.pass_through(rx)
        received = b""
        while ticks > 0 and not (until_output and received and min_ticks <= 0):
            tick = self.native.tick
            unplugged, stalled = faults.unplugged(tick), faults.stalled(tick)
            if unplugged or self._was_unplugged:
                self.native.unplug()
            if unplugged:
                self._held = b""
            self._was_unplugged = unplugged
            self.native.host_reading = self.host_reading and not (stalled or unplugged)
            write = b"" if stalled else self._held
            if write:
                self._held = b""
            max_ticks = min(ticks, min_ticks) if until_output and received else ticks
            self.rig_faults.apply(tick, self.native, self.board.sim)
            edge = min(faults.next_edge(tick), self.rig_faults.next_edge(tick))
            passed, data = self._pass(min(max_ticks, edge - tick), write, until_output, max(1, min_ticks))
            received += data
            ticks -= passed
            min_ticks -= passed
        return self.to_host.pass_through(received)

    def reset_board(self) -> None:
        """Pulse the board's reset line: the motors go off immediately, and the flight code starts 205 ms
        later.
        """
        self.board.sim.reset()

    def cycle_power(self) -> None:
        """Switch the board's supply off and on: only the content of its flash and the line remain."""
        self.board.sim.power_cycle()

    def control_lines(self, *, dtr: bool, baud: int) -> None:
        """Act as the Due's USB interface (16U2) when the host changes DTR to `dtr`. A rising line resets the
        board. At a `baud` of 1200 any change erases the flash, and the board then waits for a program.
        """
        if baud == ERASING_BAUD:
            self.board.sim.erase()
        elif dtr:
            self.reset_board()

    def counters(self) -> dict[str, int]:
        """Bytes carried, lost and damaged so far: the line's counters, and flipped_bits, dropped_bytes and
        doubled_bytes of both directions.
        """
        both = (self.to_board.counters, self.to_host.counters)
        line = self.native.line_counters()
        return {
            **line,
            "to_board_overflow": line["to_board_overflow"] + self.board.bytes_lost,
            "flipped_bits": sum(counters.flipped for counters in both),
            "dropped_bytes": sum(counters.dropped for counters in both),
            "doubled_bytes": sum(counters.doubled for counters in both),
        }

    def _pass(self, ticks: int, write: bytes, until_output: bool, min_ticks: int) -> tuple[int, bytes]:
        try:
            passed = self.native.advance(ticks, write, until_output, min_ticks)
        except self.board.stops as error:
            raise BoardStopped(
                f"the emulated Due stopped: {error}", "correct the firmware; see docs/how-to/gdb.md"
            ) from error
        self.board.keep_flash()
        return passed
