"""Decide which column is which: by names, and by the motion among columns that no name distinguishes.

A name that states a role settles it. A column whose name states another quantity, such as a setpoint, is left
out. Only for roles that no name states, the columns that remain are compared by the motion: the sum of the
voltages drives elevation, their difference pitch, and pitch travel. Such a choice always stays in doubt.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np
from heli_host.data.arrays import Booleans, Floats, Integers
from heli_host.data.tables import Column, Table
from heli_host.data.tables.convert import with_direction
from heli_host.data.tables.rows import timed_rows, without_unread_rows
from heli_host.data.tables.table import TIME_UNITS, split_unit
from heli_host.errors import FlightDataError

from heli_lab.setup.guess.motion import (
    FEEDBACK_MATCH,
    Assignment,
    Reference,
    RegressionFit,
    abs_correlation,
    feedback_sign,
    has_unit_slope,
    regress_acceleration,
)
from heli_lab.setup.guess.names import (
    AXES,
    PAIR,
    PULSES,
    ROLES,
    SUMS,
    VOLTAGE_ROLES,
    ColumnMeaning,
    direction_columns,
    is_element,
    is_time,
    meaning_of,
    meanings_of,
    states_voltage,
)
from heli_lab.setup.guess.result import DECISIVE_NATS, NOTHING_KNOWN, Ambiguity, KnownEntries
from heli_lab.setup.guess.signals import (
    NO_RATE,
    Clock,
    Signals,
    clock_of,
    column_signals,
    delay,
    longest_run,
    quantisation_step,
    without_spikes,
)

_REST_S: Final = 2.0
_FALL_S: Final = 5.0
"""Time before the motors turn, and after they stop, that belongs to the flight [s]."""
_BY_HAND_SHARE: Final = 0.1
"""Smallest motion of an angle with the motors off, as a share of its range, that somebody's hand makes."""
_FIX: Final = (
    "give a log with three angles and both motor voltages; if they are in two files, add --one-flight"
)
_MAX_COLUMNS: Final = 14
"""Largest number of columns without names that are compared by the motion."""
_COUNTING_SHARE: Final = 0.9
"""Share of equal steps from which on whole numbers count rows; missing rows make longer steps."""
_LIMITED_SHARE: Final = 0.01
"""Share of the rows at the largest value from which on a column is limited there, as by an amplifier."""
_DUPLICATE_CORRELATION: Final = 0.99999
"""Absolute correlation above which two columns are the same signal, in another unit or with another sign."""
_GAIN_RATIO: Final = 1.02
"""Ratio of the sizes of two copies of a voltage from which on a gain is between them."""
_FILTER_LAGS_S: Final = tuple(round(0.01 * number, 2) for number in range(-20, 21))
"""Lags with which a filtered copy may follow its origin [s]; longer ones make a filter useless."""
_FILTERED_MATCH: Final = 0.95
"""Correlation of the rates of two columns from which on one is a filtered copy of the other. On 16 simulated
flights, low-passes with time constants up to 0.3 s give 0.96 and more; axes and setpoints up to 0.84."""
_RATE_MATCH: Final = 0.9
"""Share of a column's variance that another column's derivative explains, from which on it counts as a
rate."""
_ENCODER_NATS: Final = 10.0
"""Reward of an angle column that is quantised by an encoder of the rig [nats]. Estimates, setpoints and rates
move like angles but are not quantised."""
_COUNTS_TOLERANCE: Final = 0.01
"""Largest relative difference between the counts per turn of a column and of an encoder; usual counts,
powers of 2 and multiples of 100, differ by more."""
_FEEDBACK_NATS: Final = 4.0
"""Reward of a sum of the voltages that is proportional to the rate of elevation [nats]. State feedback
gives such a sum, and its motion then shows no cause. Below `DECISIVE_NATS`: such a column stays in doubt."""
_ROLE_LAGS_S: Final = (0.0, 0.06, 0.12, 0.2)
"""Lags that are compared while columns are assigned to roles [s]."""
_EQUAL_SHARE: Final = 0.95
"""Share of the rows in which both motors have the same voltage, from which on one column is a copy. A board's
limits make voltages equal in some rows; a controller of pitch in few."""
_EXCITED_NATS: Final = 5.0 * DECISIVE_NATS
"""Evidence of elevation and pitch above which travel has to follow pitch, too [nats]."""
_FOLLOWING_LAGS_S: Final = (0.1, 0.2, 0.4, 0.6, 0.9, 1.3)
"""Lags with which an axis may follow its setpoint [s]."""
_FOLLOWED: Final = 0.85
"""Correlation of an axis with a delayed column from which on the column may be its setpoint. Set by judgement
on simulated flights: setpoints have 0.9 and more, voltages up to 0.6."""


@dataclass(frozen=True)
class PreparedFile:
    """One file with its filtered signals."""

    table: Table  # The longest part of the file in which times rise and no angle jumps
    clock: Clock  # Time column of the file
    signals: Signals  # All other columns of the file, at even times
    encoders: frozenset[str]  # Columns that are quantised by an encoder of the rig
    begins: bool  # Whether this part is the beginning of the file
    uncertain_s: float  # Largest error of a time, because a coarse clock hides where rows are missing
    by_hand_s: tuple[float, float] | None = None
    """Times of the first part that was cut off because the arm moves while the motors are off [s]."""

    @property
    def too_sparse(self) -> list[str]:
        """Columns with too few numbers for a signal."""
        columns = _without_times(self.table, self.clock.column)
        return [name for name in columns if name not in self.signals.raw]


