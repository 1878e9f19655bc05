"""Profiles in TOML: meaning, unit and sign of the columns of a file from another program."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from heli_host.data.files import TOML_BYTES, decode_text, parse_toml, read_file, toml_string
from heli_host.data.tables.table import ANGLE_UNITS, COUNT, SHARES, TIME_UNITS, VOLTAGE_UNITS
from heli_host.declaration import AXES
from heli_host.errors import FlightDataError, file_remedy

MOTORS: Final = ("front", "back")
SUMS: Final = ("sum", "difference")
_ACT: Final = ("after", "before")
_SHARED: Final = ("unit", "full", "supply_V", "supply_column", "factor")
"""What may be stated once for both voltages."""


@dataclass(frozen=True)
class Angle:
    """Column of an angle: angle = sign * (column in its unit) + offset."""

    column: str  # Name of the column
    unit: str = "rad"  # `rad`, `mrad`, `deg`, `turn` or `count`
    counts: float = 0.0  # Counts per turn, required if the unit is `count`; otherwise 0
    sign: float = 1.0
    """-1 if the column has the opposite sign. Elevation is positive upwards, pitch when the front rotor is
    up, and travel accelerates positive at positive pitch."""
    offset_deg: float = 0.0
    """Offset added last, deg: 0 if the column is 0 at level, or the rest angle if the column is 0 at rest."""
    delay_s: float = 0.0  # Delay of the column, s

    @property
    def rad(self) -> float:
        """Radians per unit of the column, without sign."""
        return 2.0 * math.pi / self.counts if self.unit == COUNT else ANGLE_UNITS[self.unit]


@dataclass(frozen=True)
class Voltage:
    """Column of a voltage: voltage = sign * factor * (column in its unit) + offset."""

    column: str  # Name of the column
    unit: str = "V"  # `V`, `mV`, or a share of the supply: `duty`, `percent` or `pwm`
    full: float = 255.0  # Number in the column that means full supply, for `pwm`
    supply_V: float = 12.0  # Supply voltage of which the column is a share, V
    sign: float = 1.0  # -1 if the column has the opposite sign
    offset_V: float = 0.0  # Offset added last, V, such as the bias of a sum that was logged without it
    delay_s: float = 0.0  # Delay of the column, s
    factor: float = 1.0
    """Factor of the column, such as 2 for half a sum, or the gain of an amplifier after the output."""
    supply_column: str = ""
    """Column of the supply voltage, if it was logged; it replaces `supply_V` row by row."""
    sign_column: str = ""
    """Column with the direction of the motor, if the column has only the size. It has two values; at the one
    with the larger voltages, the motor turns forwards."""

    @property
    def volts(self) -> float:
        """Volts that one of the column's unit is, without sign."""
        if self.unit in VOLTAGE_UNITS:
            return self.factor * VOLTAGE_UNITS[self.unit]
        return self.factor * self.supply_V / (self.full if self.unit == "pwm" else SHARES[self.unit])


@dataclass(frozen=True)
class Part:
    """Part of one file that is a flight."""

    leave_out_s: tuple[tuple[float, float], ...] = ()
    """Parts that are left out, on the file's own time axis, s."""
    group: str = ""  # Flights of one group belong together: one rig, one session


@dataclass(frozen=True)
class Profile:
    """Rules for reading the files of one program or rig type."""

    angles: Mapping[str, Angle]  # By axis; all of them
    voltages: Mapping[str, Voltage]
    """Columns `front` and `back`, or `sum` and `difference` (front minus back)."""
    time: str = ""  # Column of the times; empty if there is none
    time_unit: str = "s"  # `s`, `ms`, `us`, `ns`, `min` or `day`
    rate_Hz: float = 0.0  # Rows per second, if there is no column of times
    act: str = "after"
    """`after`: the voltages of a row act from that row on, as commands of a controller. `before`: they acted
    until that row, as samples that were taken with the angles."""
    setpoints: Mapping[str, Angle] = field(default_factory=dict)  # Setpoints by axis, if they are known
    parts: Mapping[str, Part] = field(default_factory=dict)  # Parts by the file's name without its folder
    about: str = ""  # Notes for people: the rig, the program, its author
    clip_V: tuple[float, float] | None = None
    """Smallest and largest voltage of a motor, if commands were logged before they were clipped."""
    mirrored: bool = False
    """Whether the rotor that the entries call the back one is the front one. At the end, motors are then
    exchanged, and the signs of pitch and travel are changed."""


