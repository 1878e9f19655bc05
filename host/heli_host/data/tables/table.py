"""Content of a file from another program: named columns of numbers, their units, and times."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from heli_host.data.arrays import Floats, Integers
from heli_host.errors import FlightDataError

if TYPE_CHECKING:
    import pandas


SHARED_TIME = "time [s]"
"""Name of the time that columns of different clocks are brought to."""


@dataclass(frozen=True)
class Column:
    """One column as the file has it."""

    values: Floats  # (n,): Numbers; nan where a cell is empty
    unit: str = ""  # Unit that the file states; empty if it states none
    t_s: Floats | None = None
    """(n,): Separate times of the column, if the file has them for each signal (bags, Simulink). None if the
    rows of the column are those of the table."""


_MAX_AGE: Final = 5.0
"""Age of a signal's last value, in its typical intervals, above which the signal counts as lost. Five rows is
also the longest gap that a conversion fills."""
_SIMULTANEOUS: Final = 0.25
"""Time by which a value may come after a row and still belong to it, as a share of the shorter interval.
Messages of one moment reach a recorder in changing order; without this, half of the rows would have the value
of the row before."""
_WRAP_SHARE: Final = 0.5
_MAX_WRAPS: Final = 0.05
"""Share of a column's range that a step exceeds at a wrap, and largest share of such steps. A column with
more of them switches between few values: it is no counter of an arm that turns slowly."""
_MAX_PAUSES: Final = 0.01
"""Share of longer pauses above which a signal is one that programs send only when it changes."""


@dataclass(frozen=True)
class RowChange:
    """Rows that were changed on the way from a file to a flight, and the reason."""

    action: str
    """`left out`, `merged`, `filled`, `reordered`, `retimed`, `completed` (blank cells) or `resampled`."""
    rows: int
    """Rows that were changed; of `resampled`, the number of rows after it minus the number before it."""
    reason: str  # Reads on after the number of rows, as in "12 rows ..."
    is_standing: bool = False  # Whether a failed link seems to repeat the angles of these rows

    @property
    def added(self) -> int:
        """How many rows more there are after this change."""
        if self.action in ("left out", "merged"):
            return -self.rows
        return self.rows if self.action in ("filled", "resampled") else 0

    def sentence(self) -> str:
        """Describe the change in one line."""
        if self.action == "resampled":
            return f"resampled: {self.reason}"
        return f"{self.action}: {self.rows} {'row' if self.rows == 1 else 'rows'} {self.reason}"


@dataclass(frozen=True)
class Table:
    """Columns of one file."""

    source: str  # The file, for messages
    columns: Mapping[str, Column]
    """Columns by their names in the file, or `column 1` and so on if the file has no names."""
    notes: str = ""  # Notes in the file
    named: bool = True  # Whether the file contains the names
    changes: tuple[RowChange, ...] = ()  # Rows of the file that were left out or repaired so far
    unread: Mapping[str, str] = field(default_factory=dict)
    """A cell of each column that contains other texts than numbers or times, by the column's name."""
    places: Integers | None = None
    """(n,): Place of each row in the file, if damaged lines were left out; otherwise None."""

    def __len__(self) -> int:
        return max((column.values.size for column in self.columns.values()), default=0)

    def selected(self, rows: Integers, changes: Collection[RowChange]) -> Table:
        """Return the table with these `rows` only, in their order; its `changes` explain the difference."""
        columns = {name: Column(column.values[rows], column.unit) for name, column in self.columns.items()}
        places = None if self.places is None else self.places[rows]
        return replace(self, columns=columns, changes=(*self.changes, *changes), places=places)

    def even_times(self, rate_Hz: float) -> Floats:
        """Return the times of the rows [s] if the file has `rate_Hz` rows per second, shape (n,)."""
        return (np.arange(len(self)) if self.places is None else self.places) / rate_Hz

    def aligned(self, interpolated: Collection[str] = ()) -> Table:
        """Bring all columns to the clock of the column with the most rows.

        At each time, the other columns have their last value up to that time, and `interpolated` columns a
        value on the straight line between the last and the next one. If no column has separate times, the
        columns are not resampled. Columns shorter than the longest are then omitted, and so are rows of zeros
        at the end, which come from a buffer that is too long.
        """
        times_of_columns = {
            name: column.t_s for name, column in self.columns.items() if column.t_s is not None
        }
        if not times_of_columns:
            return self._without_short_columns()
        fullest_t_s = max(times_of_columns.values(), key=len)
        # Before it, a signal has no value yet.
        start_s = max(float(column_t_s[0]) for column_t_s in times_of_columns.values() if column_t_s.size)
        t_s = fullest_t_s[fullest_t_s >= start_s]
        if t_s.size < 2:
            raise FlightDataError(
                f"{self.source}: its signals have no common time span", "give the signals of one flight"
            )
        changes = list(self.changes)
        early_rows = fullest_t_s.size - t_s.size
        if early_rows:
            changes.append(RowChange("left out", early_rows, "before the first value of all signals"))
        columns = {SHARED_TIME: Column(t_s - t_s[0], "s")}
        for name, column_t_s in times_of_columns.items():
            if column_t_s.size:
                column = self.columns[name]
                values = _at_times(column.values, column_t_s, t_s, is_interpolated=name in interpolated)
                columns[name] = Column(values, column.unit)
        return replace(self, columns=columns, changes=tuple(changes), places=None)

    def _without_short_columns(self) -> Table:
        """Leave out the columns that are shorter than the longest, and rows of zeros at the end."""
        length = len(self)
        columns = {name: column for name, column in self.columns.items() if column.values.size == length}
        table = replace(self, columns=columns)
        used_rows = _rows_before_trailing_zeros([column.values for column in columns.values()])
        if used_rows == length:
            return table
        zeros = RowChange("left out", length - used_rows, "of zeros at the end")
        return table.selected(np.arange(used_rows), [zeros])


