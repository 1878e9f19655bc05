"""Result of a guess: a profile, its ambiguities and its evidence."""

from __future__ import annotations

from dataclasses import dataclass

from heli_host.tables import Profile


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

    @property
    def sure(self) -> bool:
        """Whether the guess has no ambiguity."""
        return not self.ambiguities
