"""The interface to the operator, who moves the rig by hand and answers questions at the bench."""

from __future__ import annotations

from enum import Enum
from typing import Protocol


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