def prepare_file(
    table: Table, reference: Reference, rate_Hz: float | None, known: KnownEntries = NOTHING_KNOWN
) -> PreparedFile:
    """Find the times of an aligned table, repair its rows, cut its longest part, and filter its columns."""
    clock = Clock("", "s", sure=True) if rate_Hz else _clock_of(table, known)
    uncertain_s = 0.0
    if rate_Hz:
        t_s = table.even_times(rate_Hz)
    else:
        table = without_unread_rows(table, table.columns, clock.column)
        timed = timed_rows(table, clock.column, clock.unit)
        t_s, uncertain_s = timed.t_s, timed.uncertain_s
        times = Column(t_s / TIME_UNITS[clock.unit], clock.unit)
        # A conversion of these rows must not repair their times again.
        table = replace(timed.table, columns={**timed.table.columns, clock.column: times}, changes=())
        t_s = t_s - t_s[0]
    first_s = t_s[0]
    table, t_s = longest_run(table, t_s)
    begins = bool(t_s[0] == first_s)
    driven, by_hand_s = _driven_rows(table, t_s)
    table, t_s = table.selected(driven, ()), t_s[driven]
    others = _without_times(table, clock.column)
    table = without_spikes(table, others)
    signals = column_signals(table, t_s, others, reference.counts.values())
    encoders = frozenset(name for name in others if _is_encoder(table.columns[name].values, reference))
    return PreparedFile(table, clock, signals, encoders, begins, uncertain_s, by_hand_s)


def _without_times(table: Table, clock: str) -> list[str]:
    """Return the columns that are not the `clock` and have no name of a time. The name of a matrix, such as
    ``time_and_angles[2]``, says nothing about its columns.
    """
    return [name for name in table.columns if name != clock and (not is_time(name) or is_element(name))]


def _driven_rows(table: Table, t_s: Floats) -> tuple[Integers, tuple[float, float] | None]:
    """Return the rows without the parts at both ends in which somebody moves the arm by hand, as to check the
    encoders, while the named motors are off; and the times of the first such part. Shapes: `t_s` (n,).

    Before the motors turn, the arm rests; after they stop, it falls.
    """
    motors, angles = list[Floats](), list[Floats]()
    for name, column in table.columns.items():
        meaning = meaning_of(name, column.unit)
        if meaning.quantity or not np.isfinite(column.values).any():
            continue  # neither an angle nor a voltage, or without a number
        if set(meaning.possible_roles) <= set(VOLTAGE_ROLES):
            motors.append(column.values)
        if meaning.role in AXES:
            angles.append(column.values)
    rows = np.arange(t_s.size)
    if len(motors) < len(PAIR) or not angles:
        return rows, None  # without names, nothing shows when the motors are off
    # Shape (n,): whether all motors still have their first value, which is off, or already have their last.
    is_off_at_start, is_off_at_end = (
        np.logical_and.reduce([_keeps_end(values, end) for values in motors]) for end in (0, -1)
    )
    if is_off_at_start.all() or is_off_at_end.all():
        return rows, None  # the motors never change
    first_driven_row = int(np.argmin(is_off_at_start))
    last_driven_row = t_s.size - 1 - int(np.argmin(is_off_at_end[::-1]))
    before = t_s < t_s[first_driven_row] - _REST_S
    after = t_s > t_s[last_driven_row] + _FALL_S
    by_hand = [
        part
        for part in (before, after)
        if any(_finite_range(values[part]) > _BY_HAND_SHARE * _finite_range(values) for values in angles)
    ]
    if not by_hand:
        return rows, None
    first_part_s = t_s[by_hand[0]]
    return rows[~np.logical_or.reduce(by_hand)], (float(first_part_s[0]), float(first_part_s[-1]))


def _keeps_end(values: Floats, end: int) -> Booleans:
    """Whether values, shape (n,), are missing or those of their first (0) or last (-1) number."""
    return np.asarray((values == values[np.isfinite(values)][end]) | np.isnan(values))


def _finite_range(values: Floats) -> float:
    """Return the range of the numbers among some values, shape (n,); 0 without a number."""
    finite = values[np.isfinite(values)]
    return float(np.ptp(finite)) if finite.size else 0.0


def with_directions(table: Table) -> tuple[Table, dict[str, str]]:
    """Give voltages the sign of their direction, if it has its own column; return these columns, too."""
    columns = dict(table.columns)
    used = {}
    units = {name: column.unit for name, column in columns.items()}
    for name, direction in direction_columns(units).items():
        sizes = columns[name].values
        signed = with_direction(sizes, columns[direction].values)
        if not (sizes < 0.0).any() and not np.array_equal(signed, sizes, equal_nan=True):
            columns[name] = replace(columns[name], values=signed)
            used[name] = direction
    return replace(table, columns=columns), used


