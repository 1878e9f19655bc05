"""The simulated world: board, plant, line, faults, and the operator who supports the arm until take-off."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
from heli_host.data.arrays import Floats
from heli_host.declaration import PARAMS, PARAMS_HASH

from heli_sim import _native
from heli_sim.errors import BoardStopped
from heli_sim.model.plant import Plant
from heli_sim.rig import Rig
from heli_sim.rig.board import in_simulation, parameters_of
from heli_sim.rig.rig import count_rad, directions
from heli_sim.sil.boards import make_board, resolved
from heli_sim.sil.faults import FaultyStream
from heli_sim.sil.options import SilOptions, plant_of

_TOUCH_RAD: Final = np.deg2rad(0.2)


def support_arm(plant: Plant, native: _native.World) -> None:
    """Lock the elevation of the arm in a world, `native`, while it is on its table with the motors off."""
    # The world checks this condition every 5 ms. If the arm of the `plant` stays on the table without
    # support, or if the axis is locked for another reason, nothing changes.
    rest = plant.rest_state()
    after, _ = plant.step(rest, (0.0, 0.0))
    if float(after[3]) > 0.0:
        native.support_below(float(rest[0] + _TOUCH_RAD))


_SET_BYTES: Final = 512
_MAGIC: Final = 0x5048
_FORMAT: Final = 2
_FLASH_BYTES: Final = 2048


def saved(values: Mapping[str, float]) -> bytes:
    """Return the flash of a board that saved these `values` once; other parameters have the declared
    defaults.
    """
    head = struct.pack("<HBBII", _MAGIC, _FORMAT, len(PARAMS), PARAMS_HASH, 1)
    entries = (struct.pack("<Hf", spec.id, values.get(spec.name, spec.default)) for spec in PARAMS)
    page = (head + b"".join(entries)).ljust(_SET_BYTES - 4, b"\xff")
    page += struct.pack("<I", zlib.crc32(page))
    return (page + page).ljust(_FLASH_BYTES, b"\xff")


_OFFSET_COUNTS: Final = 50_000.0
"""Bound of the random values that the encoder counters have at power-up."""
ERASING_BAUD: Final = 1200
"""Baud rate by which a host asks the USB chip of a Due to erase the flash."""


def set_from_rig(options: SilOptions, rig: Rig) -> dict[str, float]:
    """Return the parameters that a simulated board takes from its rig instead of its defaults."""
    # The result is empty if `options` name an existing flash file, because the board then uses its
    # parameters.
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
        Seed of the boot ids. By default, it is the seed of the options, so that a simulation repeats. A
        server of boards gives a random one, because a real board has a new boot id at each power-up.

    Raises
    ------
    RigError
        If the rig cannot be read, or if no parameters of the board suit its counts, rest angle or supply.
    EffectError
        If an effect is unknown or has an invalid value.
    PlantError
        If the plant cannot be compiled.
    DueError
        If the firmware for the emulated Due is missing, or has another version of the link.
    """

    def __init__(
        self, options: SilOptions, plant: Plant | None = None, *, boot_seed: int | None = None
    ) -> None:
        self.options = options = resolved(options)
        self.rig_faults = options.rig_faults
        """Faults of the rig. Replace them between two calls of `advance` to change later faults."""
        self.plant = plant if plant is not None else plant_of(options)
        self.rig: Rig = self.plant.rig
        random = np.random.default_rng(options.seed)
        scales = np.array(options.rig_faults.encoder_scales)
        counts_per_rad = directions(self.rig) * scales / count_rad(self.rig)
        self.board = make_board(options, options.seed if boot_seed is None else boot_seed)
        """The board; the world simulates its ``sim``."""
        self.rig_source = options.rig if plant is None else self.rig.name
        """Name or file of the rig."""
        self.rig_parameters: Mapping[str, float] = (
            parameters_of(self.rig) | options.rig_faults.uncompared_signs
        )
        """Parameters of the board that the rig determines."""
        self.set_from_rig: Mapping[str, float] = set_from_rig(options, self.rig)
        """Parameters from the rig that the board starts with instead of its defaults."""
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
        self.to_board = FaultyStream(options.faults, options.seed, direction=0)
        self.to_host = FaultyStream(options.faults, options.seed, direction=1)
        self.host_reading = True
        """Whether the host reads; otherwise, the bridge towards it overflows."""
        self._undelivered = b""
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
        """Whether the cable is unplugged now, according to the plan of faults."""
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
            With `until_output`: number of ticks to simulate even if bytes arrive earlier.

        Raises
        ------
        BoardStopped
            If the firmware uses the emulated Due in a way that the data sheet of the chip does not permit.
        """
        self._undelivered += self.to_board.pass_through(rx)
        received, elapsed_ticks = b"", 0
        while elapsed_ticks < ticks:
            remaining_ticks, remaining_min_ticks = ticks - elapsed_ticks, min_ticks - elapsed_ticks
            if until_output and received:
                if remaining_min_ticks <= 0:
                    break
                remaining_ticks = min(remaining_ticks, remaining_min_ticks)
            tick = self.native.tick
            to_deliver = self._apply_cable_faults(tick)
            self.rig_faults.apply(tick, self.native, self.board.sim)
            # Faults begin and end at edges, and are constant between them.
            edge = min(self.options.faults.next_edge(tick), self.rig_faults.next_edge(tick))
            step_ticks, sent = self._advance_native(
                min(remaining_ticks, edge - tick),
                to_deliver,
                until_output,
                max(1, remaining_min_ticks),  # the native world refuses a minimum that is over
            )
            received += sent
            elapsed_ticks += step_ticks
        return self.to_host.pass_through(received)

    def _apply_cable_faults(self, tick: int) -> bytes:
        """Unplug or stall the line as planned for a tick; return the host's bytes that reach the board."""
        faults = self.options.faults
        is_unplugged, is_stalled = faults.unplugged(tick), faults.stalled(tick)
        # Also when the cable is plugged in again: what the board sent without it is lost.
        if is_unplugged or self._was_unplugged:
            self.native.unplug()
        if is_unplugged:
            self._undelivered = b""
        self._was_unplugged = is_unplugged
        self.native.host_reading = self.host_reading and not (is_stalled or is_unplugged)
        if is_stalled:
            return b""  # the bytes wait, and are not lost
        to_deliver, self._undelivered = self._undelivered, b""
        return to_deliver

    def reset_board(self) -> None:
        """Pulse the board's reset line: the motors stop immediately; 205 ms later the flight code starts."""
        self.board.sim.reset()

    def cycle_power(self) -> None:
        """Switch the board's supply off and on: only the content of its flash, and the link, remain."""
        self.board.sim.power_cycle()

    def control_lines(self, *, dtr: bool, baud: int) -> None:
        """Act as the Due's USB interface (16U2) when the host changes the line DTR.

        Parameters
        ----------
        dtr : bool
            The line after the change. A rise resets the board.
        baud : int
            Rate of the port. At 1200, any change erases the flash, and the board then waits for a program.
        """
        if baud == ERASING_BAUD:
            self.board.sim.erase()
        elif dtr:
            self.reset_board()

    def counters(self) -> dict[str, int]:
        """Return the bytes carried, lost and damaged so far, over both directions.

        The result has the counters of the line, and flipped_bits, dropped_bytes and doubled_bytes.
        """
        streams = (self.to_board.counters, self.to_host.counters)
        line_counters = self.native.line_counters()
        return {
            **line_counters,
            "to_board_overflow": line_counters["to_board_overflow"] + self.board.bytes_lost,
            "flipped_bits": sum(counters.flipped for counters in streams),
            "dropped_bytes": sum(counters.dropped for counters in streams),
            "doubled_bytes": sum(counters.doubled for counters in streams),
        }

    def _advance_native(
        self, ticks: int, to_deliver: bytes, until_output: bool, min_ticks: int
    ) -> tuple[int, bytes]:
        """Simulate without a change of faults; return the elapsed ticks and the bytes that the board sent."""
        try:
            elapsed_ticks = self.native.advance(ticks, to_deliver, until_output, min_ticks)
        except self.board.stops as error:
            raise BoardStopped(
                f"the emulated Due stopped: {error}", "correct the firmware; see docs/how-to/gdb.md"
            ) from error
        self.board.keep_flash()
        return elapsed_ticks
