"""The operator of a simulated rig, who moves its axes and sees which rotor turns."""

from __future__ import annotations

import math
from collections.abc import Callable
from math import nan
from typing import Final

import numpy as np
from heli_host.fly.heli import Heli
from heli_sim.sil.world import SilWorld

from heli_lab.setup.calibrate.operator import HandAction

_LIFTED_deg: Final = 15.0
_TILTED_deg: Final = 20.0
_TURNED_deg: Final = 30.0
_POSITION_TOLERANCE_rad: Final = 1e-6
_TIMEOUT_s: Final = 10.0


class SimulatedOperator:
    """Moves the rig of a simulated board in this process, and confirms every pulse."""

    def __init__(self, heli: Heli, world: SilWorld, report: Callable[[str], None]) -> None:
        self._heli = heli
        self._world = world
        self._report = report
        self._rest_rad = math.radians(world.rig["elevation_min"].value)
        self._turning_rotor = "neither"
        heli.session.subscribe_ticks(lambda _: self._note_turning_rotor())

    def act(self, action: HandAction) -> None:
        """Move the axes as an action requires, and wait until they arrive."""
        self._report(f"hand: {action.text}")
        rest_rad = self._rest_rad
        lifted_rad = rest_rad + math.radians(_LIFTED_deg)
        # First level, then with pitch released.
        steadied_rad = ((lifted_rad, 0.0, 0.0), (lifted_rad, nan, 0.0))
        targets_rad = {
            HandAction.REST: ((rest_rad, 0.0, 0.0), (nan, nan, nan)),
            HandAction.LIFT: ((0.0, 0.0, 0.0),),
            HandAction.FRONT_UP: ((rest_rad, math.radians(_TILTED_deg), 0.0),),
            HandAction.BACK_LEADS: ((rest_rad, 0.0, math.radians(_TURNED_deg)),),
            HandAction.TIE: steadied_rad,
            HandAction.STEADY: steadied_rad,
        }
        for target_rad in targets_rad[action]:
            self._move_to(target_rad)

    def choose(self, question: str, choices: tuple[str, ...]) -> str:
        """Answer a `question`: name the rotor that turned last; otherwise the first of the `choices`."""
        if "neither" not in choices:
            return choices[0]
        self._report(f"hand: {question} {self._turning_rotor}")
        return self._turning_rotor

    def report(self, text: str) -> None:
        """Show a line of `text`."""
        self._report(text)

    def wants_stop(self) -> bool:
        """Return False, because this operator never stops a calibration."""
        return False

    def _note_turning_rotor(self) -> None:
        """Remember which rotor has a voltage."""
        for rotor, volts_V in zip(("front", "back"), self._world.native.volts_V, strict=True):
            if volts_V:
                self._turning_rotor = rotor

    def _move_to(self, target_rad: tuple[float, float, float]) -> None:
        """Hold the axes at target angles [rad], nan for a free axis, and wait until they arrive."""
        self._world.native.hand_rad = target_rad
        end_s = self._heli.latest.t_s + _TIMEOUT_s
        while self._heli.latest.t_s < end_s:
            self._heli.wait(0.1)
            angle_rad = self._world.state[:3]
            if not np.any(np.abs(angle_rad - np.array(target_rad)) > _POSITION_TOLERANCE_rad):
                return
