"""No row of a file is dropped, filled or moved without a word, whatever happened to its clock and lines."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Final

import heli_host
import numpy as np
import pytest
from heli_host.data.arrays import Floats
from heli_host.data.flight import Flight
from heli_host.data.log.reader import read_flight
from heli_host.data.tables import Angle, Column, Conversion, Profile, Table, Voltage, convert, read_table
from heli_host.data.tables.rows import spikes, substitutes, timed_rows
from heli_host.errors import FlightDataError
from heli_host.fly.plan import Plan
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

N: Final = 1500
RATE_Hz: Final = 100.0
HEADER: Final = "time [s],front [V],back [V],elevation [deg],pitch [deg],travel [deg]"
T_S: Final = np.arange(N) / RATE_Hz
TRAVEL_DEG: Final = 12.0 * T_S + 3.0 * np.sin(T_S)
VALUES: Final = np.column_stack(
    (
        7.0 + np.sin(5.0 * T_S) + 0.2 * np.sin(37.0 * T_S),
        7.0 - np.sin(3.0 * T_S) + 0.2 * np.cos(31.0 * T_S),
        8.0 * np.sin(0.9 * T_S),
        6.0 * np.sin(2.1 * T_S),
        TRAVEL_DEG,
    )
)


def profile(unit: str = "s") -> Profile:
    angles = {axis: Angle(f"{axis} [deg]", "deg") for axis in ("elevation", "pitch", "travel")}
    return Profile(
        angles, {name: Voltage(f"{name} [V]") for name in ("front", "back")}, "time [s]", time_unit=unit
    )


def lines(times: list[str] | Floats, values: Floats = VALUES) -> list[str]:
    return [
        ",".join([time if isinstance(time, str) else f"{time:.4f}", *(f"{value:.4f}" for value in row)])
        for time, row in zip(times, values, strict=True)
    ]


def converted(folder: Path, rows: list[str], unit: str = "s") -> Conversion:
    path = folder / "a.csv"
    path.write_text("\n".join([HEADER, *rows]) + "\n")
    return convert(read_table(path), profile(unit))


def worst_error(conversion: Conversion) -> float:
    """Largest error of elevation [deg] or voltage [V], with the row's true time from its travel."""
    worst = 0.0
    for flight in conversion.flights:
        travel_deg = np.degrees(flight.travel_rad)
        true_s = np.interp(travel_deg - 360.0 * np.round(travel_deg[0] / 360.0), TRAVEL_DEG, T_S)
        elevation_deg = np.interp(true_s, T_S, VALUES[:, 2])
        worst = max(worst, float(np.abs(np.degrees(flight.elevation_rad) - elevation_deg).max()))
        # The time of a row is true up to a constant.
        worst = max(worst, float(np.ptp(flight.t_s - true_s)))
    return worst


def actions(conversion: Conversion) -> set[str]:
    return {change.action for change in conversion.changes}


def swapped(rows: list[str]) -> list[str]:
    for row in range(20, len(rows) - 1, 83):
        rows[row], rows[row + 1] = rows[row + 1], rows[row]
    return rows


def blocks_swapped(rows: list[str]) -> list[str]:
    rows[640:768] = rows[704:768] + rows[640:704]
    return rows


def late(rows: list[str]) -> list[str]:
    for row in range(100, len(rows) - 100, 250):
        rows.insert(row + 50, rows.pop(row))
    return rows


def damaged(rows: list[str]) -> list[str]:
    for row in range(50, len(rows), 97):
        half = len(rows[row]) // 2
        rows[row] = f"{rows[row][:half]}\n^01/02/2026,03:04:05.67\n{rows[row][half:]}"
    for row in range(60, len(rows), 131):
        rows[row] = rows[row][:9] + rows[row][18:]
    return "\n".join(rows).splitlines()


def merged(rows: list[str]) -> list[str]:
    for row in range(len(rows) - 40, 0, -97):
        rows[row] += rows.pop(row + 1)
    return rows