def _at_times(values: Floats, value_times_s: Floats, t_s: Floats, is_interpolated: bool) -> Floats:
    """Bring a signal to other times; nan where it has no value any more. Shapes: `t_s` (n,); returns (n,)."""
    intervals_s = np.diff(value_times_s)
    shortest_s = float(min(np.median(intervals_s), np.median(np.diff(t_s)))) if intervals_s.size else 0.0
    due_s = t_s + _SIMULTANEOUS * max(shortest_s, 0.0)
    last_rows = np.clip(np.searchsorted(value_times_s, due_s, side="right") - 1, 0, None)
    result: Floats = interpolated_angle(t_s, value_times_s, values) if is_interpolated else values[last_rows]
    if not intervals_s.size:
        return result
    longest_s = _MAX_AGE * float(np.median(intervals_s))
    if float(np.mean(intervals_s > longest_s)) > _MAX_PAUSES:
        return result
    current: Floats = np.where(t_s - value_times_s[last_rows] > longest_s, np.nan, result)
    return current


def interpolated_angle(t_s: Floats, value_times_s: Floats, values: Floats) -> Floats:
    """Interpolate an angle linearly; where its counter starts again, it goes on as before and after.
    Shapes: `t_s` (n,), `value_times_s` (k,), `values` (k,); returns (n,).
    """
    line: Floats = np.interp(t_s, value_times_s, values)
    steps = np.diff(values)
    # A wrap crosses nearly the whole range of the column.
    is_wrap = np.abs(steps) > _WRAP_SHARE * np.ptp(values)
    if not is_wrap.any() or is_wrap.mean() > _MAX_WRAPS:
        return line
    before = np.clip(np.searchsorted(value_times_s, t_s, side="right") - 1, 0, steps.size - 1)
    # At a wrap, the angle goes on by the step before; that counts as 0 if it is a wrap, too. The first step
    # has none before it, and takes the last one.
    without_wraps = np.where(is_wrap, 0.0, steps)
    previous = np.concatenate((without_wraps[-1:], without_wraps[:-1]))
    step = np.where(is_wrap, previous, steps)[before]
    intervals_s = np.maximum(np.diff(value_times_s), np.finfo(np.float64).tiny)
    share = np.clip((t_s - value_times_s[before]) / intervals_s[before], 0.0, 1.0)
    continued = np.where(
        share < 0.5, values[before] + share * step, values[before + 1] - (1.0 - share) * step
    )
    return np.where(is_wrap[before], continued, line)


def _rows_before_trailing_zeros(columns: list[Floats]) -> int:
    """How many rows there are before those at the end in which every column, time too, is 0."""
    length = columns[0].size if columns else 0
    last = 0
    for values in columns:
        filled = np.flatnonzero(values != 0.0)
        last = max(last, int(filled[-1]) + 1 if filled.size else 0)
    return last if len(columns) > 1 and last else length


