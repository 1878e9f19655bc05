"""Whether a guess is right, unsure, or silently wrong."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from heli_host.data.flight import Flight
from heli_host.data.tables import flights_of, read_table
from heli_host.errors import HeliError
from heli_lab.setup.guess import Guess, guess
from heli_sim.rig import Rig

from tests.guess.distort import Distortion

_MAX_RAD = 0.005
_MAX_ZERO_RAD = np.radians(6.5)
"""A table is where the rig file says, within its tolerance and what the guess accepts."""
_MAX_V_SHARE = 0.01
_MAX_LATE_s = {"travel": 0.14, "elevation": 0.22, "voltages": 0.25}
"""A delay longer than this may not pass unsaid: lags as a flight shows them scatter by 0.06 s and more."""


@dataclass(frozen=True)
class FileVerdict:
    """Result of a file.

    Parameters
    ----------
    verdict : str
        `right`, `unsure` (right all the same), `unsure, wrong`, `refused`, or `SILENTLY WRONG`.
    reason : str
        What is wrong, or open.
    """

    verdict: str
    reason: str


def judge_file(path: Path, truth: Flight, how: Distortion, rig: Rig) -> FileVerdict:
    """Guess a file and compare with its truth."""
    try:
        table = read_table(path)
        guess_result = guess(table, rig)
    except HeliError as error:
        return FileVerdict("refused", str(error))
    imported = flights_of(table, guess_result.profile)[0]
    wrong = _wrong(imported, truth, how, guess_result)
    if wrong and guess_result.sure and not _wrong(_mirrored(imported), truth, how, guess_result):
        return FileVerdict("right", "in a mirror")
    open_ = "; ".join(ambiguity.subject for ambiguity in guess_result.ambiguities)
    if not wrong:
        return FileVerdict("right" if guess_result.sure else "unsure", open_)
    return FileVerdict("SILENTLY WRONG" if guess_result.sure else "unsure, wrong", f"{wrong} [{open_}]")


def _mirrored(flight: Flight) -> Flight:
    """The same flight with the other rotor called the front one.

    Where names and physics agree, nothing in a file distinguishes it from the flight itself, and no
    equation depends on it.
    """
    return replace(
        flight,
        front_V=flight.back_V,
        back_V=flight.front_V,
        pitch_rad=-flight.pitch_rad,
        travel_rad=-flight.travel_rad,
    )


def _wrong(made: Flight, truth: Flight, how: Distortion, guess_result: Guess) -> str:
    mistakes = []
    rows = min(len(made), len(truth))
    late_s = {axis: item.delay_s for axis, item in guess_result.profile.angles.items()}
    for name in ("elevation", "pitch", "travel"):
        shift = round(late_s[name] * how.rate_Hz)
        mine = getattr(made, f"{name}_rad")[: rows - abs(shift)]
        true = getattr(truth, f"{name}_rad")[max(shift, 0) :][: len(mine)]
        if len(true) < 10:
            return "nothing left"
        off = mine[: len(true)] - true
        if np.std(off) > _MAX_RAD or (name == "elevation" and abs(np.mean(off)) > _MAX_ZERO_RAD):
            mistakes.append(name)
        if name == "pitch" and abs(np.mean(off)) > _MAX_RAD:
            mistakes.append("pitch zero")
    for name in ("front_V", "back_V"):
        # Rows are lost at the beginning or the end where a delay was taken out.
        shift = max(0, round(-min(late_s.values()) * how.rate_Hz))
        mine, true = getattr(made, name)[: rows - shift], getattr(truth, name)[shift:rows]
        span = max(float(np.ptp(truth.voltages_V)), 1e-9)
        if float(np.abs(mine[: len(true)] - true[: len(mine)]).mean()) > _MAX_V_SHARE * span:
            mistakes.append(name)
    which, seconds = how.late
    if which and seconds > _MAX_LATE_s[which] and guess_result.sure:
        mistakes.append(f"{which} {seconds:.2f} s late")
    return ", ".join(mistakes)
