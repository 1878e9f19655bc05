"""The operator at a terminal, who reads instructions and types answers."""

from __future__ import annotations

import select
import sys
from collections.abc import Callable
from typing import TextIO

from heli_host.errors import FlightAborted

from heli_lab.setup.calibrate.operator import HandAction

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