def _clock_of(table: Table, known: KnownEntries) -> Clock:
    """Return the time column that the user states, or the best one; an error gives the reason if none is."""
    clock = clock_of(table)
    stated = known.entries.get("time", {})
    column = stated.get("column")
    if column in table.columns:
        unit = stated.get("unit") or (clock.unit if clock.column == column else "s")
        return Clock(str(column), str(unit), sure=True)
    if not clock.column or not clock.unit:
        unread = next((name for name in table.unread if is_time(name)), None)
        if unread is not None:
            cell = table.unread[unread]
            raise FlightDataError(
                f"{table.source}: the time '{unread}' contains neither numbers nor times (such as '{cell}')",
                NO_RATE,
            )
        raise FlightDataError(f"{table.source}: no column is the time ({clock.alternative})", NO_RATE)
    return clock


def _is_encoder(values: Floats, reference: Reference) -> bool:
    """Whether the `values` of a column are quantised by an encoder of the rig, in radians or degrees."""
    step = quantisation_step(values)
    return step > 0.0 and any(
        abs(turn / step / counts - 1.0) < _COUNTS_TOLERANCE
        for turn in (2.0 * np.pi, 360.0)
        for counts in reference.counts.values()
    )


@dataclass(frozen=True)
class ColumnOptions:
    """Columns that may have each role."""

    by_role: Mapping[str, Sequence[str]]
    stated: frozenset[str]  # Roles that a name or the user states
    left_out: Mapping[str, str]  # Columns that have no role, with the reason

    def columns(self) -> list[str]:
        """Columns that may have a role."""
        return list(dict.fromkeys(name for names in self.by_role.values() for name in names))

    @property
    def left_out_text(self) -> str:
        """The columns without a role, with their reasons, in words."""
        return f"left out: {', '.join(f'{name} ({reason})' for name, reason in self.left_out.items())}"

    def too_few(self, source: str) -> FlightDataError:
        """Describe a table in which columns of some roles are missing."""
        detail = f"; {self.left_out_text}" if self.left_out else ""
        has_angles = all(self.by_role[axis] for axis in AXES)
        voltage_count = sum(bool(self.by_role[role]) for role in VOLTAGE_ROLES)
        pulses = [name for name, reason in self.left_out.items() if reason == PULSES]
        if len(pulses) == len(PAIR) and voltage_count < len(PAIR):
            return FlightDataError(
                f"{source}: the motors have widths of pulses ({' and '.join(pulses)}), and the file does not "
                "state the widths at rest and at full voltage",
                'state both in a profile: for 1000 to 2000 us and 12 V, unit = "pwm", full = 1000 and '
                "offset_V = -12",
            )
        if has_angles and not voltage_count:
            return FlightDataError(f"{source}: no column is a motor voltage{detail}", _FIX)
        named_axes = [axis for axis in AXES if axis in self.stated]
        if len(named_axes) == 2 and not has_angles:
            constant = [f"'{name}' is constant" for name in _constant_angles(self.left_out).values()]
            angles: dict[str, str] = {axis: self.by_role[axis][0] for axis in named_axes}
            return two_angles_only(source, angles, " and ".join(constant))
        columns = ", ".join(self.columns()) or "none"
        missing = [axis for axis in AXES if not self.by_role[axis]]
        if not voltage_count:
            missing.append("a motor voltage")
        if len(self.columns()) >= len(AXES) + 2 and missing:
            return FlightDataError(
                f"{source}: no column can be {' or '.join(missing)}; possible for the others: "
                f"{columns}{detail}",
                _FIX,
            )
        return FlightDataError(
            f"{source}: fewer than five columns can be an angle or a voltage: {columns}{detail}; a rig with "
            "three axes has three angles and two voltages",
            _FIX,
        )


def two_angles_only(source: str, angles: Mapping[str, str], reason: str = "") -> FlightDataError:
    """Describe a table with two angles, `angles` by axis; a `reason` rules out the column of the third."""
    (missing,) = (axis for axis in AXES if axis not in angles)
    columns = " and ".join(f"{axis} ({column})" for axis, column in angles.items())
    because = f", because {reason}" if reason else ""
    return FlightDataError(
        f"{source}: the only angles are {columns}{because}, so this is not a log of a rig with three axes",
        f"add a column with {missing}; a rig with two axes needs another model than those of heli-host",
    )


def check_third_angle(
    source: str,
    regressions: Mapping[str, RegressionFit],
    best: Assignment,
    options: ColumnOptions,
    files: Sequence[PreparedFile],
    reference: Reference,
) -> None:
    """Refuse a table whose names state two angles or none, if the third one's column moves differently."""
    unstated = [axis for axis in AXES if axis not in options.stated]
    nats = {axis: regressions[axis].log_likelihood_ratio for axis in AXES}
    is_excited = min(nats["elevation"], nats["pitch"]) > _EXCITED_NATS
    # If no name states an angle, only travel shows whether the third one exists, because it follows pitch.
    if len(unstated) == len(AXES) and is_excited and nats["travel"] < DECISIVE_NATS:
        raise FlightDataError(
            f"{source}: no column moves like travel ({best.columns['travel']} follows pitch by only "
            f"{nats['travel']:.1f} nats, although the flight excites elevation and pitch), so that only two "
            f"angles are known",
            "add a column with travel, or state the columns in a profile",
        )
    if len(unstated) != 1:
        return
    # Travel follows pitch, so a column of pitch has to follow the voltages, and travel has to follow it.
    axes = ("pitch", "travel") if unstated == ["pitch"] else unstated
    if any(nats[axis] < DECISIVE_NATS for axis in axes):
        # If another order of the three angles fits better, the names are wrong, not the third column.
        if contradictions := _contradictions(best, options, files, reference):
            raise FlightDataError(
                f"{source}: the names of the angles contradict the motion ({contradictions[0].alternative})",
                "state the columns in a profile",
            )
        angles = {axis: best.columns[axis] for axis in AXES if axis not in unstated}
        reason = f"'{best.columns[unstated[0]]}' does not move like {unstated[0]}"
        raise two_angles_only(source, angles, reason)


