"""The operator of a simulated rig: a hand that does each action, and an eye that sees which rotor turns."""

from __future__ import annotations

from collections.abc import Callable
from math import nan
from typing import Final

import numpy as np
from heli_host.heli import Heli
from heli_sim.sil.world import SilWorld

from heli_lab.calibrate.operator import HandAction

_LIFTED_deg: Final = 15.0
_TURNED_deg: Final = {HandAction.FRONT_UP: 20.0, HandAction.BACK_LEADS: 30.0}
_THERE_rad: Final = 1e-6
_TIMEOUT_s: Final = 10.0


class SimulatedOperator:
    """Moves the rig of a simulated board in this process, and confirms every pulse.

    Parameters
    ----------
    heli : Heli
        Connected to that board.
    world : SilWorld
        The simulation behind it.
    report : callable taking str
        Gets each line that a person would read.
    """

    def __init__(self, heli: Heli, world: SilWorld, report: Callable[[str], None]) -> None:
        self._heli = heli
        self._world = world
        self._report = report
        self._rest_rad = float(np.radians(world.rig["elevation_min"].value))
        self._turned = "neither"
        heli.session.subscribe_ticks(lambda _: self._look())

    def act(self, action: HandAction) -> None:
        """Turn the axes as the action wants, and wait until they are there."""
        self._report(f"hand: {action.text}")
        tied = (self._rest_rad + np.radians(_LIFTED_deg), nan, 0.0)
        if action is HandAction.STEADY:
            self._turn((*tied[:1], 0.0, 0.0))
            self._turn(tied)
        elif action is HandAction.TIE:
            self._turn((tied[0], 0.0, 0.0))
            self._turn(tied)
        elif action is HandAction.LIFT:
            self._turn((0.0, 0.0, 0.0))
        elif action is HandAction.FRONT_UP:
            self._turn((self._rest_rad, float(np.radians(_TURNED_deg[action])), 0.0))
        elif action is HandAction.BACK_LEADS:
            self._turn((self._rest_rad, 0.0, float(np.radians(_TURNED_deg[action]))))
        else:
            self._turn((self._rest_rad, 0.0, 0.0))
            self._turn((nan, nan, nan))

    def choose(self, question: str, choices: tuple[str, ...]) -> str:
        """Answer a `question`: name the rotor that turned last; otherwise the first of the `choices`."""
        if "neither" not in choices:
            return choices[0]
        self._report(f"hand: {question} {self._turned}")
        return self._turned

    def report(self, text: str) -> None:
        """Pass a line of `text` on."""
        self._report(text)

    def wants_stop(self) -> bool:
        """Return False: this operator does not stop."""
        return False

    def _look(self) -> None:
        for rotor, volts_V in zip(("front", "back"), self._world.native.volts_V, strict=True):
            if volts_V:
                self._turned = rotor

    def _turn(self, target_rad: tuple[float, float, float]) -> None:
        """Turn the simulated arm by hand to the angles `target_rad`, and wait until it is there."""
        self._world.native.hand_rad = target_rad
        end_s = self._heli.latest.t_s + _TIMEOUT_s
        while self._heli.latest.t_s < end_s:
            self._heli.wait(0.1)
            angle_rad = self._world.state[:3]
            if not np.any(np.abs(angle_rad - np.array(target_rad)) > _THERE_rad):
                return