_DEG: Final = math.pi / 180.0
ANGLE_UNITS: Final = {
    "rad": 1.0,
    "mrad": 1e-3,
    "deg": _DEG,
    "cdeg": 1e-2 * _DEG,
    "mdeg": 1e-3 * _DEG,
    "turn": 2.0 * math.pi,
}
"""Radians in one of each; a count depends on the encoder."""
TIME_UNITS: Final = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "day": 86400.0}
"""Seconds in one of each."""
VOLTAGE_UNITS: Final = {"V": 1.0, "mV": 1e-3}
"""Volts in one of each; shares of the supply are in `SHARES`."""
SHARES: Final = {"duty": 1.0, "percent": 100.0, "pwm": 255.0}
"""Number in the column that means full supply voltage; a profile may state another number for `pwm`."""
COUNT: Final = "count"

_SPELLINGS: Final = {
    "rad": (
        "rad",
        "radian",
        "radians",
        "radianer",
        "radianes",
        "radianos",
        "radiant",
        "弧度",
        "рад",
        "라디안",
    ),
    "mrad": ("mrad",),
    "deg": (
        *("deg", "degs", "degree", "degrees", "°", "grad", "grader", "º", "grados", "graus", "degres"),
        *("degrés", "gradi", "graden", "stopnie", "derece", "度", "град", "도"),
    ),
    "cdeg": ("cdeg", "centideg", "centidegrees", "0.01deg", "0.01 deg"),
    "mdeg": ("mdeg", "millideg", "millidegrees"),
    "turn": ("turn", "turns", "rev", "revs", "revolution", "revolutions"),
    "count": (
        "count",
        "counts",
        "cnt",
        "cnts",
        "ticks",
        "tick",
        "pulses",
        "steps",
        "enc",
        "lsb",
        "cts",
        "inc",
        "imp",
        "ink",
    ),
    "s": ("s", "sec", "secs", "second", "seconds", "秒", "с", "сек", "초"),
    "ms": ("ms", "msec", "millis", "milliseconds", "毫秒", "ミリ秒", "мс", "밀리초"),
    "us": ("us", "µs", "μs", "usec", "micros", "microseconds"),
    "ns": ("ns", "nsec", "nanoseconds"),
    "min": ("min", "minutes", "мин"),
    "day": ("day", "days", "datenum"),
    "V": ("v", "volt", "volts", "voltios", "伏", "в", "볼트"),
    "mV": ("mv", "millivolt", "millivolts"),
    "duty": ("duty", "1", "-", "p.u.", "pu"),
    "percent": ("%", "percent", "pct"),
    "pwm": ("pwm",),
    "deg/s": ("deg/s", "°/s", "dps", "degrees/s"),
    "rad/s": ("rad/s", "rad/sec", "radps"),
    "rad/s2": ("rad/s2", "rad/s^2"),
    "A": ("a", "amp", "amps", "ampere", "а"),
    "mA": ("ma",),
    "°C": ("°c", "degc", "celsius"),
    "rpm": ("rpm", "1/min", "u/min"),
    "N": ("n", "newton"),
    "W": ("w", "mw", "watt", "watts"),
    "Nm": ("nm", "n m", "n*m"),
}
_UNIT_OF: Final = {spelling: unit for unit, spellings in _SPELLINGS.items() for spelling in spellings}
_WIDE_BRACKETS: Final = str.maketrans("（）［］", "()[]")
"""Brackets as wide as the characters of Chinese and Japanese."""
_BRACKETS: Final = re.compile(r"^(.*?)[\s_]*[\[(<{]\s*([^\])>}]*)\s*[\])>}]\s*$")
_SLASH: Final = re.compile(r"^(.*\S)(?:\s+(?:/|in)\s*|_in_)(\S+)\s*$")
_TIGHT_SLASH: Final = re.compile(
    r"^([^/]*[^/\s])/(rad|mrad|deg|°|Deg|rev|turns?|counts?|V|mV|%|A|ms|us|µs|ns)$"
)
"""As in `pitch/deg`, which engineers write. Other short units may be the last part of a path or of a rate."""
_OTHER_UNIT: Final = re.compile(
    r"(?i)^([^/]*[^/\s])(?:(?:/|,\s*|\s+in\s+)(?!angle$)|[_\s](?=(?:gon|gradian|ddeg|arc|mil)\w*$))([a-z]+)$"
)
"""Unit that is not known, behind a slash, a comma or the word in. Behind a line or a space, most words are no
units."""
_TAIL: Final = re.compile(r"^(.*[^_\s])[_\s]([^_\s]+)$")
_MATRIX_INDEX: Final = re.compile(r"(?<=\w)\[\d+\]$")
_BARE_TAILS: Final = frozenset(
    {
        *(
            "rad",
            "mrad",
            "deg",
            "cdeg",
            "mdeg",
            "degrees",
            "radians",
            "turns",
            "count",
            "counts",
            "cnt",
            "ticks",
        ),
        *("sec", "°", "%", "ms", "us", "ns", "volt", "volts", "mv", "duty", "pct", "percent", "pwm", "p.u."),
    }
)
_LONGEST_UNIT: Final = 8
"""Longest text in brackets that may be a unit; longer ones are remarks."""
_BEFORE_S: Final = frozenset({"t", "time", "timestamp", "stamp", "clock", "elapsed"})