def column_options(files: Sequence[PreparedFile], known: KnownEntries) -> ColumnOptions:
    """Find the columns that may have each role, by their names and by what the user knows."""
    first = files[0]
    meanings = meanings_of({name: first.table.columns[name].unit for name in first.signals.raw})
    named, unnamed, left_out = _sorted_by_meaning(files, known, meanings)
    left_out |= {name: f"not numbers, such as '{cell}'" for name, cell in first.table.unread.items()}
    left_out |= dict.fromkeys(first.too_sparse, "too few numbers")
    unnamed_axes = [axis for axis in AXES if not named[axis]]
    # Two columns with the name of one angle, and no name for another angle: books use other letters.
    shared = [axis for axis in AXES if unnamed_axes and len(named[axis]) > 1]
    spare = [name for axis in shared for name in named[axis]]
    has_voltages = _keep_motors_or_sums(named, left_out)
    if unnamed_axes or not has_voltages:
        named_columns = [name for names in named.values() for name in names]
        unnamed, redundant = _distinct_columns(first, unnamed, named_columns, meanings)
        left_out |= redundant
    motors = [name for name in unnamed if meanings[name].possible_roles == VOLTAGE_ROLES]
    names_no_voltage = not any(named[role] for role in VOLTAGE_ROLES)
    by_role: dict[str, list[str]] = {}
    for role in ROLES:
        if named[role]:
            by_role[role] = named[role]
            continue
        possible = [name for name in unnamed if role in meanings[name].possible_roles]
        if role in AXES:
            # A name states which column is this angle, although it does not move.
            by_role[role] = [] if role in _constant_angles(left_out) else possible + spare
        elif not has_voltages and (names_no_voltage or any(named[each] for each in _partners(role))):
            by_role[role] = motors if len(motors) > 1 else possible
        else:
            by_role[role] = []
    stated = frozenset(role for role in ROLES if named[role] and role not in shared)
    return ColumnOptions(by_role, stated, left_out)


def _constant_angles(left_out: Mapping[str, str]) -> dict[str, str]:
    """Return the columns that were left out because they are constant, by the angle that they name."""
    meanings = {name: meaning_of(name) for name, reason in left_out.items() if reason == "constant"}
    return {each.role: name for name, each in meanings.items() if each.role in AXES and not each.quantity}


def _partners(role: str) -> tuple[str, str]:
    """Return both roles of voltages that a log has together with a `role`."""
    return PAIR if role in PAIR else SUMS


class _SortedColumns(NamedTuple):
    """Columns of a table by what their names state."""

    named: dict[str, list[str]]  # Columns to which a name or the user gives a role, by role
    unnamed: list[str]  # Columns whose name states no role
    left_out: dict[str, str]  # Reasons of the other columns, by name


def _sorted_by_meaning(
    files: Sequence[PreparedFile], known: KnownEntries, meanings: Mapping[str, ColumnMeaning]
) -> _SortedColumns:
    """Sort the columns by what their names state; columns that carry no information are left out."""
    first = files[0]
    known_roles = set(known.columns.values())
    named: dict[str, list[str]] = {role: [] for role in ROLES}
    unnamed: list[str] = []
    left_out: dict[str, str] = {}
    for name, meaning in meanings.items():
        if name in known.columns:
            named[known.columns[name]].append(name)
        elif any(name not in file.signals.raw for file in files):
            left_out[name] = "not in every file"
        elif any(np.ptp(file.signals.raw[name]) == 0.0 for file in files):
            left_out[name] = "constant"
        elif not meaning.role and _counts_rows(first.table.columns[name].values):
            left_out[name] = "a counter of rows"
        elif meaning.quantity:
            # Such as a setpoint, which is neither a measured angle nor a voltage.
            left_out[name] = meaning.quantity
        elif meaning.role in known_roles:
            left_out[name] = f"the profile states another column for {meaning.role}"
        elif meaning.role:
            named[meaning.role].append(name)
        else:
            unnamed.append(name)
    for role, columns in named.items():
        voltages = [name for name in columns if states_voltage(name, first.table.columns[name].unit)]
        if role in VOLTAGE_ROLES and voltages:
            others = [name for name in columns if name not in (*voltages, *known.columns)]
            left_out |= dict.fromkeys(others, f"{voltages[0]} states a voltage")
            columns[:] = [name for name in columns if name not in others]
        # Measured angles first, and among them those of encoders: the first column is kept of each copy.
        columns.sort(key=lambda name: (not meanings[name].is_measured, name not in first.encoders))
        measured = [name for name in columns if meanings[name].is_measured]
        named[role], copies = _without_copies(first, role, columns, measured)
        left_out |= copies
    return _SortedColumns(named, unnamed, left_out)


def _counts_rows(values: Floats) -> bool:
    """Whether whole numbers rise by the same step nearly everywhere, which no angle and no voltage does."""
    steps = np.diff(values)
    step = float(np.median(steps))
    is_whole = step >= 1.0 and step.is_integer()
    return is_whole and float(np.mean(steps == step)) > _COUNTING_SHARE


