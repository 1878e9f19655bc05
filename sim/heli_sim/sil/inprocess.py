"""The simulated board as a transport of heli_host, in the same process and on simulated time.

This file implements the protocol `heli_host.link.transport.Transport`.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from heli_host.errors import LinkLost, PortError

from heli_sim.sil.world import SilWorld

# 2024-01-01 00:00 UTC. Logs of simulated flights start here, so that the same flight gives the same bytes.
EPOCH_ns: Final = 1_704_067_200_000_000_000
# Time that passes while a host finds the port gone and looks again.
_RETRY_TICKS: Final = 100


class InProcessTransport:
    """Transport to a simulated board; time advances only in `read`."""

    lockstep: Final = True

    def __init__(
        self,
        world: SilWorld,
        url: str = "sil://",
        label: str = "",
        note: str = "",
        recipe: Mapping[str, str] = MappingProxyType({}),
    ) -> None:
        self.url = url
        self.world = world
        self._written = bytearray()
        self.label = label
        self.recipe = recipe
        self.rig = world.rig_source
        self.rig_parameters = world.rig_parameters
        self.note = note
        self._closed = False
        self._speed = world.options.speed
        if world.unplugged:
            # Time must pass, or the cable would never be plugged in again.
            world.advance(_RETRY_TICKS)
            raise PortError("the simulated cable is unplugged", "wait until it is plugged in again")
        if world.options.reset_on_open:
            world.reset_board()
        self._start_s = time.monotonic() - (world.time_s / self._speed if self._speed else 0.0)

    def read(self, timeout_s: float) -> bytes:
        """Advance simulated time until bytes arrive, by `timeout_s` at most; return them, or empty bytes."""
        self._check_open()
        ticks = max(1, round(1e3 * timeout_s))
        written = bytes(self._written)
        self._written.clear()
        min_ticks = min(ticks, self.world.options.slice_ms)
        received = self.world.advance(ticks, written, until_output=True, min_ticks=min_ticks)
        if self._speed:
            ahead_s = self._start_s + self.world.time_s / self._speed - time.monotonic()
            if ahead_s > 0.0:
                time.sleep(ahead_s)
        return received

    def write(self, data: bytes) -> None:
        """Pass `data` to the serial line, which begins to carry it at the next `read`. Raises LinkLost when
        the transport is closed, or while the plan of faults has the cable unplugged.
        """
        self._check_open()
        self._written += data

    def now_s(self) -> float:
        """Seconds of simulated time since the simulation started."""
        return self.world.time_s

    def wall_ns(self) -> int:
        """Date and time of the simulation in nanoseconds since 1970: a fixed date plus simulated time."""
        return EPOCH_ns + self.world.tick * 1_000_000

    def close(self) -> None:
        """Close the transport; the simulated world does not change. Further calls do nothing."""
        self._closed = True

    def reopen(self) -> InProcessTransport:
        """Open the port of the same board by a new transport, after 0.1 s of simulated time; this transport
        stays closed. A PortError while the plan of faults has the cable unplugged.
        """
        return InProcessTransport(self.world, self.url, self.label, self.note, self.recipe)

    def _check_open(self) -> None:
        """Raise LinkLost if the port is closed or the simulated cable is unplugged."""
        if self._closed:
            raise LinkLost("the simulated port is closed", "open it again")
        if self.world.unplugged:
            self._closed = True
            raise LinkLost("the simulated cable was pulled out", "open the port again after a while")
