"""Entries of a profile that the user knows; the guess finds the others."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from heli_host.data.files import parse_toml
from heli_host.data.tables import Column, Profile, Table, profile_of, profile_text, read_entries

from heli_lab.setup.guess.names import VOLTAGE_ROLES
from heli_lab.setup.guess.result import Ambiguity

_ROLES: Final = ("elevation", "pitch", "travel", *VOLTAGE_ROLES)


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
            for role in _ROLES
            if "column" in self.entries.get(role, {})
        }

    @property
    def knows_voltages(self) -> bool:
        """Whether both voltage columns are known."""
        return sum(role in VOLTAGE_ROLES for role in self.columns.values()) > 1

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
        return Table(table.source, columns, table.notes, table.named) if units else table

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
