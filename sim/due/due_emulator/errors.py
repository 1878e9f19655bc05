"""All errors of this package.

::

    EmulatorError               what is wrong and what to do, in one line
    ├── ImageError              the program cannot be read, or is not for the Due
    ├── GdbError                the debugger's port cannot be opened
    └── Stop                    the emulator stopped the program; `due_emulator.Stop`, raised by the C++

``str(error)`` is always one line: what is wrong, then what to do.
"""

from __future__ import annotations


def _printable(text: str) -> str:
    line = " ".join(text.split())
    return "".join(
        letter if letter.isprintable() else letter.encode("unicode_escape").decode("ascii") for letter in line
    )


class EmulatorError(Exception):
    """Base of all errors of this package."""

    def __init__(self, cause: str, remedy: str = "") -> None:
        self.cause = _printable(cause)
        self.remedy = _printable(remedy)
        super().__init__(f"{self.cause}; {self.remedy}" if self.remedy else self.cause)


class ImageError(EmulatorError):
    """The program cannot be read, or is not for the Due."""


class GdbError(EmulatorError):
    """The debugger's port cannot be opened."""