def two_rates(rows: list[str]) -> list[str]:
    result = []
    for row, line in enumerate(rows):
        time, front, back, *angles = line.split(",")
        result.append(",".join([time, "", "", *angles]))
        result += [f"{float(time) + 0.002:.4f},{front},{back},,,"] if row % 4 == 0 else []
    return result


def slow_wrapped_angles(rows: list[str]) -> list[str]:
    result = []
    for row, line in enumerate(rows):
        time, front, back, elevation, pitch, travel = line.split(",")
        result.append(f"{time},{front},{back},,,")
        wrapped_deg = (float(travel) + 270.0) % 360.0 - 270.0
        result += [f"{float(time):.4f},,,{elevation},{pitch},{wrapped_deg:.4f}"] if row % 2 == 0 else []
    return result


REPAIRS: Final[dict[str, tuple[Callable[[list[str]], list[str]], int]]] = {
    "neighbours exchanged": (swapped, N),
    "blocks exchanged": (blocks_swapped, N),
    "packets late": (late, N),
    "newest first": (lambda rows: rows[::-1], N),
    "each row twice": (lambda rows: [row for row in rows for _ in range(2)], N),
    "some rows twice": (
        lambda rows: [row for i, row in enumerate(rows) for _ in range(1 + (i % 37 == 5))],
        N,
    ),
    "the file twice": (lambda rows: rows * 2, N),
    "damaged lines": (damaged, N),
    "merged lines": (merged, N),
    "header again": (lambda rows: [*rows[:700], HEADER, *rows[700:]], N),
    "two rates": (two_rates, N - 1),
    "slow angles that wrap": (slow_wrapped_angles, N - 1),
}


@pytest.mark.parametrize("kind", REPAIRS)
def test_rows_are_repaired_and_counted(kind: str, tmp_path: Path) -> None:
    fault, count = REPAIRS[kind]
    rows = fault(lines(T_S))
    conversion = converted(tmp_path, rows)
    (flight,) = conversion.flights
    assert (len(flight), conversion.file_rows, conversion.unexplained_rows) == (count, len(rows), 0)
    assert conversion.changes
    assert worst_error(conversion) < 0.05


def overflowing(bits: int, per_s: float, begin: int) -> list[str]:
    return [str((round(t * per_s) + begin) % 2**bits) for t in T_S]


CLOCKS: Final = {
    "five digits": ([f"{t:.4g}" for t in T_S + 95.0], "s"),
    "tenths": ([f"{t:.1f}" for t in T_S], "s"),
    "whole seconds": ([f"{t:.0f}" for t in T_S], "s"),
    "16 bits ms": (overflowing(16, 1e3, 60000), "ms"),
    "16 bits us": (overflowing(16, 1e6, 60000), "us"),
    "32 bits us": (overflowing(32, 1e6, 2**32 - 5_000_000), "us"),
    "16 bits signed": ([str((round(t * 1e3) + 60000) % 65536 - 32768) for t in T_S], "ms"),
    "face of a minute": ([f"{(t + 50.0) % 60.0:.3f}" for t in T_S], "s"),
}


@pytest.mark.parametrize("kind", CLOCKS)
def test_clocks_are_repaired_and_said(kind: str, tmp_path: Path) -> None:
    times, unit = CLOCKS[kind]
    conversion = converted(tmp_path, lines(times), unit)
    (flight,) = conversion.flights
    assert (len(flight), conversion.unexplained_rows) == (N, 0)
    assert actions(conversion) == {"retimed"}
    assert 1.0 / flight.step_s == pytest.approx(RATE_Hz, rel=1e-3)
    assert worst_error(conversion) < 0.05