def unit_of(text: str) -> str:
    """Return the unit that a `text` spells, or an empty string."""
    return _UNIT_OF.get(text.strip().lower(), "")


def split_unit(name: str) -> tuple[str, str]:
    """Split the unit off a column's `name`: `pitch [deg]`, `pitch (deg)`, `pitch / deg`, `pitch_deg`."""
    plain = name.translate(_WIDE_BRACKETS)
    for pattern in (_BRACKETS, _SLASH, _TIGHT_SLASH):
        match = pattern.match(plain)
        # In y[1] and u(1) the number is an index. After a space it is the unit 1, of a share.
        is_index = match is not None and match.group(2) == "1" and name[len(match.group(1))] in "[({<"
        if match and unit_of(match.group(2)) and not is_index:
            return match.group(1).strip(), unit_of(match.group(2))
    # The index of a matrix is behind the unit, as in `pitch_deg[2]`.
    match = _TAIL.match(_MATRIX_INDEX.sub("", name))
    # V_s is a sum of voltages and pitch_v is a speed, so that "s" and "v" are units in some names only.
    is_one_letter_unit = match is not None and (
        (match.group(2) == "s" and match.group(1).lower() in _BEFORE_S) or match.group(2) in ("V", "mA")
    )
    if match and (is_one_letter_unit or match.group(2).lower() in _BARE_TAILS):
        return match.group(1), unit_of(match.group(2))
    return name, ""


def unknown_unit(name: str) -> str:
    """Return the text in brackets at the end of a column's `name`, if it may be a unit but is not known."""
    plain = name.translate(_WIDE_BRACKETS)
    match = _BRACKETS.match(plain) or _OTHER_UNIT.match(plain)
    text = match.group(2).strip() if match else ""
    is_index = text.isdigit() or len(text) > _LONGEST_UNIT or " " in text
    return "" if not text or is_index or unit_of(text) else text


_CLOCK: Final = r"^\s*(?:\d{1,3}:)?\d{1,2}:\d{1,2}(?:[.,:]\d+)?\s*$"
_DATE: Final = r"^\s*(?:\d{1,4}[-./]\d{1,2}[-./]\d{1,4}|\d{8})[T_\s]+\d{1,2}:?\d{2}"
_CLOCK_FIRST: Final = r"^\s*\d{1,2}:\d{2}.*(?:[AaPp]\.?[Mm]\.?|\d[-/.]\d{1,2}[-/.]\d+)\s*$"
"""Times of 12 hours, or before a date."""
_HAS_DAY: Final = r"\d[-/]\d|\d\.\d+\.\d|\d{8}"
_COMPACT: Final = r"^(\d{4})(\d{2})(\d{2})[T_\s]+(\d{2}):?(\d{2}):?"
_DURATION: Final = re.compile(r"^(\d+) days? \+?(\d{1,2})(?=:\d{2}:)")
"""Durations as pandas writes them, such as `0 days 00:00:01.25`."""
_MONTHS: Final = (
    *("jan", "feb|fev|fév", "mar|mär", "apr|avr|abr", "may|mai", "jun|juin", "jul|juil", "aug|ao", "sep"),
    *("oct|okt", "nov", "dec|dez|déc|dic"),
)
_MONTH: Final = re.compile(
    r"(?i)(?<=\d[-/ .])(?:" + "|".join(f"({month})" for month in _MONTHS) + r")[^\W\d]*\.?(?=[-/ ]+\d)"
)
"""Months by name, as in `06-May-2024`, which MATLAB writes in the language of the computer."""
_IN_LETTERS: Final = re.compile(r"^(?:(\d+)\s*h)?\s*(\d+)\s*m(?:in)?\s*(\d+(?:\.\d+)?)\s*s(?:ec)?$")
"""Times such as `0h01m02.5s`."""
_MIN_CLOCK_SHARE: Final = 0.8
"""Share of the cells that must be times: lines may be damaged, and a column of remarks has no times."""
_DAY_S: Final = 86400.0