def read_profile(path: Path) -> Profile:
    """Read the profile at `path`; a FlightDataError says which entry is wrong."""
    return profile_of(read_entries(path), str(path))


def read_entries(path: Path) -> Mapping[str, Any]:
    """Read the entries of the profile at `path`, which need not be complete."""
    try:
        content = parse_toml(decode_text(read_file(path, TOML_BYTES)))
    except OSError as error:
        raise FlightDataError(f"cannot read {path}: {error.strerror or error}", file_remedy(error)) from error
    except ValueError as error:
        raise FlightDataError(
            f"{path}: not a profile: {error}", "see docs/reference/file-formats.md"
        ) from error
    for name in (*AXES, *MOTORS, *SUMS, "voltages", "time"):
        _Reader(str(path)).table(content, name)
    return content


def profile_of(content: Mapping[str, Any], source: str) -> Profile:
    """Read a profile from its parsed TOML, `content`; an error names `source` and the wrong entry."""
    reader = _Reader(source)
    setpoint_names = {axis: f"{axis}_setpoint" for axis in AXES}
    tables = {"time", "voltages", "flight", *AXES, *MOTORS, *SUMS, *setpoint_names.values()}
    reader.refuse_unknown(content, {"about", "mirrored", *tables}, prefix="")
    time = reader.table(content, "time")
    reader.refuse_unknown(time, {"column", "unit", "rate_Hz"}, prefix="time.")
    voltage_names = [name for name in (*MOTORS, *SUMS) if name in content]
    if voltage_names not in (list(MOTORS), list(SUMS)):
        raise reader.problem("the voltages are neither [front] and [back] nor [sum] and [difference]")
    voltages_table = reader.table(content, "voltages")
    reader.refuse_unknown(voltages_table, {"act", "clip_V", *_SHARED}, prefix="voltages.")
    shared = {name: voltages_table[name] for name in _SHARED if name in voltages_table}
    profile = Profile(
        angles={axis: reader.angle(content, axis) for axis in AXES},
        voltages={name: reader.voltage(content, name, shared) for name in voltage_names},
        time=reader.text(time, "column", ""),
        time_unit=reader.one_of(time, "unit", "s", tuple(TIME_UNITS)),
        rate_Hz=reader.number(time, "rate_Hz", 0.0),
        act=reader.one_of(voltages_table, "act", "after", _ACT),
        setpoints={
            axis: reader.angle(content, name) for axis, name in setpoint_names.items() if name in content
        },
        parts=dict(reader.part(entry) for entry in reader.tables(content, "flight")),
        about=reader.text(content, "about", ""),
        clip_V=reader.clip(voltages_table),
        mirrored=reader.truth(content, "mirrored"),
    )
    if not profile.time and profile.rate_Hz <= 0.0:
        raise reader.problem("it has neither time.column nor time.rate_Hz")
    return profile