TEXTS: Final = {
    "thousands": ([f'"{1e3 * t + 500.0:,.1f}"' for t in T_S], "ms"),
    "label": ([f"t={t:.3f}" for t in T_S], "s"),
    "unit": ([f"{1e3 * t:.1f} ms" for t in T_S], "ms"),
    "date": (
        [f"02/01/2026 23:59:{50 + t:06.3f}" if t < 10 else f"03/01/2026 00:00:{t - 10:06.3f}" for t in T_S],
        "s",
    ),
    "compact date": (
        [f"20260102_2359{50 + t:06.3f}" if t < 10 else f"20260103_0000{t - 10:06.3f}" for t in T_S],
        "s",
    ),
    "milliseconds without zeros": ([f"03:04:{int(t):02d}.{round(1e3 * t) % 1000}" for t in T_S], "s"),
    "milliseconds without zeros, dated": (
        [f"2026-05-06 03:04:{int(t):02d}.{round(1e3 * t) % 1000}" for t in T_S],
        "s",
    ),
    "microseconds without zeros": ([f"{7 + int(t)}.{round(1e6 * t) % 1000000}" for t in T_S], "s"),
    "no zeros at the end": (
        [f"03:04:{int(t):02d}.{f'{round(1e3 * t) % 1000:03d}'.rstrip('0') or '0'}" for t in T_S],
        "s",
    ),
    "durations": ([f"0 days 00:00:{t:09.6f}" for t in T_S], "s"),
    "month in letters": ([f"06-May-2024 10:02:{t:06.3f}" for t in T_S], "s"),
    "Monat": ([f"06-Mär-2024 10:02:{t:06.3f}" for t in T_S], "s"),
    "letters": ([f"0h00m{t:06.3f}s" for t in T_S], "s"),
    "brackets": ([f"[2026-01-02 03:04:{t:06.3f}]" for t in T_S], "s"),
    "noon": ([f"11:59:{50 + t:06.3f} AM" if t < 10 else f"12:00:{t - 10:06.3f} PM" for t in T_S], "s"),
    "midnight": ([f"11:59:{50 + t:06.3f} PM" if t < 10 else f"12:00:{t - 10:06.3f} AM" for t in T_S], "s"),
    "colons": ([f"03:04:{int(t):02d}:{round(1e3 * t) % 1000:03d}" for t in T_S], "s"),
}


@pytest.mark.parametrize("kind", TEXTS)
def test_times_are_read_as_programs_write_them(kind: str, tmp_path: Path) -> None:
    times, unit = TEXTS[kind]
    conversion = converted(tmp_path, lines(times), unit)
    assert [len(flight) for flight in conversion.flights] == [N]
    assert worst_error(conversion) < 0.05
    assert actions(conversion) == ({"retimed"} if "without zeros" in kind else set())


@pytest.mark.parametrize("back_s", [0.3, 0.305, 7.5])
def test_a_clock_that_is_set_back_begins_another_flight(back_s: float, tmp_path: Path) -> None:
    times = T_S - back_s * (np.arange(N) >= 800)
    conversion = converted(tmp_path, lines(times))
    assert [len(flight) for flight in conversion.flights] == [800, 700]
    assert "falls from" in conversion.flights[1].meta["cut"]


def test_values_that_a_failed_link_repeats_are_left_out(tmp_path: Path) -> None:
    rows = np.arange(N)
    rows[400:700] = 400
    conversion = converted(tmp_path, lines(T_S, VALUES[rows]))
    assert [len(flight) for flight in conversion.flights] == [401, 800]
    (change,) = conversion.changes
    assert (change.action, change.rows) == ("left out", 299)
    assert "stand still although the motors work (4.000 to 6.990 s)" in change.reason


def test_values_that_a_failed_link_repeats_while_the_clock_starts_again_are_left_out(tmp_path: Path) -> None:
    values = VALUES.copy()
    values[400:700, 2:] = values[400, 2:]
    times = np.where(np.arange(N) < 600, T_S, T_S - T_S[600])
    conversion = converted(tmp_path, lines(times, values))
    assert [len(flight) for flight in conversion.flights] == [401, 800]
    assert "falls from 4.000 to 1.000 s" in conversion.flights[1].meta["cut"]


def test_angles_alone_that_stand_still_are_left_out(tmp_path: Path) -> None:
    values = VALUES.copy()
    values[400:700, 2:] = values[400, 2:]
    conversion = converted(tmp_path, lines(T_S, values))
    assert [len(flight) for flight in conversion.flights] == [401, 800]


