"""Twins of real machines: ``python -m tests.twin.measured``; needs ../shared/data/measured.

The model is found on one flight of a pair, with the effects that docs/validation/measured-flights.md names;
its twin flies beside the other one, as it is, and with its voltages told 5 % too high from a moment on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from heli_host.flight import Flight
from heli_host.log.flight_file import read_flight
from heli_lab.estimation import estimate
from heli_lab.identify.flight_model import RigParameters, filter_record, model_functions
from heli_lab.twin.calibration import Calibration
from heli_lab.twin.files import DEFAULT_CALIBRATION, TwinRig
from heli_lab.twin.flights import count_rad_of
from heli_lab.twin.learn import at_least_rounding
from heli_lab.twin.monitor import TwinReport, monitor_flight
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import parse_effects
from heli_sim.rig import load_rig

from tests.measured.pairs import MEASURED, PAIRS, RIG, FROM_s, LANDS_s, flights

EFFECTS = ("rotor_speed_lag", "gyroscopic_torque", "edgewise_flow")
SCALE = 1.05
MOMENTS = (0.3, 0.4, 0.5, 0.6)
"""Of the free flight, when the voltages begin to be told wrong."""


def twin_of(pair: str, back: bool = False) -> TwinRig:
    """Find numbers and weather on the flight of a pair that teaches."""
    rig = load_rig(RIG)
    record, _ = flights(pair, back)
    model = MultibodyModel(parse_effects(EFFECTS))
    parameter_vector = RigParameters(model, rig, [record])
    found = estimate(
        parameter_vector,
        [filter_record(record)],
        model_functions(model, parameter_vector.quantities),
        parameter_vector.start,
    )
    values = {
        one.quantity: float(value) for one, value in zip(parameter_vector.free, found.theta, strict=True)
    }
    numbers = rig.replace(**{name: value for name, value in values.items() if name in rig})
    effects = tuple(
        replace(effect, values={name: values.get(name, was) for name, was in effect.values.items()})
        for effect in model.effects
    )
    count_rad = count_rad_of(read_flight(MEASURED / f"{PAIRS[pair][1 if back else 0]}.csv.gz"), rig)
    disturbances = at_least_rounding(found.disturbances, model, numbers, count_rad)
    return TwinRig(
        numbers, MultibodyModel(effects), Calibration(disturbances, DEFAULT_CALIBRATION.tail), pair
    )


def other(pair: str, back: bool = False) -> tuple[str, Flight]:
    """The flight of a pair that judges."""
    name = PAIRS[pair][0 if back else 1]
    return name, read_flight(MEASURED / f"{name}.csv.gz")


def beside(twin: TwinRig, name: str, flight: Flight) -> TwinReport:
    """Fly the twin beside the part of a flight that its description calls sound."""
    return monitor_flight(twin, flight, name, 10.0, FROM_s, LANDS_s.get(name))


def told_wrong(flight: Flight, from_s: float) -> Flight:
    """Scale the voltages of a flight from a moment on."""
    factor = np.where(flight.t_s >= from_s, SCALE, 1.0)
    return replace(flight, front_V=flight.front_V * factor, back_V=flight.back_V * factor)


def main() -> None:
    """Print a line a pair and direction."""
    for pair in PAIRS:
        for back in (False, True):
            twin = twin_of(pair, back)
            name, flight = other(pair, back)
            quiet = beside(twin, name, flight)
            print(
                f"{pair}{' back' if back else ''}: most {quiet.max_evidence_nats:.0f} nats; "
                f"{quiet.sentences()[0]}",
                flush=True,
            )
            end_s = LANDS_s.get(name, float(flight.t_s[-1]))
            delays = []
            for share in MOMENTS:
                at_s = FROM_s + share * (end_s - FROM_s)
                seen = beside(twin, name, told_wrong(flight, at_s))
                alarms = [event for event in seen.events if event.kind == "alarm"]
                last = list(seen.alarms)
                delays.append(
                    (round(alarms[0].t_s - at_s, 1), last[0].ranking[0].change.id) if alarms else None
                )
            print(f"  5 % more told from {MOMENTS} of it on: delay and name {delays}", flush=True)


if __name__ == "__main__":
    main()
