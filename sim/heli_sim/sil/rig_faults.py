"""Faults of the rig: an unplugged or wrong encoder, a pressed stop switch, a supply that is switched off."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Final, Protocol

from heli_host.declaration import AXES

from heli_sim import _native
from heli_sim.errors import OptionError
from heli_sim.sil.intervals import Interval, edges_of, next_edge

_MAX_SCALE: Final = 16.0
"""Largest scale of an encoder: discs of 1000 to 16000 lines are sold."""


class _SimBoard(Protocol):
    def set_stop(self, pressed: bool) -> None: ...


@dataclass(frozen=True)
class RigFaults:
    """Faults of the rig with their times."""

    encoders_out: tuple[tuple[str, Interval], ...] = ()
    """Axes whose encoder is unplugged, and when: motion in this time is not counted."""
    stop_switch: tuple[Interval, ...] = ()  # Times in which the hardware stop input is active
    supply_out: tuple[Interval, ...] = ()
    """Times in which the motors have no supply, although the board commands a voltage."""
    encoder_scales: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Counts of each encoder per count in the rig file: 0.5 for an encoder with half the counts, -1 for one
    that is wired backwards. The board does not know them."""
    motor_signs: tuple[int, int] = (1, 1)  # -1 for a motor, front or back, whose leads are exchanged
    motors_swapped: bool = False
    """The front output drives the back motor, and the back output the front motor."""

    def __post_init__(self) -> None:
        for axis, _ in self.encoders_out:
            if axis not in AXES:
                raise OptionError(f"unknown encoder '{axis}'", f"choose {', '.join(AXES)}")
        for scale in self.encoder_scales:
            if not (math.isfinite(scale) and 0.0 < abs(scale) <= _MAX_SCALE):
                raise OptionError(
                    f"an encoder's scale of {scale:g} is out of range",
                    f"give a number from -{_MAX_SCALE:g} to {_MAX_SCALE:g}, but not 0",
                )

        if not set(self.motor_signs) <= {-1, 1}:
            raise OptionError(f"motor signs {self.motor_signs} are invalid", "give 1 or -1 for each")

    @property
    def uncompared_signs(self) -> dict[str, float]:
        """Return 0 as the sign of each motor with wrong wires.

        Sign 0 means "unknown": the host then does not compare the sign in the board with the rig.
        """
        wires_are_wrong = (self.motors_swapped or sign < 0 for sign in self.motor_signs)
        names = ("motor_front_sign", "motor_back_sign")
        return {name: 0.0 for name, is_wrong in zip(names, wires_are_wrong, strict=True) if is_wrong}

    def next_edge(self, tick: int) -> int:
        """Return the first tick after a given one at which a fault begins or ends."""
        return next_edge(self._edges, tick)

    @cached_property
    def _edges(self) -> tuple[int, ...]:
        encoders_out = (interval for _, interval in self.encoders_out)
        return edges_of((*encoders_out, *self.stop_switch, *self.supply_out))

    def apply(self, tick: int, native: _native.World, board: _SimBoard) -> None:
        """Apply the faults that are active at a tick to the simulated rig."""
        if self.encoders_out:
            native.encoders_out = [
                any(name == axis and interval.holds(tick) for name, interval in self.encoders_out)
                for axis in AXES
            ]
        if self.stop_switch:
            board.set_stop(any(interval.holds(tick) for interval in self.stop_switch))
        if self.supply_out:
            native.supply_on = not any(interval.holds(tick) for interval in self.supply_out)