@pytest.mark.parametrize("step", [1, 5], ids=["100 Hz", "20 Hz"])
# 300 rows later, pitch has swung back to where it stood, and does not jump.
@pytest.mark.parametrize(
    ("angles", "still"), [(slice(3, 5), 300), (slice(3, 4), 220)], ids=["two angles", "pitch"]
)
def test_angles_that_stand_still_while_the_others_go_on_are_left_out(
    tmp_path: Path, step: int, angles: slice, still: int
) -> None:
    values = VALUES.copy()
    values[400 : 400 + still, angles] = values[400, angles]
    conversion = converted(tmp_path, lines(T_S[::step], values[::step]))
    (change,) = conversion.changes
    assert change.rows == (still - step) / step
    assert "stand still" in change.reason


def test_values_without_their_sign_are_left_out(tmp_path: Path) -> None:
    values = VALUES.copy()
    damaged_rows = np.flatnonzero(np.isin(np.arange(N) % 90, (40, 71)) & (VALUES[:, 2] < -2.0))
    values[damaged_rows, 2] *= -1.0
    (left_out, filled) = converted(tmp_path, lines(T_S, values)).changes
    assert (left_out.rows, filled.action) == (damaged_rows.size, "filled")
    assert "'elevation [deg]' that jumps and returns" in left_out.reason


@pytest.mark.parametrize(("rows", "left_out"), [(1, 1), (2, 2), (3, 0), (6, 0)])
def test_a_pulse_of_large_voltages_is_no_damage_from_three_rows(
    tmp_path: Path, rows: int, left_out: int
) -> None:
    values = VALUES.copy()
    values[400 : 400 + rows, 0] = 60.0 + np.arange(rows)
    changes = converted(tmp_path, lines(T_S, values)).changes
    assert sum(change.rows for change in changes if "front [V]" in change.reason) == left_out


def test_angles_that_stand_still_near_the_lowest_elevation_are_left_out(tmp_path: Path) -> None:
    values = VALUES.copy()
    lowest = int(np.argmin(values[:, 2]))
    values[lowest : lowest + 150, 2:] = values[lowest, 2:]
    (change,) = converted(tmp_path, lines(T_S, values)).changes
    assert (change.action, change.rows) == ("left out", 149)


@pytest.mark.parametrize("kind", ["32 bits us", "face of a minute"])
def test_lines_with_an_unreadable_cell_leave_the_clock_alone(kind: str, tmp_path: Path) -> None:
    times, unit = CLOCKS[kind]
    rows = lines(times)
    for row in range(700, 300, -100):
        # A damaged line of another moment.
        rows.insert(row, rows[row + 400].rsplit(",", 1)[0] + ",ERR")
    conversion = converted(tmp_path, rows, unit)
    (flight,) = conversion.flights
    assert (len(flight), conversion.unexplained_rows) == (N, 0)
    assert "without a number in 'travel [deg]' (first: row 401)" in conversion.changes[0].reason
    assert worst_error(conversion) < 0.05


def test_a_coarse_clock_hides_the_place_of_missing_rows(tmp_path: Path) -> None:
    tenths = np.floor(10.0 * T_S) / 10.0
    kept = np.ones(N, bool)
    kept[503:506] = False
    rows = (np.arange(N), np.flatnonzero(kept))
    tables = [Table("a", {"t": Column(tenths[row]), "x": Column(TRAVEL_DEG[row])}) for row in rows]
    assert [timed_rows(table, "t", "s").uncertain_s for table in tables] == [0.0, pytest.approx(0.03)]


@pytest.mark.parametrize("resumes_s", [0.0, 1.2], ids=["time lost", "right time"])
def test_rows_of_a_clock_that_stands_still_are_counted_on(resumes_s: float) -> None:
    times_s = T_S.copy()
    times_s[600:720] = times_s[600]
    times_s[720:] -= 1.2 - resumes_s
    table = Table("x.csv", {"t": Column(times_s), "travel": Column(TRAVEL_DEG)})
    timed = timed_rows(table, "t", "s")
    assert timed.t_s == pytest.approx(T_S, abs=0.011)
    assert timed.uncertain_s == pytest.approx(1.2 - resumes_s, abs=0.02)
    assert ("stood still: 121 rows at 6 s" in timed.table.changes[0].reason) == (resumes_s == 0.0)