def _keep_motors_or_sums(named: dict[str, list[str]], left_out: dict[str, str]) -> bool:
    """Whether names state both voltages. If they state the motors and their sums, the sums are moved from
    `named` to `left_out`.
    """
    if all(named[role] for role in PAIR):
        for role in SUMS:
            left_out |= dict.fromkeys(named[role], "the motors have columns too")
            named[role] = []
        return True
    if all(named[role] for role in SUMS):
        for role in PAIR:
            left_out |= dict.fromkeys(named[role], "sum and difference have columns")
            named[role] = []
        return True
    return False


def _without_copies(
    file: PreparedFile, role: str, columns: list[str], measured: list[str]
) -> tuple[list[str], dict[str, str]]:
    """Return the columns of one role without copies of its first one, and without those that are not measured
    if others are; and the columns that are left out, with the reasons.
    """
    signals = file.signals
    kept: list[str] = []
    left_out: dict[str, str] = {}
    for name in columns:
        # A command and the voltage of its amplifier differ by a gain, which the motion does not show.
        if kept and _are_copies(signals, name, kept[0]) and not _differ_by_gain(file, role, name, kept[0]):
            left_out[name] = f"the same as {kept[0]}"
        elif kept and (lag_s := _filter_lag_s(signals, name, kept[0])) is not None:
            # The copy may come first; then the origin is ahead of it.
            origin, copy = (name, kept[0]) if lag_s < 0.0 else (kept[0], name)
            kept[0] = origin
            left_out[copy] = f"a filtered copy of {origin}"
        elif measured and name not in measured:
            left_out[name] = f"{measured[0]} is measured"
        else:
            kept.append(name)
    return kept, left_out


def _distinct_columns(
    file: PreparedFile, unnamed: list[str], named: list[str], meanings: Mapping[str, ColumnMeaning]
) -> tuple[list[str], dict[str, str]]:
    """Return the columns without names that are no rates or copies of others, up to a limit; and the reasons
    to leave out the rest of them.
    """
    signals, columns = file.signals, [*named, *unnamed]
    rates = _rates(signals, columns, set(named) | file.encoders)
    left_out = {name: f"the rate of {angle}" for name, angle in rates.items()}
    motors = {name for name in unnamed if meanings[name].possible_roles == VOLTAGE_ROLES}

    def rank(name: str) -> tuple[bool, bool, bool]:
        """Motors first, then encoders. Last are columns that are about the rate of another one: under state
        feedback, so is the sum of the voltages, but with another slope.
        """
        # The square of a correlation is the explained share of the variance.
        correlations = (_rate_correlation(signals, name, other) for other in columns)
        resembles_rate = any(correlation > FEEDBACK_MATCH**0.5 for correlation in correlations)
        return name not in motors, name not in file.encoders, resembles_rate

    kept: list[str] = []
    for name in sorted((name for name in unnamed if name not in rates), key=rank):
        # Two motors may get the same voltage, and a column in volts stands for no angle.
        roles = set(meanings[name].possible_roles)
        others = [
            other
            for other in (*named, *kept)
            if not {name, other} <= motors and roles.intersection(meanings[other].possible_roles)
        ]
        copied = next((other for other in others if _are_copies(signals, name, other)), None)
        origin = None if name in motors else _filter_origin(file, name, others)
        if copied is not None:
            left_out[name] = f"the same as {copied}"
        elif origin is None:
            kept.append(name)
        elif origin.column_is_behind and origin.column in named:
            # A named axis follows this column, which may be a setpoint: third angle and voltages are checked
            # for that later.
            kept.append(name)
        elif origin.column_is_behind and origin.column not in file.encoders:
            # The copy was kept first: this column replaces it.
            kept[kept.index(origin.column)] = name
            left_out[origin.column] = f"a filtered copy of {name}"
        else:
            left_out[name] = f"a filtered copy of {origin.column}"
    left_out |= dict.fromkeys(kept[_MAX_COLUMNS:], f"behind the first {_MAX_COLUMNS} columns")
    return kept[:_MAX_COLUMNS], left_out


class _FilterOrigin(NamedTuple):
    """A column that another one resembles through a filter."""

    column: str  # The other column
    column_is_behind: bool  # Whether `column` lags, so that it is the copy


def _filter_origin(file: PreparedFile, name: str, others: Sequence[str]) -> _FilterOrigin | None:
    """Find the first of some `others` of which a column is a filtered copy, or which is a copy of it."""
    for other in others:
        lag_s = None if _share_limit(file.table, name, other) else _filter_lag_s(file.signals, name, other)
        if lag_s is not None:
            return _FilterOrigin(other, column_is_behind=lag_s < 0.0)
    return None


def _are_copies(signals: Signals, name: str, other: str) -> bool:
    """Whether two columns are the same signal, in another unit or with another sign."""
    return abs_correlation(signals.raw[name], signals.raw[other]) > _DUPLICATE_CORRELATION


def _share_limit(table: Table, name: str, other: str) -> bool:
    """Whether two columns often have the same largest value, as motors in a flight that hardly pitches. A
    filtered copy reaches the limits of its origin seldom.
    """
    columns = [table.columns[each].values for each in (name, other)]
    limit, other_limit = (float(np.nanmax(values)) for values in columns)
    shares_at_limit = [float(np.mean(values == limit)) for values in columns]
    return limit == other_limit and min(shares_at_limit) > _LIMITED_SHARE


