"""Make signals of the columns of a table: the time, the longest part without a jump, filter, derivatives."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from functools import cache
from typing import Final, NamedTuple

import numpy as np
from heli_host.data.arrays import Booleans, Floats, Integers
from heli_host.data.tables import Table
from heli_host.data.tables.rows import longest_rise, spikes
from heli_host.data.tables.table import ANGLE_UNITS, TIME_UNITS, split_unit, unit_of
from numpy.typing import NDArray

from heli_lab.setup.guess import names

NO_RATE: Final = "give a column of times, or the sampling rate with --rate"
"""Fix of a file without times."""
_MIN_TIMES: Final = 10
"""Smallest number of values of a time column."""
_MIN_RISING_SHARE: Final = 0.995
"""Smallest share of rows in which a time column rises; a clock may be set back now and then."""
_MAX_FALLING_SHARE: Final = 0.4
"""Share of rows in which a column with the name of a time may fall. A counter of 16 bits in microseconds
falls in 15 % of the rows at 100 Hz; noise falls in half of them."""
_MAX_UNNAMED_FALLING_SHARE: Final = 0.03
"""The same for a column without such a name, if it lies on a line. Packets of a network change places in
1 %."""
_LINEAR: Final = 0.9999
"""Correlation with the row number from which a column without the name of a time may be one. Travel at a
constant rate has less, because it begins at rest."""
_COARSE_SHARE: Final = 0.5
"""Share of rows that equal the row before, above which a column may be a coarse clock."""
_RUN_DEVIATION: Final = 0.25
"""Deviation of an equal run of a coarse clock from the usual length, as a share of it; a row is rounding."""
_EVEN_RUN_SHARE: Final = 0.9
"""Smallest share of such runs. Clocks that lose rows have shorter ones; other quantities have all lengths."""
_COARSE: Final = "another quantity that rises in equal steps"
"""Other meaning of a column without the name of a time, whose values repeat as those of a coarse clock."""
_MAX_RISE: Final = 3.0
"""Rise from row to row, as a multiple of the median, from which rows are missing."""
_STEP_ROWS: Final = 1000
"""Number of rows over which the step of a coarse clock is averaged: more than rows share a time."""
_BURST_ROWS: Final = 20
_BURST_RATIO: Final = 3.0
"""Number of rows whose average step counts if rows come in bursts, and its smallest ratio to the median."""
_MAX_UNEVENNESS: Final = 0.5
"""Largest deviation of an even step from the median step, as a share of it."""
_STEPS_s: Final = (0.0002, 0.15)
"""Smallest and largest step of a log [s]; logs of such flights have at least 7 Hz."""
MIN_FLIGHT_S: Final = 3.0
"""Duration of a log below which a larger unit of its times is more plausible [s]. Arms move for seconds."""
_JUMP_STEPS: Final = 15.0
"""A step of an angle this many times above its typical largest one is a jump. Angles have up to 3; voltages
have up to 15, when a setpoint moves. Lower values cut flights there, higher ones miss jumps of slow logs."""
_JUMP_SHARE: Final = 0.03
"""Smallest jump as a share of the column's range. Smaller ones are left to the conversion, in degrees."""
_MIN_ROWS: Final = 100
_MAX_JUMPS: Final = 3
"""Columns with more jumps are not angles: voltages that a controller switches jump all the time."""
_MIN_MOVING_SHARE: Final = 0.03
"""Share of rows with a change; setpoints have less, encoders at 1 kHz more."""

SAMPLE_STEP_s: Final = 0.01
"""Step of the resampled signals [s]. Set by judgement: far shorter than any motion of the arm."""
CUTOFF_Hz: Final = 1.5
"""Corner of the low-pass filter before differentiation [Hz]. Set on measured flights: at 3 Hz the
quantisation of 50 Hz logs hides elevation, at 0.7 Hz the pitch loop is filtered out."""
EDGE_S: Final = 0.7
"""Time that is ignored at both ends because of the filter's transients [s]: one period of the corner."""
_EXTENDED_ROWS: Final = 15
"""Number of rows of padding at each end, reflected about the end value."""
_COUNTER: Final = 65536.0
"""Number at which a counter of 16 bits overflows."""
_WRAP_STEPS: Final = 3.0
"""Step across a wrap, as a multiple of the typical step nearby. Angles have about 1; a voltage at take-off
has ten and more. A lost row next to a wrap doubles the step."""
_NEARBY_ROWS: Final = 10
"""Rows before and after a jump that count as nearby."""
_SETTLED_ROWS: Final = round(16.0 / (CUTOFF_Hz * SAMPLE_STEP_s))
"""Number of rows after which the impulse response of the low-pass filter has decayed to 1e-16."""