@dataclass(frozen=True)
class _Reader:
    """Entries of a profile, each checked."""

    source: str

    def problem(self, what: str) -> FlightDataError:
        """Return an error about the profile, to be raised."""
        return FlightDataError(f"{self.source}: {what}", "see docs/reference/file-formats.md")

    def refuse_unknown(self, content: Mapping[str, Any], known: set[str], prefix: str) -> None:
        """Raise an error for an entry that is not in `known`."""
        for name in content:
            if name not in known:
                raise self.problem(
                    f"it has '{prefix}{name}', which is unknown; choose from {', '.join(sorted(known))}"
                )

    def table(self, content: Mapping[str, Any], name: str) -> Mapping[str, Any]:
        """Return a table within `content`; empty if it is missing."""
        value = content.get(name, {})
        if not isinstance(value, Mapping):
            raise self.problem(f"{name} is not a table")
        return value

    def tables(self, content: Mapping[str, Any], name: str) -> list[Mapping[str, Any]]:
        """Return a list of tables within `content`; empty if it is missing."""
        value = content.get(name, [])
        if not isinstance(value, list) or not all(isinstance(item, Mapping) for item in value):
            raise self.problem(f"{name} is not a list of tables; write [[{name}]]")
        return value

    def text(self, content: Mapping[str, Any], name: str, default: str | None) -> str:
        """Return a text; without a default, it is required."""
        value = content.get(name, default)
        if not isinstance(value, str):
            raise self.problem(f"'{name}' is missing, or not a text")
        return value

    def number(self, content: Mapping[str, Any], name: str, default: float) -> float:
        """Return a finite number."""
        value = content.get(name, default)
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise self.problem(f"'{name}' is not a number")
        return float(value)

    def one_of(self, content: Mapping[str, Any], name: str, default: str, known: tuple[str, ...]) -> str:
        """Return a text that must be one of `known`."""
        value = self.text(content, name, default)
        if value not in known:
            raise self.problem(f"unknown {name} = '{value}'; choose {', '.join(known)}")
        return value

    def truth(self, content: Mapping[str, Any], name: str) -> bool:
        """Return true or false; false if it is missing."""
        value = content.get(name, False)
        if not isinstance(value, bool):
            raise self.problem(f"'{name}' is neither true nor false")
        return value

    def clip(self, content: Mapping[str, Any]) -> tuple[float, float] | None:
        """Return the smallest and the largest voltage; None if they are missing."""
        value = content.get("clip_V")
        if value is None:
            return None
        numbers = isinstance(value, list) and all(
            isinstance(limit_V, int | float) and not isinstance(limit_V, bool) for limit_V in value
        )
        if not numbers or len(value) != 2 or not value[0] < value[1]:
            raise self.problem(
                f"clip_V = {value} is not a [smallest, largest] voltage of a motor, such as [-5, 5]"
            )
        return float(value[0]), float(value[1])

    def sign(self, content: Mapping[str, Any]) -> float:
        """Return 1 or -1."""
        value = self.number(content, "sign", 1.0)
        if abs(value) != 1.0:
            raise self.problem(f"sign = {value:g} is neither 1 nor -1")
        return value

    def positive(self, content: Mapping[str, Any], name: str, default: float) -> float:
        """Return a number above 0."""
        value = self.number(content, name, default)
        if value <= 0.0:
            raise self.problem(f"{name} = {value:g} is not positive")
        return value

    def angle(self, content: Mapping[str, Any], name: str) -> Angle:
        """Read the table of an angle."""
        if name not in content:
            raise self.problem(f"[{name}] is missing")
        entry = self.table(content, name)
        self.refuse_unknown(entry, {"column", "unit", "counts", "sign", "offset_deg", "delay_s"}, f"{name}.")
        unit = self.one_of(entry, "unit", "rad", (*ANGLE_UNITS, COUNT))
        if unit == COUNT and "counts" not in entry:
            raise self.problem(f"[{name}] is in counts without counts = the encoder's counts of a turn")
        return Angle(
            self.text(entry, "column", None),
            unit,
            self.positive(entry, "counts", 1.0) if "counts" in entry else 0.0,
            self.sign(entry),
            self.number(entry, "offset_deg", 0.0),
            self.number(entry, "delay_s", 0.0),
        )

    def voltage(self, content: Mapping[str, Any], name: str, shared: Mapping[str, Any]) -> Voltage:
        """Read the table of a voltage; entries that it lacks come from `shared`."""
        entry = self.table(content, name)
        self.refuse_unknown(
            entry, {"column", "sign", "offset_V", "delay_s", "sign_column", *_SHARED}, f"{name}."
        )
        entry = {**shared, **entry}
        return Voltage(
            self.text(entry, "column", None),
            self.one_of(entry, "unit", "V", (*VOLTAGE_UNITS, *SHARES)),
            self.positive(entry, "full", 255.0),
            self.positive(entry, "supply_V", 12.0),
            self.sign(entry),
            self.number(entry, "offset_V", 0.0),
            self.number(entry, "delay_s", 0.0),
            self.positive(entry, "factor", 1.0),
            self.text(entry, "supply_column", ""),
            self.text(entry, "sign_column", ""),
        )

    def part(self, entry: Mapping[str, Any]) -> tuple[str, Part]:
        """Read a table ``[[flight]]``: a file name, and the part of the file to use."""
        self.refuse_unknown(entry, {"file", "leave_out_s", "group"}, "flight.")
        spans = entry.get("leave_out_s", [])
        try:
            excluded_s = tuple((float(start), float(stop)) for start, stop in spans)
        except (TypeError, ValueError):
            raise self.problem(
                "leave_out_s is not a list of [from, to] in seconds, such as [[0, 5], [33, 40]]"
            ) from None
        return self.text(entry, "file", None), Part(excluded_s, self.text(entry, "group", ""))


