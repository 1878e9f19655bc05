"""Recorded outcomes of the scripts: fingerprints of what the board sent and did, one per half second.

A recording does not show that the board is right; the other tests do. It shows that a change of the flight
code leaves every bit that the board sends as it was. After an intended change, record again and review the
difference: ``python -m tests.flight.baseline``.
"""

import json
import random
import struct
import zlib
from pathlib import Path
from typing import Any, Final

from tests.flight.script_book import PARTS, SCRIPTS
from tests.flight.scripts import Arm, Board, Laws, Notes

FILE: Final = Path(__file__).with_name("baseline.json")


def read() -> dict[str, Any]:
    """Return the recorded laws by name, and the recorded outcomes by script."""
    recorded: dict[str, Any] = json.loads(FILE.read_text(encoding="utf-8"))
    return recorded


def laws_of(recorded: dict[str, Any]) -> Laws:
    """Words and checksum of each recorded law."""
    return {
        name: (words, zlib.crc32(struct.pack(f"<{len(words)}I", *words)))
        for name, words in recorded["laws"].items()
    }


def play(name: str, laws: Laws, expected: list[str] | None = None) -> Notes:
    """Run a script; an AssertionError as soon as it differs from what is expected."""
    script, chance = SCRIPTS[name], random.Random(list(SCRIPTS).index(name))
    if name in PARTS:
        notes = Notes(chance, expected)
        script.play(notes, laws)
        return notes
    board = Board(chance, expected, Arm(chance, **script.arm))
    script.play(board, laws)
    board.finish()
    return board


def outcome(notes: Notes) -> dict[str, list[str]]:
    """What is recorded of a script."""
    return {"events": notes.events, "windows": notes.windows}


def record() -> None:
    """Write the outcomes of all scripts, with the laws that are recorded already."""
    recorded = read()
    laws = laws_of(recorded)
    recorded["scripts"] = {name: outcome(play(name, laws)) for name in SCRIPTS}
    FILE.write_text(json.dumps(recorded, indent=0) + "\n", encoding="utf-8")


if __name__ == "__main__":
    record()
