"""Result of a guess, a profile with its ambiguities and evidence, and the entries that the user knows."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

from heli_host.data.files import parse_toml
from heli_host.data.tables import Column, Profile, Table, profile_of, profile_text, read_entries
from heli_host.data.tables.table import split_unit

from heli_lab.setup.guess.names import ROLES, VOLTAGE_ROLES

DECISIVE_NATS: Final = 6.0
"""Log-likelihood ratio from which on a choice is sure [nats]: 400 times as likely. Below it, the guess
reports an ambiguity. Set by judgement, checked with 200 distorted flights."""

_ENTRIES: Final = {
    "the columns": "elevation.column",
    "elevation's column": "elevation.column",
    "pitch's column": "pitch.column",
    "travel's column": "travel.column",
    "the sum's column": "sum.column",
    "the voltages' columns": "front.column",
    "the rig": "",
    "the signs in parts of the file": "",
    "the signs": "elevation.sign",
    "elevation's sign": "elevation.sign",
    "pitch's sign": "pitch.sign",
    "travel's sign": "travel.sign",
    "the units": "voltages.unit",
    "elevation's unit": "elevation.unit",
    "pitch's unit": "pitch.unit",
    "travel's unit": "travel.unit",
    "the voltages' unit": "voltages.unit",
    "the supply voltage": "voltages.supply_V",
    "the scale of the encoders": "elevation.counts",
    "the scale of elevation": "elevation.unit",
    "the scale of pitch": "pitch.unit",
    "the scale of travel": "travel.unit",
    "the scale of hover": "voltages.unit",
    "the time": "time.column",
    "which rotor is the front one": "mirrored",
    "the elevation's zero": "elevation.offset_deg",
    "pitch's zero": "pitch.offset_deg",
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


@dataclass(frozen=True)
class KnownEntries:
    """Entries of a profile file that need not be complete."""

    entries: Mapping[str, Any] = field(default_factory=dict)  # The file's content
    source: str = ""  # The file, for messages

    @property
    def columns(self) -> dict[str, str]:
        """Known roles, by name of the column."""
        return {
            str(self.entries[role]["column"]): role
            for role in ROLES
            if "column" in self.entries.get(role, {})
        }

    @property
    def knows_motors(self) -> bool:
        """Whether the entries decide which motor is the front one, by columns or by a sign."""
        return bool({"front", "back"}.intersection(self.columns.values())) or bool(self.sign("difference"))

    @property
    def mirrored(self) -> bool | None:
        """The entry `mirrored`; None if it is unknown."""
        return self.entries.get("mirrored")

    def sign(self, role: str) -> float:
        """Sign of a `role`; 0 if it is unknown."""
        return float(self.entries.get(role, {}).get("sign", 0.0))

    def with_units(self, table: Table) -> Table:
        """Return a table whose columns state the known units."""
        units = {column: self._known_unit(role) for column, role in self.columns.items()}
        columns = {
            name: Column(column.values, units.get(name) or column.unit, column.t_s)
            for name, column in table.columns.items()
        }
        return replace(table, columns=columns) if units else table

    def contradicted_headers(self, table: Table) -> list[str]:
        """Describe each known unit of a column of which the header of a `table` states another one."""
        stated = {
            column: table.columns[column].unit or split_unit(column)[1]
            for column in self.columns
            if column in table.columns
        }
        return [
            f"{role}: in {unit}, as {self.source} states, although the header of '{column}' states {other}"
            for column, other in stated.items()
            for role in [self.columns[column]]
            if other and (unit := self._known_unit(role)) and unit != other
        ]

    def _known_unit(self, role: str) -> str:
        """Known unit of a `role`; both voltages may share one entry. Empty if it is unknown."""
        unit = str(self.entries[role].get("unit", ""))
        if not unit and role in VOLTAGE_ROLES:
            unit = str(self.entries.get("voltages", {}).get("unit", ""))
        return unit

    def applied(self, profile: Profile) -> Profile:
        """Return a guessed profile with the known entries in the place of the guessed ones."""
        if not self.entries:
            return profile
        content = {key: value for key, value in parse_toml(profile_text(profile)).items() if key != "about"}
        for key, value in self.entries.items():
            are_sections = isinstance(value, Mapping) and isinstance(content.get(key), Mapping)
            content[key] = {**content[key], **value} if are_sections else value
        return profile_of({"about": profile.about, **content}, self.source)

    def states(self, ambiguity: Ambiguity) -> bool:
        """Whether the user knows the entry that an ambiguity is about."""
        section, _, key = ambiguity.entry.rpartition(".")
        if not section:
            return key in self.entries and key != ""
        return key in self.entries.get(section, {})


NOTHING_KNOWN: Final = KnownEntries()


def read_known(path: Path) -> KnownEntries:
    """Read the profile at `path`, which need not be complete; a FlightDataError states a wrong entry."""
    return KnownEntries(read_entries(path), str(path))
