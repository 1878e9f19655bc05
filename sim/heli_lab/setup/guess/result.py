"""Result of a guess: a profile, its ambiguities and its evidence."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Final

from heli_host.data.tables import Profile

_ENTRIES: Final = {
    "the columns": "elevation.column",
    "the sum's column": "sum.column",
    "the voltages' columns": "front.column",
    "the rig": "",
    "the signs": "elevation.sign",
    "elevation's sign": "elevation.sign",
    "pitch's sign": "pitch.sign",
    "travel's sign": "travel.sign",
    "the units": "voltages.unit",
    "elevation's unit": "elevation.unit",
    "pitch's unit": "pitch.unit",
    "travel's unit": "travel.unit",
    "the voltages' unit": "voltages.unit",
    "the scale of elevation": "elevation.unit",
    "the scale of pitch": "pitch.unit",
    "the scale of travel": "travel.unit",
    "the scale of hover": "voltages.unit",
    "the time": "time.column",
    "which rotor is the front one": "mirrored",
    "the elevation's zero": "elevation.offset_deg",
    "the sum's bias": "sum.offset_V",
    "the voltages' limit": "voltages.clip_V",
    "the voltages' lower limit": "voltages.clip_V",
    "the voltages' time": "voltages.delay_s",
    "elevation's time": "elevation.delay_s",
    "travel's time": "travel.delay_s",
}
"""Entry of the profile for each subject, the most dangerous subject first. A wrong column makes the flight
useless. With a wrong sign or unit, the fit gives a rig that cannot fly. With a mirror image or a delay, it
gives one that still flies."""


@dataclass(frozen=True)
class Ambiguity:
    """A property of the file that has two likely values.

    Parameters
    ----------
    subject : str
        The property, in a few words, such as ``the units``.
    chosen, alternative : str
        Value in the profile, and the other likely value.
    reason : str
        Why the file does not decide between the two, and how the user can decide.
    """

    subject: str
    chosen: str
    alternative: str
    reason: str

    @property
    def entry(self) -> str:
        """Entry of the profile that is in doubt, such as ``pitch.sign``; empty if there is no single one."""
        return _ENTRIES.get(self.subject, "")

    @property
    def danger(self) -> int:
        """Rank among all subjects: 0 is the most dangerous one if the chosen value is wrong."""
        return [*_ENTRIES, self.subject].index(self.subject)

    def sentence(self) -> str:
        """Describe the ambiguity in one line."""
        return f"unsure of {self.subject}: {self.chosen}, or {self.alternative}; {self.reason}"


@dataclass(frozen=True)
class SignChoice:
    """Open-loop error of the baseline model with one choice of the angles' signs.

    Parameters
    ----------
    name : str
        Axes with the opposite sign to the profile, such as ``pitch and travel``; empty for the profile.
    error_deg : tuple of float
        RMS error of open-loop simulations, by axis [deg].
    error_ratio : float
        Product of the three errors over that product for the profile; below 1 if this choice fits better.
    """

    name: str
    error_deg: tuple[float, float, float]
    error_ratio: float


@dataclass(frozen=True)
class Guess:
    """A proposed profile of a log file.

    Parameters
    ----------
    ambiguities : tuple of Ambiguity
        Properties that the file does not decide; empty if the guess is sure.
    evidence : tuple of str
        Reasons for the profile, one sentence per element.
    sign_choices : tuple of SignChoice
        All simulated choices of signs, the profile first.
    log_likelihood : float
        Log-likelihood of columns and units [nats]; comparable between rigs for the same file.
    """

    profile: Profile
    ambiguities: tuple[Ambiguity, ...]
    evidence: tuple[str, ...]
    sign_choices: tuple[SignChoice, ...] = ()
    log_likelihood: float = 0.0

    def with_ambiguity(self, ambiguity: Ambiguity) -> Guess:
        """Return the guess with one more ambiguity."""
        return replace(self, ambiguities=(*self.ambiguities, ambiguity))

    @property
    def sure(self) -> bool:
        """Whether the guess has no ambiguity."""
        return not self.ambiguities
