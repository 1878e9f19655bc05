"""The logger zoo: its comparison notices each mistake of an import, and cases are what their truth says."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from heli_host.data.arrays import Floats
from heli_host.data.flight import Flight
from heli_host.data.tables import read_table
from heli_host.declaration import AXES

from heli_benchmark.zoo.case import ImportTruth, Samples
from heli_benchmark.zoo.compare import ImportedFlight, mistakes, row_difference
from heli_benchmark.zoo.containers import write_log
from heli_benchmark.zoo.draw import draw_case
from heli_benchmark.zoo.flights import RECIPES
from heli_benchmark.zoo.words import MOTORS

STEP_S = 0.02


def made_flight(step_s: float = STEP_S) -> Flight:
    """A motion with several frequencies, whose voltages change from row to row."""
    t_s = step_s * np.arange(round(40.0 / step_s), dtype=np.float64)
    wave = [
        np.sin(2.0 * np.pi * (t_s / period + phase))
        for period, phase in ((7.1, 0.0), (2.9, 0.2), (11.3, 0.5))
    ]
    noise = np.random.default_rng(1).standard_normal((2, t_s.size))
    front = 1.8 + 0.3 * wave[1] + 0.1 * noise[0]
    back = 1.6 - 0.3 * wave[1] + 0.1 * noise[1]
    return Flight(t_s, front, back, 0.15 * wave[0] - 0.1, 0.2 * wave[1], 0.6 * wave[2] + 0.05 * t_s)


def truth_of(flight: Flight) -> ImportTruth:
    samples = {axis: Samples(flight.t_s, getattr(flight, f"{axis}_rad")) for axis in AXES}
    samples |= {motor: Samples(flight.t_s, getattr(flight, f"{motor}_V")) for motor in MOTORS}
    return ImportTruth(samples, len(flight), 0.004 + 0.6 * STEP_S, dict.fromkeys((*AXES, *MOTORS), 1e-3))


def imported_of(flight: Flight) -> ImportedFlight:
    columns = {axis: getattr(flight, f"{axis}_rad") for axis in AXES}
    columns |= {motor: getattr(flight, f"{motor}_V") for motor in MOTORS}
    return ImportedFlight(flight.t_s + 3.0, columns)


def changed(name: str, change: Callable[[Floats], Floats]) -> Callable[[ImportedFlight], ImportedFlight]:
    return lambda imported: replace(
        imported, columns={**imported.columns, name: change(imported.columns[name].copy())}
    )


def with_spike(values: Floats) -> Floats:
    values[702] += 0.12
    return values


def late(values: Floats) -> Floats:
    return np.roll(values, 6)


def cut(imported: ImportedFlight) -> ImportedFlight:
    return ImportedFlight(
        imported.t_s[:1500], {name: values[:1500] for name, values in imported.columns.items()}
    )


def exchanged(imported: ImportedFlight) -> ImportedFlight:
    columns = dict(imported.columns)
    columns["front"], columns["back"] = columns["back"], columns["front"]
    return replace(imported, columns=columns)


@pytest.mark.parametrize(
    ("change", "mistake"),
    [
        (changed("elevation", lambda values: -values), "elevation: opposite sign"),
        (changed("pitch", lambda values: 1.1 * values), "pitch: scale 1.1"),
        (changed("travel", lambda values: values[::-1].copy()), "travel: "),
        (changed("elevation", lambda values: values + 0.1), "elevation: zero differs by 5.7 deg"),
        (changed("pitch", with_spike), "pitch: a row differs by 6.9 deg"),
        (changed("pitch", late), "pitch: values differ"),
        (changed("front", lambda values: 0.9 * values), "front: scale 0.9"),
        (changed("back", late), "back: late by 0.1"),
        (exchanged, "mirror: front and back are exchanged"),
        (cut, "rows: 10.0 of 40.0 s are not imported"),
        (lambda imported: replace(imported, t_s=1.1 * imported.t_s), "clock: 44.0 s instead of 40.0 s"),
    ],
)
def test_each_mistake_is_noticed(change: Callable[[ImportedFlight], ImportedFlight], mistake: str) -> None:
    flight = made_flight()
    noticed = mistakes([change(imported_of(flight))], truth_of(flight))
    assert any(item.startswith(mistake) for item in noticed), noticed


def test_a_right_import_has_no_mistake_and_its_clock_may_begin_anywhere() -> None:
    flight = made_flight()
    imported = imported_of(flight)
    assert mistakes([imported], truth_of(flight)) == []
    halves = [
        ImportedFlight(
            imported.t_s[part] - imported.t_s[part][0], {k: v[part] for k, v in imported.columns.items()}
        )
        for part in (slice(0, 900), slice(900, None))
    ]
    assert mistakes(halves, truth_of(flight)) == []
    assert row_difference(halves, truth_of(flight)) == 0


@pytest.mark.parametrize("late_rows", [0, 2])
def test_voltages_of_a_slow_quantised_part_are_late_only_if_they_were_moved(late_rows: int) -> None:
    exact = made_flight(0.01)
    counts = {f"{axis}_rad": 0.003 * np.round(getattr(exact, f"{axis}_rad") / 0.003) for axis in AXES}
    flight = replace(exact, **counts)
    part = imported_of(flight)
    columns = {name: values[2850:].copy() for name, values in part.columns.items()}
    for motor in MOTORS:
        columns[motor] = np.roll(columns[motor], late_rows)
    truth = replace(truth_of(flight), lost_s=28.5, time_tolerance_s=0.01)
    noticed = mistakes([ImportedFlight(part.t_s[2850:], columns)], truth)
    expected = [f"{motor}: late by 0.02 s" for motor in MOTORS] if late_rows else []
    assert noticed == expected


@pytest.mark.slow
def test_a_drawn_case_is_a_file_with_the_rows_of_its_truth(tmp_path: Path) -> None:
    flights = [made_flight(0.002)] * len(RECIPES)
    containers = set()
    for number in range(4):
        case = draw_case(3, number, RECIPES, flights)
        assert draw_case(3, number, RECIPES, flights).traits == case.traits
        containers.add(case.container)
        if not case.row_faults and not case.recording.clock_texts:
            table = read_table(write_log(case, tmp_path / str(number)))
            assert len(table.aligned()) == pytest.approx(case.truth.row_count, abs=2)
    assert len(containers) > 1