@pytest.mark.parametrize("length", [1, 2, 7])
def test_rows_that_a_coarse_clock_repeats_are_left_out(length: int, tmp_path: Path) -> None:
    made = lines(np.floor(T_S * 5.0) / 5.0)
    made[703 + length : 703 + length] = made[703 : 703 + length]
    conversion = converted(tmp_path, made)
    assert [len(flight) for flight in conversion.flights] == [N]
    assert actions(conversion) == {"left out", "retimed"}
    assert worst_error(conversion) < 0.05


@pytest.mark.parametrize("angles", [slice(2, 5), slice(4, 5)], ids=["all angles", "travel"])
@pytest.mark.parametrize("stop", [700, N], ids=["returns", "for good"])
@pytest.mark.parametrize("reports", ["zero", "the last value"])
def test_values_of_a_plug_that_falls_off_are_left_out(
    reports: str, stop: int, angles: slice, tmp_path: Path
) -> None:
    values = VALUES.copy()
    values[400:stop, angles] = 0.0 if reports == "zero" else values[400, angles]
    conversion = converted(tmp_path, lines(T_S, values))
    (change,) = conversion.changes
    assert change.rows == stop - 400 - (reports != "zero")
    assert "stand still" in change.reason
    assert worst_error(conversion) < 0.01


def test_a_link_that_reports_zeros_in_all_columns_is_left_out(tmp_path: Path) -> None:
    values = VALUES.copy()
    values[400:490] = 0.0
    (change,) = converted(tmp_path, lines(T_S, values)).changes
    assert (change.action, change.rows) == ("left out", 90)


def test_a_link_that_freezes_is_left_out_although_no_angle_jumps(tmp_path: Path) -> None:
    values = VALUES.copy()
    # The arm turns slowly, and jumps by no more than at other times.
    values[:, 2:] = (
        values[0, 2:] + 0.05 * (values[:, 2:] - values[0, 2:]) + np.linspace(0.0, 20.0, N)[:, None]
    )
    values[400:550] = values[400]
    values[550:, 2:] += values[400, 2:] - values[550, 2:]
    (change,) = converted(tmp_path, lines(T_S, values)).changes
    assert (change.action, change.rows) == ("left out", 149)
    settled = values.copy()
    settled[380:400, :2] = values[400, :2]
    assert actions(converted(tmp_path, lines(T_S, settled))) == set()


@pytest.fixture(scope="module")
def calm_hover(tmp_path_factory: pytest.TempPathFactory) -> Flight:
    log = tmp_path_factory.mktemp("hover") / "hover.mcap"
    plan = Plan.parse('title = "x"\n[[segment]]\nkind = "hold"\nduration_s = 20\n', "hover")
    with heli_host.connect("sil://?speed=max") as heli:
        heli.fly(plan, log=log)
    return read_flight(log)


@pytest.mark.medium
@pytest.mark.parametrize("thinned", [1, 5, 20])
def test_a_calm_hover_whose_counts_and_duties_stay_the_same_for_seconds_is_no_failed_link(
    thinned: int, calm_hover: Flight, tmp_path: Path
) -> None:
    flight = calm_hover
    values = np.column_stack((flight.voltages_V, np.degrees(flight.angles_rad)))[::thinned]
    conversion = converted(tmp_path, lines(flight.t_s[::thinned], values))
    assert not conversion.changes
    assert [len(part) for part in conversion.flights] == [len(values)]


def test_a_rest_after_the_jump_of_a_failed_link_is_none_of_it(tmp_path: Path) -> None:
    values = VALUES.copy()
    values[400:640, 4] = values[400, 4]
    # Elevation and travel happen to rest for 0.4 s when the link works again.
    for angle in (2, 4):
        values[640:680, angle] = values[640, angle]
        values[680:, angle] += values[640, angle] - values[680, angle]
    (change,) = converted(tmp_path, lines(T_S, values)).changes
    assert "(4.000 to 6.390 s)" in change.reason


