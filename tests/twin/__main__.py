"""Measures false alarms, delays and names of twins on random simulated rigs: ``python -m tests.twin``.

Each rig flies unchanged and with a change. The command prints the tables of docs/validation/twin.md. It
writes its results to a file after each step, and continues from that file after an interruption.
"""

import argparse
import json
import math
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from heli_host.data.flight import Flight
from heli_lab.watch.calibration import DEFAULT_DISTURBANCES, Calibration, Tail, segment_maxima
from heli_lab.watch.learn import NO_ALARM
from heli_lab.watch.monitor import monitor_flight
from heli_lab.watch.steps import count_rad_of, samples_of
from heli_lab.watch.twin import Twin
from heli_lab.watch.twin_model import TwinModel
from heli_sim.model.multibody import MultibodyModel
from scipy.stats import binom

from tests.twin.rigs import SIZES, ONSET_s, RigWithTwin, change, random_flights, rig_with_twin

Results = dict[str, Any]
"""Content of the result file: for each seed of a rig, the tail of its twin's evidence, and its flights."""

FALSE_ALARM_INTERVAL_h = 10.0
"""Mean time between two false alarms for which the alarm threshold is set [h]."""
REPORTED_INTERVALS_h = (FALSE_ALARM_INTERVAL_h, 1.0, 0.2)
"""Mean times between two false alarms for which false alarms are counted [h]."""
READ_AFTER_s = 14.0
"""Time from a missed change until its standard error is computed [s]: just less than the twin's window."""
_FLIGHT_SEEDS_PER_RIG = 10_000
_FIRST_HEALTHY_SEED = 1_000
_FIRST_CHANGED_SEED = 2_000
_SEEDS_PER_CASE = 20


def main() -> None:
    """Read the options, fly the missing flights, and print the tables."""
    parser = argparse.ArgumentParser(prog="python -m tests.twin", description=__doc__)
    parser.add_argument("--rigs", type=int, default=20, help="number of rigs")
    parser.add_argument("--first-rig", type=int, default=1, help="seed of the first rig")
    parser.add_argument("--healthy", type=int, default=10, help="number of unchanged flights of each rig")
    parser.add_argument("--seconds", type=float, default=60.0, help="time in the air of an unchanged flight")
    parser.add_argument("--changed", type=int, default=5, help="number of flights of each change and size")
    parser.add_argument("--middle-sizes", action="store_true", help="only the middle size of each change")
    parser.add_argument("--drawn", type=int, default=12, help="minutes of evidence that a training draws")
    parser.add_argument("--out", type=Path, default=Path("twin.json"), help="result file")
    parser.add_argument("--read", action="store_true", help="only print the tables of the result file")
    options = parser.parse_args()
    results: Results = json.loads(options.out.read_text()) if options.out.exists() else {}
    if not options.read:
        fly_missing(options, results)
    print("\n".join(healthy_lines(results)))
    print("\n".join(changed_table(results)))


def fly_missing(options: argparse.Namespace, results: Results) -> None:
    """Fly all flights that the results do not contain, and save the results after each step."""
    seeds = range(options.first_rig, options.first_rig + options.rigs)
    all_cases = cases_of(seeds, options.changed, middle_sizes=options.middle_sizes)
    trained_rig = cache(partial(rig_with_twin, drawn_minutes=options.drawn))

    def save(text: str) -> None:
        options.out.write_text(json.dumps(results, indent=1))
        print(text, flush=True)

    # Rig after rig, so that the results of an interrupted run are those of some rigs, unchanged and changed.
    for seed in seeds:
        if str(seed) not in results:
            results[str(seed)] = fly_healthy(trained_rig(seed), options.healthy, options.seconds)
            save(f"rig {seed} flown healthy")
        entries = results[str(seed)]["changed"]
        for case in all_cases:
            is_done = any(entry["number"] == [case.repeat, case.number] for entry in entries)
            if case.rig_seed == seed and not is_done:
                entry = fly_changed(trained_rig(seed), case.change, case.size, case.flight_seed)
                entries.append({**entry, "number": [case.repeat, case.number]})
                save(f"rig {seed} flown with {case.change} of {case.size:g}")