def _differ_by_gain(file: PreparedFile, role: str, name: str, other: str) -> bool:
    """Whether two columns of a voltage have different sizes in the same unit."""
    units = {file.table.columns[each].unit or split_unit(each)[1] for each in (name, other)}
    sizes = [float(file.signals.raw[each].std()) for each in (name, other)]
    return role in VOLTAGE_ROLES and len(units) == 1 and max(sizes) > _GAIN_RATIO * min(sizes)


def _filter_lag_s(signals: Signals, name: str, origin: str) -> float | None:
    """Return the lag of a column behind another one whose filtered copy it is [s]; None if it is no copy.

    Their rates are compared, because two columns that rise steadily resemble each other without a cause.
    """
    rate, origin_rate = signals.filtered[name].rate, signals.filtered[origin].rate
    inner = signals.inner
    matches = {
        lag_s: abs_correlation(delay(origin_rate, lag_s)[inner], rate[inner]) for lag_s in _FILTER_LAGS_S
    }
    lag_s = max(matches, key=lambda each: matches[each])
    # Two motors may get almost the same voltage, but at the same time.
    if lag_s == 0.0 or matches[lag_s] <= _FILTERED_MATCH:
        return None
    # A filter smooths. An axis that follows its setpoint is rougher than the setpoint.
    later, earlier = (name, origin) if lag_s > 0.0 else (origin, name)
    return lag_s if _roughness(signals, later) < _roughness(signals, earlier) else None


def _roughness(signals: Signals, name: str) -> float:
    """Return the size of a column's fast changes relative to its slow ones, in any unit."""
    slow = float(signals.filtered[name].rate[signals.inner].std())
    return float(np.diff(signals.raw[name], 2)[signals.inner[2:]].std()) / max(slow, 1e-300)


def _rate_correlation(signals: Signals, name: str, origin: str) -> float:
    """Correlate a column with the time derivative of another one; 0 if the slope is that of no unit."""
    rate, value = signals.filtered[origin].rate, signals.filtered[name].value
    correlation = abs_correlation(rate, value) if name != origin else 0.0
    return correlation if correlation > 0.5 and has_unit_slope(rate, value, signals) else 0.0


def _rates(signals: Signals, columns: list[str], no_rates: set[str]) -> dict[str, str]:
    """Find the columns that are the time derivative of another column, with that column.

    A column cannot be judged alone. Pitch drives travel, so the derivative of a logged travel rate resembles
    pitch; likewise that of a logged pitch rate resembles a voltage. Neither pitch nor the voltage is a logged
    rate. Therefore a column counts as a derivative only if its origin is not itself a derivative.
    """
    origins: dict[str, dict[str, float]] = {name: {} for name in columns}
    for name, origin in itertools.permutations(columns, 2):
        correlation = 0.0 if name in no_rates else _rate_correlation(signals, name, origin)
        # The threshold is a share of variance, the square of a correlation.
        if correlation > _RATE_MATCH**0.5:
            origins[name][origin] = correlation
    rates: dict[str, str] = {}
    others: set[str] = set()
    undecided = list(columns)
    while undecided:
        # A column is decided after all columns of which it may be the derivative.
        ready = [name for name in undecided if not set(origins[name]).intersection(undecided)]
        if not ready:
            # Columns that are derivatives of each other in a circle, as with sines, whose second derivative
            # is a sine again: the one with the lowest correlation counts as no derivative.
            weakest = min(undecided, key=lambda name: max(origins[name].values()))
            origins[weakest] = {}
            ready = [weakest]
        for name in ready:
            angle = next((origin for origin in origins[name] if origin in others), None)
            if angle is None:
                others.add(name)
            else:
                rates[name] = angle
        undecided = [name for name in undecided if name not in ready]
    return rates


class _MotionEvidence:
    """How well columns of one file explain each other's motion."""

    def __init__(self, file: PreparedFile, reference: Reference) -> None:
        self._file, self._reference = file, reference
        self._nats: dict[tuple[str, tuple[str, ...], str], float] = {}

    def polarity(self, name: str) -> float:
        """Return the sign, 1 or -1, that makes the mean of a voltage positive; 1 if it is near 0."""
        values = self._file.signals.raw[name]
        mean = float(values.mean())
        return -1.0 if mean < 0.0 and abs(mean) > 0.5 * float(values.std()) else 1.0

    def nats(self, axis: str, cause: tuple[str, ...], column: str) -> float:
        """Log-likelihood ratio of a cause of an axis, one column or both motors, for the axis' column."""
        key = axis, cause, column
        if key not in self._nats:
            self._nats[key] = self._computed_nats(axis, cause, column)
        return self._nats[key]

    def _computed_nats(self, axis: str, cause: tuple[str, ...], column: str) -> float:
        signals = self._file.signals
        lifting = [self.polarity(name) * signals.filtered[name].value for name in cause]
        if axis == "elevation":
            signal: Floats = np.sum(lifting, axis=0)
        elif len(cause) == 2:
            first, second = lifting
            signal = first - second
        else:
            # A logged difference has no polarity, because its mean is near 0; neither has pitch.
            signal = signals.filtered[cause[0]].value
        stiffness = self._reference.stiffness[axis]
        nats = max(
            regress_acceleration(signals, column, axis, delay(signal, lag_s), stiffness).log_likelihood_ratio
            for lag_s in (_ROLE_LAGS_S if axis != "travel" else (0.0,))
        )
        if column in self._file.encoders:
            nats += _ENCODER_NATS
        if axis == "elevation" and len(cause) == 1:
            nats += _FEEDBACK_NATS * abs(feedback_sign(signal, signals.filtered[column], signals))
        return nats