def test_zeros_of_a_plug_that_falls_off_before_the_end_are_left_out(tmp_path: Path) -> None:
    values = VALUES[:440].copy()
    values[400:, 2:] = 0.0
    (change,) = converted(tmp_path, lines(T_S[:440], values)).changes
    assert change.rows == 40


def test_an_arm_that_rests_after_a_gap_or_next_to_a_failed_link_is_no_failed_link(tmp_path: Path) -> None:
    # Travel rests from row 600 to 680: a gap of 2 s ends there, or all angles read 0 until then.
    values = VALUES.copy()
    values[600:, 4] = values[np.maximum(np.arange(600, N) - 80, 600), 4]
    after_gap = np.delete(np.arange(N), slice(400, 600))
    assert not converted(tmp_path, lines(T_S[after_gap], values[after_gap])).changes
    values[400:600, 2:] = 0.0
    (change,) = converted(tmp_path, lines(T_S, values)).changes
    assert change.rows == 200


def test_one_damaged_value_of_an_angle_that_hardly_moves_is_a_spike() -> None:
    values: Floats = np.round(0.003 * np.arange(1500.0))
    values[700] = 1e6
    assert np.flatnonzero(spikes(values)).tolist() == [700]


def test_the_number_that_a_program_writes_instead_of_a_value_is_no_value_near_it() -> None:
    values = VALUES[:, 2].copy()
    without_reading = np.sort(np.concatenate((np.arange(20, N, 61), np.arange(21, N, 305))))
    values[without_reading] = -1.0
    is_spike = spikes(values)
    assert set(np.flatnonzero(is_spike)) <= set(without_reading)
    # Between its neighbours, the number is as near to the value as they are.
    assert np.abs(values - VALUES[:, 2])[~is_spike].max() < 0.1


