"""Twins of real machines: ``python -m tests.twin.measured``; needs ../shared/data/measured.

There are two flights of each machine. The rig is identified on one flight, with the effects of `EFFECTS`, and
its twin is trained on the same flight. The twin then monitors the other flight: as it was recorded, and with
a simulated loss in its second half. Each flight of a pair serves once for training.
"""

import argparse
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from heli_host.data.flight import Flight
from heli_host.data.log.reader import read_flight
from heli_lab.watch.calibration import DEFAULT_CALIBRATION, TwinRig
from heli_lab.watch.learn import DRAWN_s, learn
from heli_lab.watch.monitor import TwinReport, monitor_flight
from heli_sim.rig import load_rig

from tests.field.cases import NO_DATA
from tests.measured.pairs import MEASURED, PAIRS, RIG, FROM_s, LANDS_s, add_pairs, flights
from tests.twin.rigs import identify_rig

EFFECTS: Final = ("rotor_speed_lag", "gyroscopic_torque", "edgewise_flow")
"""Effects of all machines, from docs/validation/measured-flights.md."""
FALSE_ALARM_INTERVAL_h: Final = 10.0
WITHIN_s: Final = 3.0
"""Required median delay of an alarm [s]."""


@dataclass(frozen=True)
class Loss:
    """A simulated loss of voltage."""

    # Thrust of these models is a linear function of the voltage, so a share of voltage is a share of thrust.

    label: str  # Description for the printed result
    front: float  # Share of the logged voltage that does not reach the rotor
    back: float
    # Ids of the changes that name this loss. A weaker supply and two rotors that fade look alike, because
    # both rotors lose the same share.
    right_names: frozenset[str]


LOSSES: Final = (
    Loss("supply -5 %", front=0.05, back=0.05, right_names=frozenset({"supply_step", "thrust_fade"})),
    Loss("front -8 %", front=0.08, back=0.0, right_names=frozenset({"thrust_step.front"})),
    Loss("back -8 %", front=0.0, back=0.08, right_names=frozenset({"thrust_step.back"})),
)


@dataclass(frozen=True)
class LossResult:
    """Result of monitoring a flight with a loss."""

    loss: Loss  # The simulated loss
    has_early_alarm: bool  # True if an alarm or a contradiction came before the loss
    delay_s: float | None  # Time from the loss to its alarm [s]; None without an alarm
    name: str  # Id of the change that the final ranking of that alarm puts first; empty without a ranking
    is_judged: bool  # True if the twin judged at least half of the flight

    @property
    def is_detected(self) -> bool:
        """Whether the loss has an alarm, and the flight none before it."""
        return self.delay_s is not None and not self.has_early_alarm

    @property
    def has_right_name(self) -> bool:
        """Whether the twin named the loss."""
        return self.name in self.loss.right_names


def undamaged_part(name: str) -> Flight:
    """Read the part of a flight between take-off and landing, as the description of the data limits it."""
    flight = read_flight(MEASURED / f"{name}.csv.gz")
    is_inside = (flight.t_s >= FROM_s) & (flight.t_s < LANDS_s.get(name, np.inf))
    elevation_rad, pitch_rad, travel_rad = flight.angles_rad[is_inside].T
    return Flight(
        flight.t_s[is_inside],
        flight.front_V[is_inside],
        flight.back_V[is_inside],
        elevation_rad,
        pitch_rad,
        travel_rad,
        meta=flight.meta,
    )


def identified_twin(pair: str, *, exchanged: bool = False) -> TwinRig:
    """Identify the rig on the first flight of a pair, or on the second one if `exchanged`."""
    # The twin has the default calibration.
    record, _ = flights(pair, exchanged)
    model, rig = identify_rig(EFFECTS, load_rig(RIG), [record])
    return TwinRig(rig, model, DEFAULT_CALIBRATION, pair)


def trained_twin(twin: TwinRig, name: str, drawn_s: float = DRAWN_s) -> TwinRig:
    """Train a twin on the flight `name`, as `heli-host twin --learn` does."""
    calibration = learn(twin.model, twin.rig, [undamaged_part(name)], [name], drawn_s=drawn_s)
    return replace(twin, calibration=calibration)


def with_loss(flight: Flight, loss: Loss, onset_s: float) -> Flight:
    """Return a flight with a loss from `onset_s` on."""
    # The measured motion stays. The logged voltages are raised, so that the rotors have less thrust than the
    # log states.
    has_loss = flight.t_s >= onset_s
    front_V = flight.front_V / np.where(has_loss, 1.0 - loss.front, 1.0)
    back_V = flight.back_V / np.where(has_loss, 1.0 - loss.back, 1.0)
    return replace(flight, front_V=front_V, back_V=back_V)


