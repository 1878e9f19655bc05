"""Faults of the rig, and movements by hand, which a person types while a simulated board runs."""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import replace
from typing import Final

from heli_host.declaration import AXES

from heli_sim.sil.faults import Interval, RigFaults
from heli_sim.sil.world import SilWorld

_MAX_BYTES: Final = 4096
_MAX_ANGLE_deg: Final = 360.0
_AXES: Final = "|".join(AXES)
HELP: Final = (
    f"stop, release, pull {_AXES}, plug {_AXES}, supply off, supply on, turn {_AXES} DEG, let {_AXES}, help"
)
"""The lines that are understood."""


class FaultConsole:
    """Applies typed faults to a simulated world. Each line is one fault; it lasts until another line ends
    it.
    """

    def __init__(self, world: SilWorld, fd: int, say: Callable[[str], None]) -> None:
        self._world = world
        self._fd = fd
        self._say = say
        self._unfinished = b""
        self._ended = False

    def watched(self) -> list[int]:
        """File descriptors to wait for: the input of the lines, while this process may read it."""
        return [] if self._ended or self._in_background() else [self._fd]

    def listen(self, ready: list[int]) -> None:
        """Read all lines that have arrived, and apply each."""
        if self._fd not in ready:
            return
        try:
            data = os.read(self._fd, _MAX_BYTES)
        except OSError:
            # A terminal that was closed.
            data = b""
        self._ended = not data
        *lines, unfinished = (self._unfinished + data).split(b"\n")
        self._unfinished = unfinished[:_MAX_BYTES]
        for line in lines:
            if words := line.decode("ascii", "replace").split():
                self._say(f"{self._world.time_s:.1f} s: {self.obey(words)}")

    def obey(self, words: list[str]) -> str:
        """Apply a line from the next tick on."""
        faults = self._world.rig_faults
        match words:
            case ["stop"]:
                faults = replace(faults, stop_switch=(*faults.stop_switch, self._interval_from_now()))
                text = "the stop switch is pressed"
            case ["release"]:
                faults = replace(faults, stop_switch=self._until_now(faults.stop_switch))
                text = "the stop switch is released"
            case ["pull", axis] if axis in AXES:
                faults = replace(
                    faults, encoders_out=(*faults.encoders_out, (axis, self._interval_from_now()))
                )
                text = f"the {axis} encoder is unplugged"
            case ["plug", axis] if axis in AXES:
                faults = replace(faults, encoders_out=self._set_plugged(faults, axis))
                text = f"the {axis} encoder is plugged in: it counts from where it stopped"
            case ["supply", "off"]:
                faults = replace(faults, supply_out=(*faults.supply_out, self._interval_from_now()))
                text = "the motors have no supply"
            case ["supply", "on"]:
                faults = replace(faults, supply_out=self._until_now(faults.supply_out))
                text = "the motors have their supply"
            case ["turn", axis, angle] if axis in AXES and _is_angle(angle):
                self._hold_axis(axis, math.radians(float(angle)))
                text = f"a hand turns {axis} to {float(angle):g} degrees, and holds it"
            case ["let", axis] if axis in AXES:
                self._hold_axis(axis, math.nan)
                text = f"the hand lets go of {axis}"
            case ["help"]:
                text = HELP
            case _:
                text = f"this cannot be rehearsed; say {HELP}"
        self._world.rig_faults = faults
        return text

    def _hold_axis(self, axis: str, angle_rad: float) -> None:
        """Hold an axis at an angle, as a person's hand would."""
        native = self._world.native
        hand_rad = list(native.hand_rad)
        hand_rad[AXES.index(axis)] = angle_rad
        native.hand_rad = hand_rad

    def _interval_from_now(self) -> Interval:
        return Interval(self._world.time_s)

    def _until_now(self, spans: tuple[Interval, ...]) -> tuple[Interval, ...]:
        """End the intervals that last now."""
        tick = self._world.tick
        # One that begins with this very tick has not been noticed yet, and has no length.
        return tuple(
            replace(interval, duration_s=self._world.time_s - interval.start_s)
            if interval.holds(tick)
            else interval
            for interval in spans
            if interval.edges()[0] != tick
        )

    def _set_plugged(self, faults: RigFaults, axis: str) -> tuple[tuple[str, Interval], ...]:
        intervals_of_axis = tuple(interval for name, interval in faults.encoders_out if name == axis)
        others = tuple(pair for pair in faults.encoders_out if pair[0] != axis)
        return (*others, *((axis, interval) for interval in self._until_now(intervals_of_axis)))

    def _in_background(self) -> bool:
        """Whether a read would suspend this process, because a shell started it with ``&`` and owns the
        terminal.
        """
        try:
            return os.tcgetpgrp(self._fd) != os.getpgrp()
        except OSError:
            return False


def _is_angle(text: str) -> bool:
    """Whether a text is an angle within the range of the axes."""
    try:
        return abs(float(text)) <= _MAX_ANGLE_deg
    except ValueError:
        return False