def test_damaged_lines_leave_the_times_of_a_given_rate_alone(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(
        "\n".join(
            line.partition(",")[2][: -30 if row == 400 else None].replace("." if row == 800 else "x", "?")
            + ("\nbrownout" if row == 600 else "")
            for row, line in enumerate([HEADER, *lines(T_S)])
        )
    )
    stated = replace(profile(), time="", rate_Hz=RATE_Hz)
    conversion = convert(read_table(tmp_path / "a.csv"), stated)
    assert worst_error(conversion) < 0.02
    (flight,) = conversion.flights
    assert flight.t_s[-1] == pytest.approx(T_S[-1])


def test_an_arm_that_rests_on_its_table_is_no_failed_link(tmp_path: Path) -> None:
    flown_s = np.clip(T_S - 3.0, 0.0, None)
    volts = np.where(T_S < 3.0, 1.0, 7.0 + np.sin(5.0 * T_S))
    elevation_deg = -27.0 + 13.5 * (1.0 - np.cos(np.pi * np.clip(flown_s / 6.0, 0.0, 1.0)))
    values = np.column_stack((volts, volts, elevation_deg, 6.0 * np.sin(2.1 * flown_s), 12.0 * flown_s))
    conversion = converted(tmp_path, lines(T_S, values))
    assert not conversion.changes


def test_a_time_that_never_changes_is_refused_with_its_value(tmp_path: Path) -> None:
    with pytest.raises(FlightDataError, match=r"the time 'time \[s\]' is 3 in all 1500 rows"):
        converted(tmp_path, lines(np.full(N, 3.0)))


def test_a_time_with_few_numbers_is_refused_with_the_first_row_without_one(tmp_path: Path) -> None:
    times = [f"{t:.3f}" if row % 3 == 0 else "" for row, t in enumerate(T_S)]
    with pytest.raises(FlightDataError, match=r"a number in only 500 of 1500 rows .*row 2\)"):
        converted(tmp_path, lines(times))


FAULTS: Final = ("lose", "double", "swap", "cut", "blank", "digit", "merge")


@pytest.mark.medium
@settings(max_examples=60, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(
    st.lists(st.tuples(st.sampled_from(FAULTS), st.integers(5, N - 10)), min_size=1, max_size=25),
    st.sampled_from([("%.4f", 1.0), ("%.1f", 1.0), ("%.4g", 1.0)]),
)
def test_every_row_is_kept_or_reported(
    tmp_path_factory: pytest.TempPathFactory, faults: list[tuple[str, int]], clock: tuple[str, float]
) -> None:
    rows = lines([clock[0] % t for t in T_S])
    for kind, place in faults:
        row = min(place, len(rows) - 2)
        cells = rows[row].split(",")
        if kind == "lose":
            del rows[row]
        elif kind == "double":
            rows.insert(row, rows[row])
        elif kind == "swap":
            rows[row], rows[row + 1] = rows[row + 1], rows[row]
        elif kind == "cut":
            rows[row] = rows[row][: 1 + place % 30]
        elif kind == "blank":
            cells[place % len(cells)] = ""
            rows[row] = ",".join(cells)
        elif kind == "digit":
            at = place % len(rows[row])
            rows[row] = rows[row][:at] + rows[row][at + 1 :] if rows[row][at] != "," else rows[row]
        else:
            rows[row] += rows.pop(row + 1)
    try:
        conversion = converted(tmp_path_factory.mktemp("rows"), rows)
    except FlightDataError as error:
        assert "time" in str(error) or "row" in str(error)
        return
    assert conversion.file_rows == len(rows)
    assert conversion.unexplained_rows == 0
    assert all(change.rows or change.action == "resampled" for change in conversion.changes)
    kept = sum(len(flight) for flight in conversion.flights)
    assert kept >= N - 12 * len(faults) - 30


@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_blank_cells_keep_their_columns(separator: str, tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    # The first row is blank in most of its cells.
    rows = [
        [f"{t:.2f}", f"{np.sin(t):.4f}", *([f"{t:.3f}" if i % 4 == 3 else ""] * 5), "7.5"]
        for i, t in enumerate(T_S)
    ]
    header = ["t", "x", "slow", *"abcd", "y"]
    path.write_text("\n".join(separator.join(row) for row in [header, *rows]) + "\n")
    table = read_table(path)
    assert not table.changes
    assert np.isfinite(table.columns["slow"].values).sum() == N // 4
    assert (table.columns["y"].values == 7.5).all()


@pytest.mark.parametrize("decimal", [".", ","])
def test_a_repeated_header_does_not_change_the_numbers(decimal: str, tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    rows = [
        f"{t:.3f}\t{30.7617 * np.sin(t):.4f}\t{1000 + i}".replace(".", decimal) for i, t in enumerate(T_S)
    ]
    path.write_text("\n".join(["t\tx\tn", *rows[:700], "t\tx\tn", *rows[700:]]) + "\n")
    columns = read_table(path).columns
    known = np.isfinite(columns["t"].values)
    assert known.sum() == N
    assert columns["t"].values[known] == pytest.approx(T_S, abs=1e-9)
    assert columns["x"].values[known] == pytest.approx(30.7617 * np.sin(T_S), abs=1e-4)
    assert columns["n"].values[known] == pytest.approx(1000 + np.arange(N))


def test_a_number_far_beyond_all_others_is_no_value_for_as_long_as_it_lasts(tmp_path: Path) -> None:
    values = VALUES.copy()
    rows = [*range(300, 303), 700, *range(900, 904)]
    values[rows, 0] = -1e30
    values[rows, 3] = 9999.0
    flown = converted(tmp_path, lines(T_S, values))
    assert worst_error(flown) < 0.01
    (change,) = (each for each in flown.changes if each.action == "left out")
    assert change.rows == len(rows)
    # A motor that is off before a flight is at the end of the range, and not beyond it.
    assert not substitutes(np.where(T_S < 2.0, 0.0, VALUES[:, 0])).any()


def test_steps_that_are_smaller_than_a_count_make_no_count_a_jump(tmp_path: Path) -> None:
    count = 360.0 / 4096.0
    values = np.column_stack((VALUES[:, :2], count * np.round(VALUES[:, 2:] / count)))
    # Travel stands still, as with friction, and goes on by single counts; later, rows were filled in.
    values[:600, 4] = values[600, 4]
    values[900:, 4] = TRAVEL_DEG[900:]
    assert not [change for change in converted(tmp_path, lines(T_S, values)).changes if change.rows > 1]