@dataclass(frozen=True)
class Clock:
    """Time column of a table."""

    column: str  # Name of the column; empty if the table has no times
    unit: str  # Unit: `s`, `ms`, `us`, `ns`, `min` or `day`; empty if no unit fits
    sure: bool  # Whether column and unit are unambiguous
    alternative: str = ""  # Other meaning of the column, or the reason why there is no column or no unit


def clock_of(table: Table) -> Clock:
    """Find the time column of a table and its unit: the best of all columns that rise from row to row.

    A column counts for its name (2 points), for even steps (up to 1), for a unit with which it has a
    plausible step (1), and if column and unit are unambiguous (1). A column whose name means the time may
    fall and repeat: its rows are repaired later.
    """
    scored_clocks: list[_ScoredClock] = []
    reasons: list[str] = []
    states_time = any(names.is_time(name) for name in table.columns)
    for name, column in table.columns.items():
        values = column.values[np.isfinite(column.values)]
        if values.size < _MIN_TIMES:
            continue  # nearly empty
        steps = np.diff(values)
        # A unit of times names the time, too, in a language whose word is not known.
        has_time_unit = (column.unit or split_unit(name)[1]) in TIME_UNITS
        is_named = names.is_time(name) or (has_time_unit and not states_time)
        step = _mean_step(values)
        is_coarse = not is_named and _is_coarse_clock(values)
        is_clock = (is_coarse or _is_clock(values, is_named)) and step > 0.0
        if not is_clock:
            if is_named:
                reasons.append(_why_no_clock(name, values))
            continue
        even_share = float(np.mean(np.abs(steps / step - 1.0) < _MAX_UNEVENNESS))
        clock = _interpret_as_times(name, column.unit, step, float(values[0]), values.size)
        if is_coarse and clock.sure:
            clock = replace(clock, sure=False, alternative=_COARSE)
        score = 2.0 * is_named + even_share + bool(clock.unit) + clock.sure
        scored_clocks.append(_ScoredClock(score, bool(clock.unit), clock))
    if not scored_clocks:
        reasons.append("no column has the name of a time, and none rises steadily or in equal steps")
        return Clock("", "", sure=False, alternative=reasons[0])
    return max(scored_clocks, key=lambda scored: (scored.score, scored.has_unit)).clock


class _ScoredClock(NamedTuple):
    """A column that may be the time; of equal scores, the one with a unit wins."""

    score: float
    has_unit: bool
    clock: Clock


def _why_no_clock(name: str, values: Floats) -> str:
    """Give the reason why a column with the name of a time does not rise like one."""
    if np.ptp(values) == 0.0:
        return f"'{name}' is {values[0]:g} in all rows"
    steps = np.diff(values)
    rising_share, falling_share = float(np.mean(steps > 0.0)), float(np.mean(steps < 0.0))
    # A step ends one row after it begins, and people count rows from 1.
    first_row = int(np.argmax(steps < 0.0)) + 2
    return (
        f"'{name}' rises in {100.0 * rising_share:.0f} % of its rows and falls in "
        f"{100.0 * falling_share:.0f} %, first at row {first_row}"
    )


def _is_clock(values: Floats, is_named: bool) -> bool:
    """Whether a column rises like a clock; one whose name means the time may fall and repeat more often."""
    steps = np.diff(values)
    falling_share = float(np.mean(steps < 0.0))
    if float(np.mean(steps > 0.0)) >= _MIN_RISING_SHARE:
        return True
    if is_named:
        # Rows may be in the file twice, also if the newest is the first.
        return falling_share < _MAX_FALLING_SHARE or _falls_steadily(steps)
    if min(falling_share, 1.0 - falling_share) > _MAX_UNNAMED_FALLING_SHARE or np.ptp(values) == 0.0:
        return False  # it rises and falls as a signal does, or is constant
    rows = longest_rise(values if falling_share < 0.5 else -values)
    # The times of a few rows may be damaged.
    if rows.size < (1.0 - 2.0 * _MAX_UNNAMED_FALLING_SHARE) * values.size:
        return False
    # A clock may have stood still.
    moving = rows[np.diff(values[rows], prepend=-np.inf) != 0.0]
    is_moving = moving.size >= (1.0 - 2.0 * _MAX_UNNAMED_FALLING_SHARE) * values.size
    return _is_on_line(rows, values[rows]) or (is_moving and _is_on_line(moving, values[moving]))


