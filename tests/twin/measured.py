"""Twins of real machines: ``python -m tests.twin.measured``; needs ../shared/data/measured.

The rig is identified on one flight of a pair, with the effects that docs/validation/measured-flights.md
names. Its twin is trained on the same flight, then watches the other one: as it is, and with a loss of
voltage hidden from the middle on. Both flights of a pair take both parts.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from heli_host.flight import Flight
from heli_host.log.flight_file import read_flight
from heli_lab.estimation import estimate
from heli_lab.identify.flight_model import RigParameters, filter_record, model_functions
from heli_lab.twin.files import DEFAULT_CALIBRATION, TwinRig
from heli_lab.twin.learn import DRAWN_s, learn
from heli_lab.twin.monitor import TwinReport, monitor_flight
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import parse_effects
from heli_sim.rig import load_rig

from tests.field.cases import NO_DATA
from tests.measured.pairs import MEASURED, PAIRS, RIG, FROM_s, LANDS_s, add_pairs, flights

EFFECTS: Final = ("rotor_speed_lag", "gyroscopic_torque", "edgewise_flow")
FALSE_ALARM_INTERVAL_h: Final = 10.0
WITHIN_s: Final = 3.0
"""Required median delay of an alarm, s."""


@dataclass(frozen=True)
class Loss:
    """A hidden loss: the share of each voltage that does not reach its rotor, and the names that are
    right.
    """

    text: str
    front: float
    back: float
    family: frozenset[str]


LOSSES: Final = (
    Loss("supply -5 %", 0.05, 0.05, frozenset({"supply_step", "thrust_fade"})),
    Loss("front -8 %", 0.08, 0.0, frozenset({"thrust_step.front"})),
    Loss("back -8 %", 0.0, 0.08, frozenset({"thrust_step.back"})),
)
"""Thrust of these models is linear in the voltage, so a share of voltage is a share of thrust. A supply that
falls and two rotors that fade are one family: both rotors lose the same share."""


@dataclass(frozen=True)
class Watched:
    """Report of a twin about a flight with a loss.

    Parameters
    ----------
    loss : Loss
        What is hidden.
    early : bool
        Whether an alarm came before the loss.
    delay_s : float or None
        Time from the loss to its alarm [s]; None without an alarm.
    name : str
        Change that the final ranking of that alarm puts first.
    is_judged : bool
        Whether the twin judged at least half of the flight.
    """

    loss: Loss
    early: bool
    delay_s: float | None
    name: str
    is_judged: bool

    @property
    def is_named(self) -> bool:
        """Whether the right family is named."""
        return self.name in self.loss.family


def part(name: str) -> Flight:
    """Read the part of a flight that its description calls sound."""
    flight = read_flight(MEASURED / f"{name}.csv.gz")
    rows = (flight.t_s >= FROM_s) & (flight.t_s < LANDS_s.get(name, np.inf))
    elevation_rad, pitch_rad, travel_rad = flight.angles_rad[rows].T
    front_V, back_V = flight.front_V[rows], flight.back_V[rows]
    return Flight(flight.t_s[rows], front_V, back_V, elevation_rad, pitch_rad, travel_rad, meta=flight.meta)


def identified(pair: str, back: bool = False) -> TwinRig:
    """Identify the rig on the flight of a pair that teaches; the calibration is the usual one."""
    rig = load_rig(RIG)
    record, _ = flights(pair, back)
    model = MultibodyModel(parse_effects(EFFECTS))
    parameter_vector = RigParameters(model, rig, [record])
    functions = model_functions(model, parameter_vector.quantities)
    found = estimate(parameter_vector, [filter_record(record)], functions, parameter_vector.start)
    values = {
        parameter.quantity: float(value)
        for parameter, value in zip(parameter_vector.free, found.theta, strict=True)
    }
    numbers = rig.replace(**{name: value for name, value in values.items() if name in rig})
    effects = tuple(
        replace(effect, values={name: values.get(name, was) for name, was in effect.values.items()})
        for effect in model.effects
    )
    return TwinRig(numbers, MultibodyModel(effects), DEFAULT_CALIBRATION, pair)


def trained(twin: TwinRig, name: str, drawn_s: float = DRAWN_s) -> TwinRig:
    """Train a twin on a flight, as `heli-host twin --learn` does."""
    calibration = learn(twin.model, twin.rig, [part(name)], [name], drawn_s=drawn_s)
    return replace(twin, calibration=calibration)


def lost(flight: Flight, loss: Loss, at_s: float) -> Flight:
    """Hide a loss in a flight from a moment on: the rotors get less than is logged."""
    after = flight.t_s >= at_s
    front_V = flight.front_V / np.where(after, 1.0 - loss.front, 1.0)
    back_V = flight.back_V / np.where(after, 1.0 - loss.back, 1.0)
    return replace(flight, front_V=front_V, back_V=back_V)


def watched(twin: TwinRig, flight: Flight, loss: Loss) -> Watched:
    """Watch a flight with a loss from its middle on."""
    at_s = 0.5 * float(flight.t_s[0] + flight.t_s[-1])
    report = monitor_flight(twin, lost(flight, loss, at_s), loss.text, FALSE_ALARM_INTERVAL_h)
    alarms_s = [event.t_s for event in report.events if event.kind == "alarm" and event.t_s >= at_s]
    # The final ranking comes after its alarm; an alarm just before the loss may still get its own.
    names = [event.ranking[0].change.id for event in report.alarms if alarms_s and event.t_s >= alarms_s[0]]
    early = any(event.kind in ("alarm", "contradicts") and event.t_s < at_s for event in report.events)
    return Watched(
        loss,
        early,
        alarms_s[0] - at_s if alarms_s else None,
        names[0] if names else "",
        report.unjudged_s < 0.5 * report.free_s,
    )


def healthy_words(report: TwinReport) -> str:
    """Describe what a twin reports about a flight in which nothing changed."""
    said = [event.text for event in report.events if event.kind in ("alarm", "contradicts")]
    jumps = [event.text for event in report.events if event.kind == "glitch"]
    words = [said[0] if said else "quiet", *jumps]
    if report.unjudged_s:
        words.append(f"not judged {report.unjudged_s:.1f} s of {report.free_s:.1f} s")
    return f"most {report.max_evidence_nats:.1f} nats; {'; '.join(words)}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Print some lines for each pair and direction, then the totals; exit status 2 without the flights."""
    parser = argparse.ArgumentParser(prog="python -m tests.twin.measured", description=__doc__)
    add_pairs(parser)
    parser.add_argument("--drawn-s", type=float, default=DRAWN_s, help="drawn evidence of each training")
    given = parser.parse_args(arguments)
    if not MEASURED.exists():
        print(NO_DATA)
        return 2
    warnings.simplefilter("error", RuntimeWarning)
    quiet, contradicted, thresholds_nats, cases = 0, 0, [], []
    for pair in given.pairs or PAIRS:
        for back in (False, True):
            teaches, judges = PAIRS[pair][::-1] if back else PAIRS[pair]
            twin = trained(identified(pair, back), teaches, given.drawn_s)
            threshold_nats = twin.calibration.threshold_nats(FALSE_ALARM_INTERVAL_h)
            flight = part(judges)
            report = monitor_flight(twin, flight, judges, FALSE_ALARM_INTERVAL_h)
            kinds = {event.kind for event in report.events}
            quiet += not kinds & {"alarm", "contradicts"}
            contradicted += "contradicts" in kinds and "alarm" not in kinds
            thresholds_nats.append(threshold_nats)
            print(f"{judges}: alarm at {threshold_nats:.1f} nats; {healthy_words(report)}", flush=True)
            for loss in LOSSES:
                case = watched(twin, flight, loss)
                cases.append(case)
                delay = "none" if case.delay_s is None else f"{case.delay_s:.1f} s {case.name}"
                before = "an alarm before; " if case.early else ""
                unjudged = "" if case.is_judged else "; most of the flight is not judged"
                print(f"  {loss.text}: {before}{delay}{unjudged}", flush=True)
    found_s = [case.delay_s for case in cases if case.delay_s is not None and not case.early]
    named = sum(case.is_named for case in cases if case.delay_s is not None and not case.early)
    unjudged_count = sum(case.delay_s is None and not case.is_judged for case in cases)
    later = [case for case in cases if case.early and case.delay_s is not None]
    print(
        f"healthy: {quiet} quiet, {contradicted} not this model from the start, of {len(thresholds_nats)}; "
        f"highest alarm level {max(thresholds_nats):.1f} nats\n"
        f"losses: {len(found_s)} of {len(cases)} found, {named} named; "
        f"median delay {np.median(found_s) if found_s else np.nan:.1f} s\n"
        f"{unjudged_count} losses missed in flights that are mostly not judged; "
        f"{len(later)} found after an earlier alarm, {sum(case.is_named for case in later)} of them named"
    )
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
