"""The operator at the bench, who moves the rig by hand and answers questions: a person or a simulated one."""

from __future__ import annotations

import math
import select
import sys
from collections.abc import Callable
from enum import Enum
from math import nan
from typing import Final, Protocol, TextIO

import numpy as np
from heli_host.board.heli import Heli
from heli_host.errors import FlightAborted
from heli_sim.sil.world import SilWorld


class HandAction(Enum):
    """A movement by hand; the value is its instruction. The arm must be still when the operator answers."""

    REST = (
        "Let the arm rest on its table, with the short arm level. Turn travel to the middle of its range. "
        "Take your hands off."
    )
    LIFT = (
        "Hold the short arm steady, lift the long arm until it is level, and hold it there. Do not turn it."
    )
    FRONT_UP = "Leave the arm on its table. Lift the front rotor by about 20 degrees, and hold it there."
    BACK_LEADS = (
        "Keep the short arm level. Turn the arm about the vertical by about 30 degrees, with the back rotor "
        "ahead, and hold it there."
    )
    TIE = (
        "Block the long arm at least 10 degrees above its table, so that it can neither rise, nor fall, nor "
        "turn. The short arm must swing freely."
    )
    STEADY = "Level the short arm, wait until it is still, and let it go. Take your hands off."

    @property
    def text(self) -> str:
        """Instruction for the operator."""
        return self.value


class Operator(Protocol):
    """The operator at the bench. A method may raise KeyboardInterrupt or a HeliError, to end the
    calibration.
    """

    def act(self, action: HandAction) -> None:
        """Let the operator do an action, and return when the action is done and the arm is still."""

    def choose(self, question: str, choices: tuple[str, ...]) -> str:
        """Ask a `question`, and return one of the `choices`."""

    def report(self, text: str) -> None:
        """Show a line of `text`."""

    def wants_stop(self) -> bool:
        """Whether the operator pressed the stop key since the last answer; does not wait."""


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


_STOP = "stop"


class TerminalOperator:
    """Asks a person, or a script, by lines of text."""

    def __init__(self, answers: TextIO, show: Callable[[str], None]) -> None:
        self._answers = answers
        self._show = show

    def act(self, action: HandAction) -> None:
        """Show the instruction, and wait for Enter; ``stop`` ends the calibration."""
        self._show(f"{action.text} Then press Enter (or type {_STOP}).")
        self._read_answer()

    def choose(self, question: str, choices: tuple[str, ...]) -> str:
        """Ask a `question` until the answer is one of the `choices`, or the first letters of one."""
        while True:
            self._show(f"{question} [{'/'.join(choices)}]")
            answer = self._read_answer(may_stop=_STOP not in choices)
            matches = [choice for choice in choices if answer and choice.startswith(answer)]
            if len(matches) == 1:
                return matches[0]

    def report(self, text: str) -> None:
        """Show a line of `text`."""
        self._show(text)

    def wants_stop(self) -> bool:
        """Return whether Enter was pressed at the terminal; with a pipe, always False, because a script
        writes its answers in advance.
        """
        if not self._answers.isatty():
            return False
        if sys.platform == "win32":
            import msvcrt

            return bool(msvcrt.kbhit())
        ready, _, _ = select.select([self._answers], [], [], 0.0)
        if ready:
            self._answers.readline()
        return bool(ready)

    def _read_answer(self, *, may_stop: bool = True) -> str:
        """Read the next line, in lower case."""
        line = self._answers.readline()
        answer = line.strip().lower()
        if not line:
            raise FlightAborted("the answers ended before the calibration; the motors are off")
        if may_stop and answer == _STOP:
            raise FlightAborted("the operator stopped the calibration; the motors are off")
        return answer