def _is_coarse_clock(values: Floats) -> bool:
    """Whether a column never turns round, and holds each value for about as many rows, as a coarse clock."""
    steps = np.diff(values)
    steps = -steps if values[-1] < values[0] else steps
    starts = np.flatnonzero(steps) + 1
    if (steps < 0.0).any() or float(np.mean(steps == 0.0)) <= _COARSE_SHARE or starts.size <= _MIN_TIMES:
        return False  # it turns round, is not coarse, or has too few values
    # The file may cut off the runs at both ends.
    lengths = np.diff(starts)
    median_rows = float(np.median(lengths))
    is_even = np.abs(lengths - median_rows) <= max(1.0, _RUN_DEVIATION * median_rows)
    if float(np.mean(is_even)) < _EVEN_RUN_SHARE:
        return False
    return _is_on_line(starts[:-1] + 0.5 * (lengths - 1), values[starts[:-1]])


def _is_on_line(rows: Floats | Integers, values: Floats) -> bool:
    """Whether the `values` at some rows are on a straight line. Shapes: `rows` (n,), `values` (n,)."""
    # Neither missing rows nor rows at which a clock stood still are a bend of the line.
    steps = np.abs(np.diff(np.array([rows, values], np.float64), axis=1))
    along, line = np.cumsum(np.minimum(steps, _MAX_RISE * np.median(steps, axis=1, keepdims=True)), axis=1)
    return np.ptp(line) > 0.0 and float(np.corrcoef(along, line)[0, 1]) > _LINEAR


def _falls_steadily(steps: Floats) -> bool:
    """Whether the newest row comes first; steps of 0 do not count, and a few times may be damaged."""
    falls, rises = int((steps < 0.0).sum()), int((steps > 0.0).sum())
    return falls > (1.0 - _MAX_UNNAMED_FALLING_SHARE) * (falls + rises)