def ranked_assignments(
    files: Sequence[PreparedFile], options: ColumnOptions, reference: Reference
) -> list[Assignment]:
    """List the assignments of columns to roles that the options permit, the most likely motion first."""
    by_file = [_MotionEvidence(file, reference) for file in files]

    def nats(axis: str, cause: tuple[str, ...], column: str) -> float:
        return sum(evidence.nats(axis, cause, column) for evidence in by_file)

    ranked = []
    for roles in (PAIR, SUMS):
        for first, second in _voltage_columns(options, roles):
            both = (first, second)
            # Each motor drives both axes; a logged sum and a logged difference drive one axis each.
            sum_cause, difference_cause = (both, both) if roles == PAIR else ((first,), (second,))
            elevations = sorted(
                (name for name in options.by_role["elevation"] if name not in both),
                key=lambda name: -nats("elevation", sum_cause, name),
            )
            first_polarity, second_polarity = (by_file[0].polarity(name) for name in both)
            polarity = (first_polarity, second_polarity if roles == PAIR else 1.0)
            for pitch, travel in itertools.product(options.by_role["pitch"], options.by_role["travel"]):
                if len({first, second, pitch, travel}) < 4:
                    continue  # a column has one role
                nats_of_others = nats("pitch", difference_cause, pitch) + nats("travel", (pitch,), travel)
                # The runner-up shows how sure the choice of elevation is; further ones would show nothing.
                for elevation in [name for name in elevations if name not in (pitch, travel)][:2]:
                    columns = dict(zip((*AXES, *roles), (elevation, pitch, travel, *both), strict=True))
                    log_likelihood = nats_of_others + nats("elevation", sum_cause, elevation)
                    ranked.append(Assignment(columns, polarity, log_likelihood))
    return sorted(ranked, key=lambda assignment: -assignment.log_likelihood)


def _voltage_columns(options: ColumnOptions, roles: tuple[str, str]) -> list[tuple[str, str]]:
    """List the pairs of columns for two roles of voltages; motors without names count in one order only."""
    pairs = [
        (first, second)
        for first, second in itertools.product(*(options.by_role[role] for role in roles))
        if first != second
    ]
    if roles == PAIR and not options.stated.intersection(PAIR):
        pairs = [pair for number, pair in enumerate(pairs) if pair[::-1] not in pairs[:number]]
    return pairs


def column_ambiguities(
    ranked: Sequence[Assignment], options: ColumnOptions, files: Sequence[PreparedFile], reference: Reference
) -> tuple[list[Ambiguity], str]:
    """Report columns that no name states, or whose names the motion contradicts; and say which are used."""
    best = ranked[0]
    others = [assignment for assignment in ranked if not assignment.same_as(best)]
    is_stated = options.stated.issuperset(best.columns)
    if not others and is_stated:
        return _contradictions(best, options, files, reference), f"columns: {best}, as their names state"
    if not others:
        return [], f"columns: {best}; no other column is possible"
    margin = best.log_likelihood - others[0].log_likelihood
    sentence = f"columns: {best}; {margin:.0f} nats ahead of every alternative"
    near = [other for other in others if best.log_likelihood - other.log_likelihood < DECISIVE_NATS]
    if near:
        reason = f"they explain the flight within {margin:.1f} nats of each other"
        return [Ambiguity("the columns", str(best), _differences_text(best, near), reason)], sentence
    if is_stated:
        # Several columns have the name of one role, and the motion alone chooses among them.
        reason = (
            f"both have the name, and the motion is {margin:.0f} nats for this choice; look up which is it"
        )
        return [Ambiguity("the columns", str(best), _differences_text(best, others[:1]), reason)], sentence
    unstated = ", ".join(role for role in best.columns if role not in options.stated)
    current = ""
    if not _names_state_voltages(best, files[0].table):
        current = "a motor's current moves like its voltage, and no number distinguishes them; "
    reason = (
        f"no name states {unstated}, and the motion is {margin:.0f} nats for this choice; {current}"
        "name the columns, or state them in a profile"
    )
    return [Ambiguity("the columns", str(best), _differences_text(best, others[:1]), reason)], sentence


def _names_state_voltages(best: Assignment, table: Table) -> bool:
    """Whether names or units state that both columns of the voltages are voltages, of whichever motor."""
    return all(_names_state_voltage(name, table) for name in best.voltages)


def _names_state_voltage(name: str, table: Table) -> bool:
    """Whether the name or the unit of a column states that it is a voltage, of whichever motor."""
    meanings = meanings_of({name: column.unit for name, column in table.columns.items()})
    return set(meanings[name].possible_roles) <= set(VOLTAGE_ROLES)