def seconds_of(cells: pandas.Series) -> Floats | None:
    """Read `cells` such as `13:47:20.125`, `47:20,125` or `2024-01-04 12:58:31.2` as seconds from the first.
    Returns shape (n,).
    """
    # A label before all times, or brackets around them, are no part of them.
    text = cells.astype(str).str.strip().str.strip("[](){}<>'\"")
    text = text.str.replace(r"^[A-Za-z]+\s*[=:]\s*", "", regex=True).str.replace(",", ".")
    text = text.str.replace(_DURATION, _hours, regex=True)
    text = text.str.replace(_MONTH, lambda match: f"{match.lastindex:02d}", regex=True)
    text = text.str.replace(_IN_LETTERS, lambda match: ":".join(filter(None, match.groups())), regex=True)
    samples = text.iloc[:: max(1, len(text) // 50)]  # enough to recognise the form
    if samples.str.match(_CLOCK).mean() >= _MIN_CLOCK_SHARE:
        seconds, has_day = _clock_seconds(text), False
    elif samples.str.match(f"{_DATE}|{_CLOCK_FIRST}").mean() >= _MIN_CLOCK_SHARE:
        seconds = _date_seconds(text, samples)
        has_day = samples.str.contains(_HAS_DAY).mean() >= _MIN_CLOCK_SHARE
    else:
        return None
    is_known = np.isfinite(seconds)
    if not is_known.any():
        return None
    known_s = seconds[is_known]
    if not has_day:
        # Times without a date fall by nearly a day at midnight.
        is_midnight = np.diff(known_s, prepend=known_s[:1]) < -0.5 * _DAY_S
        seconds[is_known] += _DAY_S * np.cumsum(is_midnight)
    result: Floats = seconds - known_s[0]
    return result


def _hours(match: re.Match[str]) -> str:
    """Write the days and hours of a duration as hours."""
    return str(24 * int(match.group(1)) + int(match.group(2)))


def _clock_seconds(text: pandas.Series) -> Floats:
    """Read clock times in seconds; nan for another text."""
    import pandas

    # LabVIEW writes milliseconds after a third colon.
    text = text.str.replace(r"^(\d+:\d+:\d+):(\d+)$", r"\1.\2", regex=True)
    text = with_padded_fractions(text)
    fields = text.str.split(":", expand=True).apply(pandas.to_numeric, errors="coerce")
    counts = fields.notna().sum(axis=1)
    width = int(counts.mode().iloc[0])
    # Seconds per unit of each field: 3600, 60, 1 for hours, minutes, seconds.
    weights = 60.0 ** np.arange(width - 1, -1, -1)
    numbers: Floats = fields.iloc[:, :width].to_numpy(np.float64)
    seconds: Floats = np.asarray((numbers * weights).sum(axis=1), np.float64).reshape(-1)
    seconds[(counts != width).to_numpy()] = np.nan
    return seconds


def with_padded_fractions(text: pandas.Series) -> pandas.Series:
    """Pad the fractions of seconds with zeros, if a program wrote whole milliseconds without: `.7` for 7 ms.

    Other programs leave out the zeros at the end: `.70` shows the first kind, and `.07` the other one.
    """
    fractions = text.str.extract(r"[.](\d+)$")[0].dropna()
    longer = fractions[fractions.str.len() > 1]
    is_unpadded = fractions.str.len().nunique() > 1 and longer.str.endswith("0").any()
    if not is_unpadded or longer.str.startswith("0").any():
        return text
    digits = next((digits for digits in (3, 6, 9) if digits >= int(fractions.str.len().max())), 0)
    return text.str.replace(r"(?<=[.])\d+$", lambda match: match.group().zfill(digits), regex=True)


def _date_seconds(text: pandas.Series, samples: pandas.Series) -> Floats:
    """Read dates with times in seconds since 1970; nan for another text."""
    import pandas

    # A date that begins with a year goes on with the month. Other dates begin with the day in most countries.
    day_first = samples.str.match(r"^\s*\d{4}").mean() < _MIN_CLOCK_SHARE
    text = text.str.replace(_COMPACT, r"\1-\2-\3T\4:\5:", regex=True)
    text = with_padded_fractions(text)
    dates = pandas.to_datetime(text, errors="coerce", dayfirst=day_first, format="mixed", utc=True)
    first = dates.dropna().iloc[:1].min()
    seconds: Floats = np.array((dates - first).dt.total_seconds(), dtype=np.float64)
    return seconds