@dataclass(frozen=True)
class Case:
    """A flight with a change."""

    change: str  # Id of the change
    size: float  # Its size [SI]
    repeat: int  # Number of flights with the same change and size before this one
    number: int  # Number of the change and size in the list of all cases
    rig_seed: int  # Seed of the rig that flies

    @property
    def flight_seed(self) -> int:
        """Seed of the flight among those of its rig."""
        return _FIRST_CHANGED_SEED + _SEEDS_PER_CASE * self.number + self.repeat


def cases_of(seeds: range, repeats: int, *, middle_sizes: bool) -> list[Case]:
    """Return the flights with changes. The repeats of a change and size fly on different rigs."""
    sized_changes = [
        (name, size) for name, sizes in SIZES.items() for size in (sizes[1:2] if middle_sizes else sizes)
    ]
    rigs_between_repeats = max(1, len(seeds) // repeats) if repeats else 1
    return [
        Case(name, size, repeat, number, seeds[(number + repeat * rigs_between_repeats) % len(seeds)])
        for repeat in range(repeats)
        for number, (name, size) in enumerate(sized_changes)
    ]


def fly_healthy(rig: RigWithTwin, count: int, duration_s: float = 60.0) -> dict[str, Any]:
    """Fly an unchanged rig `count` times, and return the entry of the rig in the results."""
    first_seed = _FLIGHT_SEEDS_PER_RIG * rig.seed + _FIRST_HEALTHY_SEED
    healthy = []
    for flight in random_flights(rig.model, rig.rig, first_seed, count, duration_s):
        report = monitor_flight(rig.twin, flight, "healthy", FALSE_ALARM_INTERVAL_h)
        healthy.append(
            {
                "max_evidence_nats": report.max_evidence_nats,
                "free_s": report.free_s,
                "alarms": len(report.alarms),
                "glitches": sum(event.kind == "glitch" for event in report.events),
                "maxima": [round(maximum_nats, 2) for maximum_nats in segment_maxima(report.evidence_nats)],
            }
        )
    return {"tail": asdict(rig.twin.calibration.tail), "healthy": healthy, "changed": []}


def fly_changed(rig: RigWithTwin, name: str, size: float, flight_seed: int) -> dict[str, Any]:
    """Fly a rig with the change `name` from `ONSET_s` on, and return the entry of the flight in the
    results.
    """
    # The entry has the delay and the name of the first alarm after the change. If there is no such alarm, the
    # entry has the size of the change in standard errors.
    model = MultibodyModel((*rig.model.effects, change(name, size)))
    (flight,) = random_flights(model, rig.rig, _FLIGHT_SEEDS_PER_RIG * rig.seed + flight_seed, 1)
    report = monitor_flight(rig.twin, flight, name, FALSE_ALARM_INTERVAL_h)
    onset_s = motors_on_s(flight) + ONSET_s
    alarms = [event for event in report.events if event.kind == "alarm"]
    late_alarms = [event for event in alarms if event.t_s >= onset_s]
    late_diagnoses = [event for event in report.alarms if event.t_s >= onset_s]
    entry: dict[str, Any] = {
        "change": name,
        "size": size,
        "early": len(alarms) - len(late_alarms),
        "delay_s": None,
    }
    if not (late_alarms and late_diagnoses):
        return {**entry, "sigmas": size_in_standard_errors(rig, flight, name, size, onset_s)}
    ranking = late_diagnoses[0].ranking
    return {
        **entry,
        "delay_s": late_alarms[0].t_s - onset_s,
        "first_name": late_alarms[0].ranking[0].change.id,
        "name": ranking[0].change.id,
        "estimate": ranking[0].size,
        "std": ranking[0].std,
        "ranking": [[candidate.change.id, round(candidate.log_evidence, 1)] for candidate in ranking[:4]],
    }


def size_in_standard_errors(
    rig: RigWithTwin, flight: Flight, name: str, size: float, onset_s: float
) -> float:
    """Return a change divided by the standard error that a twin reaches `READ_AFTER_s` after it."""
    # The twin knows kind and onset of the change, and raises no alarm. Below about 3, only chance detects the
    # change. The result is 0 if the twin does not compare at that time.
    samples, sample_s = samples_of(flight)
    calibration = Calibration(rig.twin.calibration.disturbances, NO_ALARM)
    model = TwinModel(rig.twin.model, rig.twin.rig, rig.twin.calibration.uncertainty)
    twin = Twin(model, calibration, count_rad_of(flight, rig.rig), sample_s)
    # Number of the sample at 0 s of the flight.
    zero_number = round(float(samples.number[0]) - float(flight.t_s[0]) / sample_s)
    is_before_reading = (samples.number - zero_number) * sample_s < onset_s + READ_AFTER_s
    twin.update(samples.select(is_before_reading))
    std = twin.standard_error(name, onset_s + zero_number * sample_s)
    return size / std if std is not None else 0.0


def motors_on_s(flight: Flight) -> float:
    """Return the time at which a motor first gets a voltage [s]."""
    has_voltage = np.abs(flight.voltages_V).max(axis=1) > 0
    return float(flight.t_s[np.flatnonzero(has_voltage)[0]])


def healthy_lines(results: Results) -> list[str]:
    """Compare the number of unchanged flights with a false alarm with the expected number, as text."""
    flights = [entry for rig in results.values() for entry in rig["healthy"]]
    hours = sum(entry["free_s"] for entry in flights) / 3600.0
    glitches = sum(entry.get("glitches", 0) for entry in flights)
    lines = [
        f"{len(flights)} healthy flights of {len(results)} rigs, {hours:.2f} h free; "
        f"{glitches} jumps of encoders reported"
    ]
    for interval_h in REPORTED_INTERVALS_h:
        alarms = 0
        chances = []  # of a false alarm in each flight
        for rig in results.values():
            calibration = Calibration(DEFAULT_DISTURBANCES, Tail(**rig["tail"]))
            threshold_nats = calibration.threshold_nats(interval_h)
            for entry in rig["healthy"]:
                chances.append(1.0 - math.exp(-entry["free_s"] / 3600.0 / interval_h))
                alarms += entry["max_evidence_nats"] > threshold_nats
        mean_chance = float(np.mean(chances)) if chances else 0.0
        probability = float(binom.sf(alarms - 1, len(chances), mean_chance)) if chances else 1.0
        lines.append(
            f"stated once in {interval_h:g} h: {alarms} flights with an alarm, {sum(chances):.1f} expected, "
            f"probability of as many or more {probability:.2f}"
        )
    return lines


def changed_table(results: Results) -> list[str]:
    """Return a table of all flights with a change, one row per change and size, as text."""
    flights = [entry for rig in results.values() for entry in rig["changed"]]

    def flights_of(name: str, size: float) -> list[dict[str, Any]]:
        return [entry for entry in flights if entry["change"] == name and entry["size"] == size]

    rows = [_row(name, size, flights_of(name, size)) for name, sizes in SIZES.items() for size in sizes]
    detected = _selected(flights, lambda entry: entry["delay_s"] is not None)
    named = _selected(detected, lambda entry: entry["name"] == entry["change"])
    early = sum(entry["early"] for entry in flights)
    return [
        "| change | size | detected | delay, s | named first | size when missed |",
        "|---|---|---|---|---|---|",
        *(row for row in rows if row),
        f"detected {len(detected)} of {len(flights)}, named first {len(named)} of {len(detected)}; "
        f"{early} alarms before the change; "
        f"size when missed: in standard errors, {READ_AFTER_s:g} s after the change",
    ]


def _row(name: str, size: float, flights: list[dict[str, Any]]) -> str:
    """Return the row of the flights with a change and size; the empty string if there are none."""
    if not flights:
        return ""
    detected = _selected(flights, lambda entry: entry["delay_s"] is not None)
    named = _selected(detected, lambda entry: entry["name"] == name)
    missed_sizes = sorted(entry["sigmas"] for entry in flights if entry["delay_s"] is None)
    delay = f"{np.median([entry['delay_s'] for entry in detected]):.1f}" if detected else ""
    share_named = f"{len(named)} of {len(detected)}" if detected else ""
    missed = ", ".join(f"{sigmas:.1f}" for sigmas in missed_sizes)
    share_detected = f"{len(detected)} of {len(flights)}"
    return f"| `{name}` | {size:g} | {share_detected} | {delay} | {share_named} | {missed} |"


def _selected(
    flights: list[dict[str, Any]], condition: Callable[[dict[str, Any]], bool]
) -> list[dict[str, Any]]:
    return [entry for entry in flights if condition(entry)]


if __name__ == "__main__":
    main()