def _contradictions(
    best: Assignment, options: ColumnOptions, files: Sequence[PreparedFile], reference: Reference
) -> list[Ambiguity]:
    """Report if the motion fits another order of the three angles better than their names."""
    angles = [best.columns[axis] for axis in AXES]
    permuted = replace(options, by_role={**options.by_role, **dict.fromkeys(AXES, angles)})
    by_motion = ranked_assignments(files, permuted, reference)[0]
    (as_named,) = (
        each for each in ranked_assignments(files, options, reference) if each.columns == best.columns
    )
    if by_motion.log_likelihood - as_named.log_likelihood < DECISIVE_NATS:
        return []  # in doubt, the names count
    return [
        Ambiguity(
            "the columns",
            f"{best}, as their names say",
            str(by_motion),
            "which fits the motion; names and physics disagree",
        )
    ]


def _differences_text(best: Assignment, others: Sequence[Assignment]) -> str:
    """Describe the columns of other assignments that differ from the best one, by role."""
    differing: dict[str, list[str]] = {}
    for other in others:
        for role, column in other.columns.items():
            if column != best.columns.get(role) and column not in differing.setdefault(role, []):
                differing[role].append(column)
    return ", or ".join(f"{role} is {' or '.join(columns)}" for role, columns in differing.items() if columns)


def check_voltages(
    source: str,
    regressions: Mapping[str, RegressionFit],
    best: Assignment,
    options: ColumnOptions,
    files: Sequence[PreparedFile],
) -> list[Ambiguity]:
    """Refuse columns without the names of voltages that do not act like voltages; report a doubtful sum."""
    if options.stated.issuperset(role for role in best.columns if role in VOLTAGE_ROLES):
        return []  # their names state what they are
    followed = [
        f"{axis} follows {column}"
        for axis, column, role in zip(("elevation", "pitch"), best.voltages, SUMS, strict=True)
        # A name or a unit states that a column is a voltage, whatever an axis seems to follow.
        if best.summed
        and role not in options.stated
        and not _names_state_voltage(column, files[0].table)
        and all(_is_followed(file.signals, column, best.columns[axis]) for file in files)
    ]
    nats = max(regressions[axis].log_likelihood_ratio for axis in ("elevation", "pitch"))
    columns = " and ".join(best.voltages)
    if followed:
        reason = f"{' and '.join(followed)}, as an axis follows its setpoint"
    elif nats < DECISIVE_NATS and not _names_state_voltages(best, files[0].table):
        reason = f"{columns} explain only {nats:.1f} nats"
    else:
        return _doubtful_sum(regressions["elevation"], best, options)
    # Under feedback, pitch may resemble the difference that drives it, so that only the user can decide.
    raise FlightDataError(
        f"{source}: no two columns act like motor voltages ({reason})",
        f"{_FIX}; if they are the voltages, state the columns in a profile",
    )


def equal_voltages(best: Assignment, files: Sequence[PreparedFile]) -> list[Ambiguity]:
    """Report the columns of two motors that are equal in nearly all rows: one of them is a copy."""
    shares = []
    for file in files:
        first, second = (file.table.columns[name].values for name in best.voltages)
        is_known = np.isfinite(first) & np.isfinite(second)
        is_driven = is_known & ((first != 0.0) | (second != 0.0))
        shares.append(float(np.mean((first == second)[is_driven])) if is_driven.any() else 0.0)
    if best.summed or min(shares) < _EQUAL_SHARE:
        return []
    return [
        Ambiguity(
            "the voltages' columns",
            " and ".join(best.voltages),
            "another column for one of the motors",
            f"both columns are equal in {100.0 * min(shares):.0f} % of the rows, and equal voltages cannot "
            "control pitch; look up which column is the other motor",
        )
    ]


def _is_followed(signals: Signals, column: str, axis: str) -> bool:
    """Whether an axis follows a column at some lag, as it follows a setpoint in the same unit."""
    value = signals.filtered[axis].value
    for lag_s in _FOLLOWING_LAGS_S:
        setpoint = delay(signals.filtered[column].value, lag_s)
        if abs_correlation(setpoint, value) > _FOLLOWED:
            # A setpoint in the same unit has a slope of about 1; voltages have any.
            slope = float(np.cov(setpoint, value)[0, 1] / setpoint.var())
            return 0.5 < slope < 2.0
    return False


def _doubtful_sum(elevation: RegressionFit, best: Assignment, options: ColumnOptions) -> list[Ambiguity]:
    """Report the voltages' columns if their sum hardly explains elevation."""
    nats = elevation.log_likelihood_ratio
    others = [name for name in options.columns() if name not in best.columns.values()]
    others += [f"{name} ({reason})" for name, reason in options.left_out.items() if reason != "constant"]
    if nats >= DECISIVE_NATS or not others:
        return []  # no doubt, or no other column to look up
    return [
        Ambiguity(
            "the sum's column" if best.summed else "the voltages' columns",
            best.voltages[0] if best.summed else " and ".join(best.voltages),
            " or ".join(others),
            f"elevation agrees with the sum by only {nats:.1f} nats; under state feedback, the sum is "
            "proportional to minus the rate of elevation; look up which column was logged",
        )
    ]


def stated_unit(table: Table, column: str, valid_units: frozenset[str]) -> str:
    """Return the unit that the header or the name of a `column` states; empty if it is not a valid unit."""
    units = (table.columns[column].unit, split_unit(column)[1])
    return next((unit for unit in units if unit in valid_units), "")
