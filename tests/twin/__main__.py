"""Fly healthy and changed rigs with their twins: ``python -m tests.twin``; goes on where it was stopped.

Writes twin.json after each rig, and prints the tables of docs/validation/twin.md.
"""

from __future__ import annotations

import argparse
import json
import math
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from heli_host.flight import Flight
from heli_lab.twin.calibration import Calibration
from heli_lab.twin.draws import NO_ALARM
from heli_lab.twin.flights import count_rad_of, samples_of
from heli_lab.twin.monitor import monitor_flight
from heli_lab.twin.tail import IDEAL, Tail, segment_maxima
from heli_lab.twin.twin import Twin
from heli_lab.twin.twin_model import TwinModel
from heli_sim.model.multibody import MultibodyModel
from scipy.stats import binom

from tests.twin.changes import SIZES, ONSET_s, change
from tests.twin.rigs import Known, flights, known

HOURS = 10.0
SEEN_s = 14.0
"""Time from a missed change until its evidence is read, s: just less than the twin's window."""


def main() -> None:
    """Read options, run what is missing, print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rigs", type=int, default=20)
    parser.add_argument("--first-rig", type=int, default=1, help="seed of the first rig")
    parser.add_argument(
        "--healthy", type=int, default=10, help="flights of each rig in which nothing changes"
    )
    parser.add_argument("--seconds", type=float, default=60.0, help="in the air, of each of those flights")
    parser.add_argument("--changed", type=int, default=5, help="flights of each change and size")
    parser.add_argument("--middle-sizes", action="store_true", help="only the middle size of each change")
    parser.add_argument("--drawn", type=int, default=12, help="minutes of evidence that set each alarm")
    parser.add_argument("--out", type=Path, default=Path("twin.json"))
    parser.add_argument("--read", action="store_true", help="only print what the file holds")
    options = parser.parse_args()
    results: dict[str, Any] = json.loads(options.out.read_text()) if options.out.exists() else {}
    if not options.read:
        fly_missing(options, results)
    print("\n".join(healthy_table(results)))
    print("\n".join(changed_table(results)))


def fly_missing(options: argparse.Namespace, results: dict[str, Any]) -> None:
    """Fly all rigs healthy, then each change and size, again and again on other rigs; write what comes."""
    seeds = range(options.first_rig, options.first_rig + options.rigs)
    rig_of = cache(partial(known, drawn=options.drawn))

    def keep(text: str) -> None:
        options.out.write_text(json.dumps(results, indent=1))
        print(text, flush=True)

    for seed in seeds:
        if str(seed) not in results:
            results[str(seed)] = of_healthy(rig_of(seed), options.healthy, options.seconds)
            keep(f"rig {seed} flown healthy")
    cases = [
        (name, size)
        for name, sizes in SIZES.items()
        for size in (sizes[1:2] if options.middle_sizes else sizes)
    ]
    for repeat in range(options.changed):
        for number, (name, size) in enumerate(cases):
            # Each change and size flies on different rigs.
            seed = seeds[(number + repeat * max(1, options.rigs // options.changed)) % options.rigs]
            done = results[str(seed)]["changed"]
            if not any(entry["number"] == [repeat, number] for entry in done):
                flown = 2_000 + 20 * number + repeat
                done.append(of_changed(rig_of(seed), name, size, flown) | {"number": [repeat, number]})
                keep(f"rig {seed} flown with {name} of {size:g}")


def of_healthy(rig: Known, count: int, seconds: float = 60.0) -> dict[str, Any]:
    """Fly one rig so many times, so many `seconds` each, with nothing changed."""
    tail = rig.twin.calibration.tail
    results: dict[str, Any] = {
        "tail": [
            tail.level_nats,
            tail.per_hour,
            tail.scale_nats,
            tail.excesses,
            tail.shape,
            tail.healthy_s,
        ],
        "healthy": [],
        "changed": [],
    }
    for flight in flights(rig.model, rig.rig, 10_000 * rig.seed + 1_000, count, seconds):
        seen = monitor_flight(rig.twin, flight, "healthy", HOURS)
        results["healthy"].append(
            {
                "max_evidence_nats": seen.max_evidence_nats,
                "free_s": seen.free_s,
                "alarms": len(seen.alarms),
                "glitches": sum(event.kind == "glitch" for event in seen.events),
                "maxima": [round(maximum_nats, 2) for maximum_nats in segment_maxima(seen.evidence_nats)],
            }
        )
    return results


def of_changed(rig: Known, name: str, size: float, seed: int) -> dict[str, Any]:
    """Fly one rig with a change of its own `seed`."""
    model = MultibodyModel((*rig.model.effects, change(name, size)))
    (flight,) = flights(model, rig.rig, 10_000 * rig.seed + seed, 1)
    seen = monitor_flight(rig.twin, flight, name, HOURS)
    onset_s = motors_on_s(flight) + ONSET_s
    early = [event for event in seen.events if event.kind == "alarm" and event.t_s < onset_s]
    late = [event for event in seen.events if event.kind == "alarm" and event.t_s >= onset_s]
    words = [event for event in seen.alarms if event.t_s >= onset_s]
    entry: dict[str, Any] = {"change": name, "size": size, "early": len(early), "delay_s": None}
    if not (late and words):
        return entry | {"sigmas": sigmas(rig, flight, name, size, onset_s)}
    first = words[0].ranking[0]
    return entry | {
        "delay_s": late[0].t_s - onset_s,
        "first_name": late[0].ranking[0].change.id,
        "name": first.change.id,
        "said": first.size,
        "std": first.std,
        "ranking": [
            [candidate.change.id, round(candidate.log_evidence, 1)] for candidate in words[0].ranking[:4]
        ],
    }


def sigmas(rig: Known, flight: Flight, name: str, size: float, onset_s: float) -> float:
    """Size of a change in standard errors, if its kind and moment are known, after `SEEN_s`."""
    samples, sample_s = samples_of(flight)
    never = Calibration(rig.twin.calibration.disturbances, NO_ALARM)
    model = TwinModel(rig.twin.model, rig.twin.rig, rig.twin.calibration.uncertainty)
    twin = Twin(model, never, count_rad_of(flight, rig.rig), sample_s)
    zero = round(float(samples.number[0]) - float(flight.t_s[0]) / sample_s)
    rows = (samples.number - zero) * sample_s < onset_s + SEEN_s
    twin.update(samples.select(rows))
    std = twin.standard_error(name, onset_s + zero * sample_s)
    return size / std if std is not None else 0.0


def motors_on_s(flight: Flight) -> float:
    """When the motors first turned."""
    return float(flight.t_s[np.flatnonzero(np.abs(flight.voltages_V).max(axis=1) > 0)[0]])


def healthy_table(results: dict[str, Any]) -> list[str]:
    """Alarms in healthy flights against what was stated."""
    flown = [entry for rig in results.values() for entry in rig["healthy"]]
    hours = sum(entry["free_s"] for entry in flown) / 3600.0
    glitches = sum(entry.get("glitches", 0) for entry in flown)
    lines = [
        f"{len(flown)} healthy flights of {len(results)} rigs, {hours:.2f} h free; "
        f"{glitches} jumps of encoders reported"
    ]
    for stated in (HOURS, 1.0, 0.2):
        expected = alarms = 0.0
        chance = []
        for rig in results.values():
            threshold = max(tail.threshold_nats(stated) for tail in (Tail(*rig["tail"]), IDEAL))
            for entry in rig["healthy"]:
                chance.append(1.0 - math.exp(-entry["free_s"] / 3600.0 / stated))
                expected += chance[-1]
                alarms += entry["max_evidence_nats"] > threshold
        mean = float(np.mean(chance)) if chance else 0.0
        p = float(binom.sf(alarms - 1, len(chance), mean)) if chance else 1.0
        lines.append(
            f"stated once in {stated:g} h: {alarms:.0f} flights with an alarm, {expected:.1f} expected, "
            f"p of so many or more {p:.2f}"
        )
    return lines


def changed_table(results: dict[str, Any]) -> list[str]:
    """Found, delay and name for each change and size, and how strongly those showed that were not found."""
    flown = [entry for rig in results.values() for entry in rig["changed"]]
    lines = ["| change | size | found | delay, s | named first | missed |", "|---|---|---|---|---|---|"]
    right = total = 0
    for name, sizes in SIZES.items():
        for size in sizes:
            here = [entry for entry in flown if entry["change"] == name and entry["size"] == size]
            if not here:
                continue
            detected = [entry for entry in here if entry["delay_s"] is not None]
            missed = [entry["sigmas"] for entry in here if entry["delay_s"] is None]
            named = [entry for entry in detected if entry["name"] == name]
            right, total = right + len(named), total + len(detected)
            delay = f"{np.median([entry['delay_s'] for entry in detected]):.1f}" if detected else ""
            share = f"{len(named)} of {len(detected)}" if detected else ""
            shown = ", ".join(f"{sigma:.1f}" for sigma in sorted(missed))
            lines.append(
                f"| `{name}` | {size:g} | {len(detected)} of {len(here)} | {delay} | {share} | {shown} |"
            )
    early = sum(entry["early"] for entry in flown)
    lines.append(
        f"named first {right} of {total} found; {early} alarms before the change; missed: how many standard "
        f"errors the change was {SEEN_s:g} s after it, if its kind and moment are known"
    )
    return lines


if __name__ == "__main__":
    main()