def monitor_loss(twin: TwinRig, flight: Flight, loss: Loss) -> LossResult:
    """Monitor a flight with a loss in its second half."""
    onset_s = 0.5 * float(flight.t_s[0] + flight.t_s[-1])
    report = monitor_flight(twin, with_loss(flight, loss, onset_s), loss.label, FALSE_ALARM_INTERVAL_h)
    alarms_s = [event.t_s for event in report.events if event.kind == "alarm" and event.t_s >= onset_s]
    # The final ranking comes after its alarm. The final ranking of an alarm just before the loss may come
    # after the loss: it does not count.
    names = [event.ranking[0].change.id for event in report.alarms if alarms_s and event.t_s >= alarms_s[0]]
    return LossResult(
        loss,
        has_early_alarm=any(
            event.kind in ("alarm", "contradicts") and event.t_s < onset_s for event in report.events
        ),
        delay_s=alarms_s[0] - onset_s if alarms_s else None,
        name=names[0] if names else "",
        is_judged=report.unjudged_s < 0.5 * report.free_s,
    )


def healthy_text(report: TwinReport) -> str:
    """Describe what a twin reports about a flight without a loss."""
    alarms = [event.text for event in report.events if event.kind in ("alarm", "contradicts")]
    jumps = [event.text for event in report.events if event.kind == "glitch"]
    texts = [alarms[0] if alarms else "quiet", *jumps]
    if report.unjudged_s:
        texts.append(f"not judged {report.unjudged_s:.1f} s of {report.free_s:.1f} s")
    return f"most {report.max_evidence_nats:.1f} nats; {'; '.join(texts)}"


def loss_text(result: LossResult) -> str:
    """Describe what a twin reports about a flight with a loss."""
    delay = "none" if result.delay_s is None else f"{result.delay_s:.1f} s {result.name}"
    before = "an alarm before; " if result.has_early_alarm else ""
    unjudged = "" if result.is_judged else "; most of the flight is not judged"
    return f"{result.loss.label}: {before}{delay}{unjudged}"


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the results of each pair in both directions, then the totals; exit status 2 without the data."""
    parser = argparse.ArgumentParser(prog="python -m tests.twin.measured", description=__doc__)
    add_pairs(parser)
    parser.add_argument("--drawn-s", type=float, default=DRAWN_s, help="drawn evidence of each training")
    options = parser.parse_args(arguments)
    if not MEASURED.exists():
        print(NO_DATA)
        return 2
    warnings.simplefilter("error", RuntimeWarning)
    healthy_reports: list[TwinReport] = []
    results: list[LossResult] = []
    for pair in options.pairs or PAIRS:
        for exchanged in (False, True):
            training_name, monitored_name = PAIRS[pair][::-1] if exchanged else PAIRS[pair]
            identified = identified_twin(pair, exchanged=exchanged)
            twin = trained_twin(identified, training_name, options.drawn_s)
            flight = undamaged_part(monitored_name)
            report = monitor_flight(twin, flight, monitored_name, FALSE_ALARM_INTERVAL_h)
            healthy_reports.append(report)
            print(
                f"{monitored_name}: alarm at {report.threshold_nats:.1f} nats; {healthy_text(report)}",
                flush=True,
            )
            for loss in LOSSES:
                result = monitor_loss(twin, flight, loss)
                results.append(result)
                print(f"  {loss_text(result)}", flush=True)
    print("\n".join(_totals(healthy_reports, results)))
    return 0


def _totals(healthy_reports: Sequence[TwinReport], results: Sequence[LossResult]) -> list[str]:
    """Count the quiet flights, the detected and the named losses, as text."""
    event_kinds = [{event.kind for event in report.events} for report in healthy_reports]
    quiet = sum(not kinds & {"alarm", "contradicts"} for kinds in event_kinds)
    contradicted = sum("contradicts" in kinds and "alarm" not in kinds for kinds in event_kinds)
    highest_nats = max(report.threshold_nats for report in healthy_reports)
    detected = [result for result in results if result.is_detected]
    delays_s = [result.delay_s for result in detected if result.delay_s is not None]
    unjudged = sum(result.delay_s is None and not result.is_judged for result in results)
    after_early_alarm = [
        result for result in results if result.has_early_alarm and result.delay_s is not None
    ]
    return [
        f"healthy: {quiet} quiet, {contradicted} not this model from the start, of {len(healthy_reports)}; "
        f"highest alarm threshold {highest_nats:.1f} nats",
        f"losses: {len(detected)} of {len(results)} detected, "
        f"{sum(result.has_right_name for result in detected)} named; "
        f"median delay {np.median(delays_s) if delays_s else np.nan:.1f} s (required: {WITHIN_s:g} s)",
        f"{unjudged} losses missed in flights that are mostly not judged; "
        f"{len(after_early_alarm)} detected after an earlier alarm, "
        f"{sum(result.has_right_name for result in after_early_alarm)} of them named",
    ]


if __name__ == "__main__":
    raise SystemExit(main())
