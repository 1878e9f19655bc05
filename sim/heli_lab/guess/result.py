"""What a guess is: a profile, how sure, and what else it could be."""

from __future__ import annotations

from dataclasses import dataclass

from heli_host.tables import Profile


@dataclass(frozen=True)
class Ambiguity:
    """Something that the file does not settle.

    Parameters
    ----------
    what : str
        What is in question, in a few words.
    chosen, other : str
        What the profile says, and what it could be instead.
    why : str
        Why nothing settles it, and what would.
    """

    what: str
    chosen: str
    other: str
    why: str

    def sentence(self) -> str:
        """The doubt in one line."""
        return f"unsure of {self.what}: {self.chosen}, or {self.other}; {self.why}"


@dataclass(frozen=True)
class Choice:
    """One choice of signs, flown through the baseline model.

    Parameters
    ----------
    name : str
        What is changed against the profile; empty for the profile itself.
    error_deg : tuple of float
        Error of free runs, deg rms, by axis.
    ratio : float
        Product of the axes' errors, relative to that of the profile: below 1 where this choice flies better.
    """

    name: str
    error_deg: tuple[float, float, float]
    ratio: float


@dataclass(frozen=True)
class Guess:
    """A proposed profile.

    Parameters
    ----------
    doubts : tuple of Ambiguity
        What is open; none where the guess is sure.
    evidence : tuple of str
        What it rests on, a sentence each.
    choices : tuple of Choice
        Signs flown, the profile first.
    nats : float
        Log-likelihood of columns and units, to compare rigs by.
    """

    profile: Profile
    doubts: tuple[Ambiguity, ...]
    evidence: tuple[str, ...]
    choices: tuple[Choice, ...] = ()
    nats: float = 0.0

    @property
    def sure(self) -> bool:
        """Whether nothing is open."""
        return not self.doubts