def _mean_step(values: Floats) -> float:
    """Return the typical rise of a clock from row to row, also if rows share times or a counter overflows."""
    steps = np.diff(values)
    if _falls_steadily(steps):
        steps, values = -steps, -values
    if float(np.mean(steps > 0.0)) > 0.5:
        typical = float(np.median(steps[steps > 0.0]))
        # Rows that come in bursts, such as messages of several kinds, have short steps and a long one.
        rows = max(1, min(values.size // 4, _BURST_ROWS))
        average = float(np.median((values[rows:] - values[:-rows]) / rows))
        return average if average > _BURST_RATIO * typical else typical
    rows = max(1, min(values.size // 4, _STEP_ROWS))
    return float(np.median((values[rows:] - values[:-rows]) / rows))


def _interpret_as_times(name: str, header_unit: str, step: float, first: float, rows: int) -> Clock:
    """Interpret a column that rises from row to row, from its `first` value on, as times of all `rows`."""
    shortest_s, longest_s = _STEPS_s
    fitting_units = [unit for unit, s in TIME_UNITS.items() if shortest_s <= step * s <= longest_s]
    # As 0.0003: a step in minutes at 50 Hz, or in seconds at 3 kHz, with which the log is a second long.
    short_units = [unit for unit in fitting_units if step * rows * TIME_UNITS[unit] < MIN_FLIGHT_S]
    long_units = [unit for unit in fitting_units if unit not in short_units]
    # The most plausible unit; empty if none fits.
    unit = next(iter(long_units + short_units), "")
    log_rates = f"a log has {1.0 / longest_s:.0f} to {1.0 / shortest_s:.0f} rows per second"

    def unsure(unit: str, alternative: str) -> Clock:
        """Return the column with an ambiguous unit, or without one, and the reason."""
        return Clock(name, unit, sure=False, alternative=alternative)

    words, is_named = names.words_of(name), names.is_time(name)
    stated_unit = header_unit or split_unit(name)[1]
    if not stated_unit:
        stated_unit = "ms" if "millis" in words else "us" if "micros" in words else unit_of(name)
    if stated_unit in TIME_UNITS:
        contradiction = f"'{name}' has steps of {step:g} {stated_unit}, but {log_rates}"
        if not fitting_units:
            return unsure("", contradiction)
        if stated_unit in fitting_units:
            return Clock(name, stated_unit, sure=True, alternative=contradiction)
        return unsure(unit, f"in {stated_unit}, as its name says, with steps of {step:g}")
    is_whole = step >= 1.0 and step == round(step)
    if is_whole and not is_named and names.meaning_of(name, header_unit).quantity == names.A_COUNTER:
        return unsure("", f"'{name}' counts the rows")
    may_count_rows = abs(step - 1.0) < 1e-6
    if may_count_rows and not is_named and first in (0.0, 1.0):
        return unsure("", f"'{name}' rises by 1 from row to row, as a counter of rows")
    if may_count_rows and not (is_named and unit):
        return unsure(unit or "ms", "it may count rows")
    if not unit:
        return unsure("", f"'{name}' has steps of {step:g}, but {log_rates}")
    if unknown := names.unknown_unit_of(name):
        return unsure(unit, f"in {unknown}, as its name says, which is no known unit")
    if long_units and short_units:
        return unsure(unit, f"in {short_units[0]}")
    # A log has steps of 0.2 to 150 ms. At most two units fit, and the first one is meant.
    return unsure(unit, "it may count rows") if may_count_rows else Clock(name, unit, sure=True)


def without_spikes(table: Table, columns: Collection[str]) -> Table:
    """Blank single values that jump away from their neighbours and back, as damaged digits do."""
    repaired = dict(table.columns)
    for name in columns:
        values = table.columns[name].values
        known = np.flatnonzero(np.isfinite(values))
        if known.size < _MIN_ROWS:
            continue  # too few neighbours to compare a value with
        is_spike = spikes(values[known])
        if is_spike.any():
            blanked = values.copy()
            blanked[known[is_spike]] = np.nan
            repaired[name] = replace(table.columns[name], values=blanked)
    return replace(table, columns=repaired)


def longest_run(table: Table, t_s: Floats) -> tuple[Table, Floats]:
    """Cut out the longest part of a table in which times rise and no angle jumps; return it with its times.
    Shapes: `t_s` (n,); returns `t_s` (k,).
    """
    known = np.flatnonzero(np.isfinite(t_s))
    breaks = set(known[1:][np.diff(t_s[known]) < 0.0].tolist())
    for name, column in table.columns.items():
        if names.meaning_of(name).role not in names.VOLTAGE_ROLES:
            jumps = _jump_rows(column.values, t_s)
            # A logger that misses its sensor repeats the last angle until the jump: no motion of the rig.
            breaks |= jumps | {_run_start(column.values, row - 1) for row in jumps}
    edges = [0, *sorted(breaks), len(t_s)]
    if len(edges) == 2:
        return table, t_s
    start, stop = max(itertools.pairwise(edges), key=lambda run: run[1] - run[0])
    return table.selected(np.arange(start, stop), ()), t_s[start:stop]


def _run_start(values: Floats, row: int) -> int:
    """Return the row after the first of the equal values that end at a `row`; 0 if it is in the first run."""
    differing = np.flatnonzero(values[:row] != values[row])
    return int(differing[-1]) + 2 if differing.size else 0


def _jump_rows(values: Floats, t_s: Floats) -> set[int]:
    """Find the rows at which an encoder's angle jumps, as when a program joins two flights in one log."""
    known = np.flatnonzero(np.isfinite(values) & np.isfinite(t_s))
    # Voltages jump with their setpoints; only encoders are quantised.
    if known.size < _MIN_ROWS or not quantisation_step(values):
        return set()
    elapsed_rows = np.maximum(np.diff(t_s[known]) / float(np.median(np.diff(t_s[known]))), 1.0)
    changes = np.abs(np.diff(unwrapped(values[known])))
    moving = changes[changes > 0.0]
    # A setpoint stands still except for its jumps.
    if moving.size < _MIN_MOVING_SHARE * changes.size:
        return set()
    typical_maximum = float(np.quantile(moving, 0.99))
    is_jump = changes > _JUMP_STEPS * typical_maximum * elapsed_rows
    is_jump &= changes > _JUMP_SHARE * np.ptp(values[known])
    jumps = [int(row) for row in np.flatnonzero(is_jump)]
    if len(jumps) > _MAX_JUMPS:
        return set()
    for row in jumps:
        # The angle moves smoothly before and after its jump: in five rows to either side.
        neighbours = np.delete(changes[max(row - 5, 0) : row + 6], min(row, 5))
        if float(neighbours.max(initial=0.0)) > 3.0 * typical_maximum:
            return set()
    return {int(known[row + 1]) for row in jumps}


def quantisation_step(values: Floats) -> float:
    """Find the quantisation step of a column, in its unit; 0 if the column is not quantised. Shapes:
    `values` (n,).

    A column is quantised if more than nine tenths of its small changes are multiples of the smallest one.
    """
    changes = np.abs(np.diff(values[np.isfinite(values)]))
    # Without the rounding errors of floats.
    changes = changes[changes > 1e-9 * max(1.0, float(np.ptp(values)))]
    if not changes.size:
        return 0.0
    smallest = float(changes.min())
    # The mean of all single steps has less rounding than the smallest change.
    step = float(changes[changes < 1.5 * smallest].mean())
    # A change of more than 20 steps contains the step's error 20 times, which exceeds the tolerance below.
    multiples = changes[changes < 20.0 * step] / step
    is_multiple = np.abs(multiples - np.round(multiples)) < 0.05
    return step if float(np.mean(is_multiple)) > 0.9 else 0.0


@dataclass(frozen=True)
class Signal:
    """A low-passed column and its derivatives: `value`, `rate` and `acceleration`, each of shape (n,).

    The unit is the column's, per s and per s^2.
    """

    value: Floats
    rate: Floats
    acceleration: Floats


@dataclass(frozen=True)
class Signals:
    """Columns of a table at even times, by name."""

    t_s: Floats  # (n,): Even times [s]
    raw: Mapping[str, Floats]  # (n,): Values at these times, unwrapped, without low-pass filter
    filtered: Mapping[str, Signal]  # Low-passed values with their derivatives
    inner: Booleans  # (n,): False for rows near both ends, where the filter has transients
    counts_per_turn: tuple[float, ...] = ()  # Counts per turn of the encoders that a column may come from


def column_signals(
    table: Table, t_s: Floats, columns: list[str], counts_per_turn: Collection[float] = ()
) -> Signals:
    """Resample columns of a table to even times, and low-pass them. Shapes: `t_s` (n,)."""
    has_time = np.isfinite(t_s)
    has_time[has_time] = np.concatenate(([True], np.diff(t_s[has_time]) > 0.0))
    even_s = np.arange(t_s[has_time][0], t_s[has_time][-1], SAMPLE_STEP_s)
    raw = {}
    for name in columns:
        values = table.columns[name].values
        known = has_time & np.isfinite(values)
        if known.sum() > 10:  # otherwise a column is too sparse, and has no signal
            raw[name] = np.interp(even_s, t_s[known], unwrapped(values[known], counts_per_turn))
    filtered = {name: filtered_signal(samples) for name, samples in raw.items()}
    inner = (even_s > even_s[0] + EDGE_S) & (even_s < even_s[-1] - EDGE_S)
    return Signals(even_s, raw, filtered, inner, tuple(counts_per_turn))


def filtered_signal(values: Floats, cutoff_Hz: float = CUTOFF_Hz) -> Signal:
    """Low-pass evenly sampled `values` with zero phase, and differentiate the result twice."""
    extended = np.pad(values, _EXTENDED_ROWS, mode="reflect", reflect_type="odd")
    # The second pass, backwards in time, cancels the phase lag of the first one.
    forward = _butterworth(extended, cutoff_Hz)
    low_passed = _butterworth(forward[::-1], cutoff_Hz)[::-1][_EXTENDED_ROWS:-_EXTENDED_ROWS]
    rate = np.gradient(low_passed, SAMPLE_STEP_s)
    return Signal(low_passed, rate, np.gradient(rate, SAMPLE_STEP_s))


def _butterworth(values: Floats, cutoff_Hz: float) -> Floats:
    """Apply a fourth-order Butterworth low-pass that is settled at the first value.

    The result equals that of scipy.signal.sosfilt, but importing scipy.signal takes longer than a guess.
    """
    # The next power of 2 at which the end of the circular convolution does not reach its beginning.
    fft_rows = 1 << (values.size + _SETTLED_ROWS - 1).bit_length()
    spectrum = np.fft.rfft(values - values[0], fft_rows)
    convolution = np.fft.irfft(spectrum * _butterworth_response(fft_rows, cutoff_Hz), fft_rows)
    low_passed: Floats = convolution[: values.size] + values[0]
    return low_passed


@cache
def _butterworth_response(fft_rows: int, cutoff_Hz: float) -> NDArray[np.complex128]:
    """Frequency response of a digital fourth-order Butterworth filter (bilinear transform), at the
    frequencies of a real FFT of `fft_rows` values; shape (fft_rows / 2 + 1,).
    """
    warped = np.tan(np.pi * np.fft.rfftfreq(fft_rows)) / np.tan(np.pi * cutoff_Hz * SAMPLE_STEP_s)
    # Poles of the analogue prototype, evenly spaced on the left half of the unit circle.
    poles = np.exp(1j * np.pi * np.array([5.0, 7.0, 9.0, 11.0]) / 8.0)
    response: NDArray[np.complex128] = 1.0 / np.prod(1j * warped[:, None] - poles, axis=1)
    return response


def unwrapped(values: Floats, counts_per_turn: Collection[float] = ()) -> Floats:
    """Unwrap a column that jumps by one turn; return other columns unchanged. Shapes: `values` (n,).

    At a wrap, the jump minus one turn is a step as small as the steps nearby. A voltage that is switched on
    may jump by nearly a turn too, but the difference from a turn is large; such a column stays unchanged.
    """
    steps = np.abs(np.diff(values))
    # A wrap crosses almost the whole range of the column, and happens seldom.
    is_jump = steps > 0.5 * np.ptp(values)
    jumps = steps[is_jump]
    if not jumps.size or jumps.size > 0.02 * values.size:
        return values
    largest_smooth_step = _WRAP_STEPS * _typical_steps_near_jumps(steps, is_jump)
    turns = [2.0 * np.pi / rad for rad in ANGLE_UNITS.values()]
    for turn in (*turns, *sorted(set(counts_per_turn)), _COUNTER):
        is_about_a_turn = np.all(np.abs(jumps / turn - 1.0) < 0.2)
        is_smooth = np.median(np.abs(jumps - turn) - largest_smooth_step) <= 0.0
        # The range of a wrapped angle is at most a turn.
        if is_about_a_turn and is_smooth and np.ptp(values) < 1.05 * turn:
            result: Floats = np.unwrap(values, period=turn)
            return result
    return values


def _typical_steps_near_jumps(steps: Floats, is_jump: Booleans) -> Floats:
    """Return, for each of the k jumps, the median of the steps nearby, which do not count jumps; at least
    the smallest step of the column. Shapes: `steps` (n,), `is_jump` (n,); returns (k,).
    """
    small_steps = np.where(is_jump, 0.0, steps)
    smallest = float(np.min(small_steps[small_steps > 0.0], initial=np.inf))
    if np.isinf(smallest):
        return np.zeros(int(is_jump.sum()))
    nearby_rows = [
        slice(max(row - _NEARBY_ROWS, 0), row + _NEARBY_ROWS + 1) for row in np.flatnonzero(is_jump)
    ]
    return np.array([max(float(np.median(small_steps[rows])), smallest) for rows in nearby_rows])


def delay(values: Floats, lag_s: float) -> Floats:
    """Delay evenly sampled `values` by `lag_s` [s]; the end value fills the gap."""
    rows = round(lag_s / SAMPLE_STEP_s)
    result: Floats = np.roll(values, rows)
    if rows > 0:
        result[:rows] = values[0]
    elif rows < 0:
        result[rows:] = values[-1]
    return result


def lagged(values: Floats, time_constant_s: float) -> Floats:
    """Pass evenly sampled `values` through a first-order lag that is settled at the first value."""
    age_s = np.arange(0.0, 10.0 * time_constant_s, SAMPLE_STEP_s)
    weight = np.exp(-age_s / time_constant_s)
    result: Floats = np.convolve(values - values[0], weight / weight.sum())[: values.size] + values[0]
    return result
