"""A case of the zoo: a table as a logger has it, and the truth that an import of it must find."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from heli_host.data.arrays import Floats


@dataclass(frozen=True)
class Samples:
    """Samples that the logger took of one angle or voltage."""

    t_s: Floats  # (n,): True times of the samples, since the beginning of the flight [s]
    values: Floats  # (n,): Angle [rad] or voltage [V], as the encoder or the controller had it


@dataclass(frozen=True)
class ImportTruth:
    """The result of a right import."""

    samples: Mapping[str, Samples]  # By angle and motor
    row_count: int  # Rows of the table that are intact and in the file once
    time_tolerance_s: float  # Error of a row's time that the clock of the file does not resolve
    value_step: Mapping[str, float]  # Resolution of each angle [rad] and voltage [V] in the file
    lost_s: float = 0.0  # Time of the flight that the file lacks
    refusal: str = ""
    """Pattern of the reason for which the file must be refused; empty if it must be imported."""
    reports: Mapping[str, str] | None = None
    """Pattern that the words of the import must match for each kind of repair, by kind."""
    unknown: tuple[str, ...] = ()
    """Facts that the file does not show, so that a question about them is right. `mirror` means whether the
    rig is its mirror image. `zero` is that of the elevation, `scale` the unit of the angles, and `supply` the
    supply voltage. `columns` means which column is which. `currents` means whether columns are currents or
    voltages."""


@dataclass(frozen=True)
class LoggedColumn:
    """One column as the logger writes it."""

    name: str  # With its unit, if the header states it there
    unit: str  # Unit as a separate row of the header states it; empty if none
    values: Floats  # (n,): Numbers in the unit of the column; nan where the cell is empty
    decimals: int  # Decimals of a text; negative for significant digits
    group: str = "table"  # Topic of a bag that contains the column


@dataclass(frozen=True)
class Recording:
    """The table that a container holds, before it is written."""

    name: str  # Name of the file without its ending
    clock_kind: str
    clock_name: str  # Empty if there is no column of times
    clock_unit: str
    clock: Floats  # (n,): Times as numbers in the unit of the clock
    clock_texts: tuple[str, ...]  # Times as texts, if the logger writes texts; otherwise empty
    clock_decimals: int
    true_s: Floats  # (n,): True times of the rows [s]
    columns: tuple[LoggedColumn, ...]
    has_header: bool
    unit_row: bool  # Whether a row of the header states the units

    @property
    def has_clock(self) -> bool:
        """Whether the file has a column of times, or of row numbers."""
        return self.clock_kind != "none"


@dataclass(frozen=True)
class LogCase:
    """A drawn case."""

    seed: int
    number: int
    traits: tuple[str, ...]  # The draws, in a few words each
    container: str
    recording: Recording
    truth: ImportTruth
    rig_name: str
    gives_rig: bool  # Whether the user gives the rig
    rate_Hz: float  # Sampling rate that the user gives; 0 if the file has times
    known_columns: Mapping[str, str]  # Columns that the user states in a profile, by role
    row_faults: tuple[str, ...]  # Faults of the lines, applied when the file is written
    dialect: str  # Two characters: separator and decimal sign of a text

    @property
    def name(self) -> str:
        """Name of the case, from which it is drawn again."""
        return f"{self.seed}-{self.number}"