def profile_text(profile: Profile) -> str:
    """Return a profile as the TOML text that `read_profile` reads."""
    lines = [f"about = {toml_string(profile.about)}"]
    lines += [
        f"mirrored = {str(profile.mirrored).lower()}  # true: the other rotor is the front one",
        "",
        "[time]",
    ]
    if profile.time:
        lines += [f"column = {toml_string(profile.time)}", f'unit = "{profile.time_unit}"']
    if profile.rate_Hz:
        lines += [f"rate_Hz = {profile.rate_Hz!r}"]
    for axis in AXES:
        lines += ["", f"[{axis}]", *_angle_lines(profile.angles[axis])]
    lines += ["", "[voltages]", f'act = "{profile.act}"']
    # If all voltages have the same scale, it is written once, for all.
    scales = [_scale_lines(voltage) for voltage in profile.voltages.values()]
    shared_scale = scales[0] if all(scale == scales[0] for scale in scales) else []
    lines += shared_scale
    if profile.clip_V:
        lines.append(f"clip_V = {list(profile.clip_V)}")
    for name, voltage in profile.voltages.items():
        lines += ["", f"[{name}]", *_voltage_lines(voltage, [] if shared_scale else _scale_lines(voltage))]
    for axis, angle in profile.setpoints.items():
        lines += ["", f"[{axis}_setpoint]", *_angle_lines(angle)]
    for file, part in profile.parts.items():
        lines += ["", "[[flight]]", f"file = {toml_string(file)}", *_part_lines(part)]
    return "\n".join(lines) + "\n"


def _voltage_lines(voltage: Voltage, scale_lines: list[str]) -> list[str]:
    """Return the entries of a voltage as TOML, with the lines of its scale."""
    lines = [f"column = {toml_string(voltage.column)}", f"sign = {voltage.sign:g}", *scale_lines]
    if voltage.sign_column:
        lines.append(f"sign_column = {toml_string(voltage.sign_column)}")
    if voltage.offset_V:
        lines.append(f"offset_V = {voltage.offset_V!r}")
    if voltage.delay_s:
        lines.append(f"delay_s = {voltage.delay_s!r}")
    return lines


def _part_lines(part: Part) -> list[str]:
    """Return the entries of a part of a file as TOML, without those that have their default."""
    lines = []
    if part.leave_out_s:
        lines.append(f"leave_out_s = {[list(span) for span in part.leave_out_s]}")
    if part.group:
        lines.append(f"group = {toml_string(part.group)}")
    return lines


def _scale_lines(voltage: Voltage) -> list[str]:
    """Return the unit and the scale of a voltage as TOML."""
    lines = [f'unit = "{voltage.unit}"']
    lines += [f"full = {voltage.full!r}"] if voltage.unit == "pwm" else []
    lines += [f"supply_V = {voltage.supply_V!r}"] if voltage.unit in SHARES else []
    if voltage.supply_column:
        lines.append(f"supply_column = {toml_string(voltage.supply_column)}")
    return lines + ([f"factor = {voltage.factor!r}"] if voltage.factor != 1.0 else [])


def _angle_lines(angle: Angle) -> list[str]:
    """Return the entries of an angle as TOML."""
    lines = [f"column = {toml_string(angle.column)}", f'unit = "{angle.unit}"']
    lines += [f"counts = {angle.counts!r}"] if angle.unit == COUNT else []
    lines += [f"sign = {angle.sign:g}"]
    lines += [f"offset_deg = {angle.offset_deg!r}"] if angle.offset_deg else []
    lines += [f"delay_s = {angle.delay_s!r}"] if angle.delay_s else []
    return lines
