"""Calibrates a twin on nominal flights: disturbances, uncertainty of the rig, and the tail of the evidence.

The evidence without a change is drawn along the nominal flights themselves. The filter follows a flight, and
its innovations are replaced by pieces of its own innovations in another order and with random signs. A
simulation would instead need gains that stabilise the rig. The errors of the rig's parameters are states of
the filter, so that innovations and sensitivities already contain them.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
import numpy.typing as npt
from heli_host.data.arrays import Floats
from heli_host.data.flight import Flight
from heli_host.errors import FlightAborted
from heli_host.fly.plan import Plan
from heli_sim.model.base import Effect, Model
from heli_sim.model.effect import AXES
from heli_sim.model.effects import catalogue
from heli_sim.model.plant import Plant
from heli_sim.rig import Rig
from heli_sim.rig.schema import Quantity

from heli_lab.errors import TwinError
from heli_lab.fit.flight_model import TORQUE_STD_Nm, model_functions, without_random_effects
from heli_lab.fit.grey_box import DisturbanceModel, SLOW_CORRELATION_TIME_s
from heli_lab.fit.innovations import InnovationsModel
from heli_lab.fit.linearised_flight import BLOCK_s, LinearisedFlight
from heli_lab.fit.normal_equations import posterior_step
from heli_lab.fit.records import Record, prepare
from heli_lab.simulated_board import connected, fly_and_read, set_hover, world_of
from heli_lab.watch.calibration import DEFAULT_DISTURBANCES, Calibration, Tail, fit_tail
from heli_lab.watch.disturbances import estimate_with_fixed_rig
from heli_lab.watch.likelihood_ratio import (
    CUT_OFF_STD,
    PERSISTENCE_BLOCKS,
    Evidence,
    Innovation,
    LikelihoodRatio,
    PersistentEvidence,
    WINDOW_s,
)
from heli_lab.watch.model_check import PIECE, piece_variance
from heli_lab.watch.steps import count_rad_of, samples_of
from heli_lab.watch.twin import FILTER_SETTLING_s, Twin
from heli_lab.watch.twin_model import SUPPLY_STD, ParameterUncertainty, TwinModel

DRAWN_s: Final = 720.0
"""Time of flight for which the evidence is drawn, s. It gives some 30 excursions, and a standard error of
18 % for the scale of the tail. More: minutes of waiting. Less: thresholds that chance sets."""
FLIGHTS: Final = 12
"""Number of simulated flights of a rig without nominal flights, one minute each, for the same reason."""
_MIN_FREE_s: Final = 10.0
"""Shortest free flight along which evidence is drawn, s: an onset needs some seconds to show. Longer: short
flights are refused. Shorter: the draws contain no whole excursion."""
_VOLTAGE_MARGIN: Final = 0.1
"""Share by which voltages may exceed those of the nominal flights, for the model to count as known: of
their range below, so that a rotor that brakes or reverses for the first time is noticed; of the voltage
above, where a weaker supply leads. Larger: unknown physics is taken for a change. Smaller: little of
another flight counts."""
_MAX_ATTEMPTS_PER_FLIGHT: Final = 3
"""Greatest number of attempts per flight: the board does not arm if gusts move the arm on the table."""
_FEW_SHARE: Final = 1.0 / 3.0
"""Share of a quiet room's gusts below which a warning is given."""
_DRAWS_STREAM: Final = 32
"""Second part of the seed of the draws, so that they are independent of flights that are simulated with the
same seed. Any other number gives other draws, equally good."""
_EVIDENCE_SHARE: Final = 0.3
"""Share of the work before the draws, for the progress: the draws take most of the time."""
Say = Callable[[str, float], None]
"""Function that takes the present stage and the share of the work that is done."""


def has_few_disturbances(disturbances: DisturbanceModel) -> bool:
    """Whether the gusts about an axis are so small that those of an ordinary day will raise an alarm."""
    return bool(np.any(disturbances.fast_std < _FEW_SHARE * DEFAULT_DISTURBANCES.fast_std))


def learn_rig(
    model: Model, rig: Rig, nominal_flights: Sequence[Flight], labels: Sequence[str]
) -> tuple[DisturbanceModel, ParameterUncertainty]:
    """Estimate disturbances and the uncertainty of parameters from nominal flights, named `labels`."""
    # The parameters keep the rig's values; encoder zeros and constant torques are estimated per flight. The
    # tolerances of the rig file are the priors.
    of_flights = estimate_with_fixed_rig(model, rig, _prepared(rig, nominal_flights, labels))
    twin_model, records, references = of_flights.model, of_flights.records, of_flights.references
    disturbances = of_flights.disturbances
    # Compute the covariance of all parameters at these estimates. The rig's parameters are the first.
    all_parameters, shared = of_flights.all_parameters, list(of_flights.fixed)
    theta = np.concatenate((list(of_flights.fixed.values()), of_flights.estimate.theta))
    functions = model_functions(twin_model, all_parameters.quantities)
    linearised = [
        LinearisedFlight(reference, functions, all_parameters.parameters(theta, index))
        for index, reference in enumerate(references)
    ]
    filtered = InnovationsModel(linearised, all_parameters.columns, len(theta))
    innovations = filtered.innovations(disturbances)
    posterior = posterior_step(
        all_parameters,
        theta,
        innovations.information(),
        innovations.score(),
        per_flight=innovations.per_flight,
    )
    covariance = posterior.covariance[: len(shared), : len(shared)]
    low_V, high_V = _known_voltages(records)
    return disturbances, ParameterUncertainty(tuple(shared), covariance, SUPPLY_STD, low_V, high_V)


def _prepared(rig: Rig, flights: Sequence[Flight], labels: Sequence[str]) -> list[Record]:
    return [prepare(flight, rig, label) for flight, label in zip(flights, labels, strict=True)]


def _known_voltages(records: Sequence[Record]) -> tuple[Floats, Floats]:
    """Return the lowest and the highest voltage of each rotor for which parameters hold [V], (2,) each."""
    free_V = np.vstack(
        [record.voltages_V[start:stop] for record in records for start, stop in record.segments]
    )
    lowest_V, highest_V = free_V.min(axis=0), free_V.max(axis=0)
    low_V = lowest_V - _VOLTAGE_MARGIN * (highest_V - lowest_V)
    # A rotor that reverses for the first time is unknown, however slowly it turned before.
    low_V = np.where(lowest_V >= 0.0, np.maximum(low_V, 0.0), low_V)
    high_V = (1.0 + _VOLTAGE_MARGIN) * highest_V
    return low_V, high_V


def learn(
    model: Model,
    rig: Rig,
    nominal_flights: Sequence[Flight] = (),
    labels: Sequence[str] = (),
    *,
    drawn_s: float = DRAWN_s,
    seed: int = 1,
    say: Say = lambda _text, _share: None,
) -> Calibration:
    """Estimate the calibration of a twin."""
    if not nominal_flights:
        return _calibrate_by_simulation(model, rig, seed, say)
    say("disturbances of the nominal flights", 0.0)
    disturbances, uncertainty = learn_rig(model, rig, nominal_flights, labels)
    twin = TwinModel(model, rig, uncertainty)
    followed_flights: list[FollowedFlight] = []
    for flight, label in zip(nominal_flights, labels, strict=True):
        say(f"evidence in {label}", 0.1)
        followed_flights.append(evidence(twin, disturbances, flight))
    healthy_s = BLOCK_s * sum(len(flight.history) for flight in followed_flights)
    if healthy_s < _MIN_FREE_s:
        raise TwinError(
            f"{healthy_s:.1f} s of free nominal flight are too short for a threshold",
            f"give flights with at least {_MIN_FREE_s:g} s in the air",
        )
    # The filter starts with uncertain states, so its first innovations are not those of a settled filter.
    first_settled = round(FILTER_SETTLING_s / BLOCK_s)
    innovations = [flight.innovations[first_settled:] for flight in followed_flights]
    histories = [flight.history_without_kicks() for flight in followed_flights]
    draws = Draws(innovations, math.ceil(drawn_s / healthy_s), np.random.default_rng([seed, _DRAWS_STREAM]))
    for number, flight in enumerate(nominal_flights):
        done = number / len(nominal_flights)
        say(f"draws along {labels[number]}", _EVIDENCE_SHARE + (1.0 - _EVIDENCE_SHARE) * done)
        histories += drawn_evidence(twin, disturbances, flight, draws)
    return Calibration(
        disturbances,
        tail=fit_tail(histories, healthy_s),
        source=", ".join(labels),
        uncertainty=uncertainty,
        piece_variance=piece_variance(np.vstack(innovations)),
    )


def _calibrate_by_simulation(model: Model, rig: Rig, seed: int, say: Say) -> Calibration:
    """Set the threshold by simulated flights in the disturbances of a quiet room."""
    twin = TwinModel(model, rig)
    noisy_model = with_process_noise(twin.model, DEFAULT_DISTURBANCES)
    histories: list[list[tuple[float, float]]] = []
    for number in range(_MAX_ATTEMPTS_PER_FLIGHT * FLIGHTS):
        if len(histories) == FLIGHTS:
            break
        say(f"simulated flight {len(histories) + 1} of {FLIGHTS}", len(histories) / FLIGHTS)
        # Users choose small seeds: these flights must differ from theirs.
        flight_seed = 1_000_000 * seed + number
        try:
            flight = fly_simulated(noisy_model, rig, random_plan(flight_seed), flight_seed)
        except FlightAborted:
            continue  # another seed replaces it
        histories.append(evidence(twin, DEFAULT_DISTURBANCES, flight).history)
    source = f"{FLIGHTS} simulated flights, seed {seed}"
    return Calibration(DEFAULT_DISTURBANCES, fit_tail(histories), source)


_DAY_STD: Final = 0.1
"""Standard deviation of the logarithm of the size of a day's innovations. By judgement: half a minute of
flight leaves it open to 0.05, and days differ. Each draw is a day. Larger: weak changes stay hidden.
Smaller: a day with slightly larger gusts raises alarms."""
NO_ALARM: Final = Tail(np.inf, per_hour=0.0, scale_nats=0.0, excesses=1)
"""Tail of a twin that raises no alarm."""

History = list[tuple[float, float]]
"""Time [s] and evidence [nats] of each measurement of a flight."""


class Draws:
    """Innovations of healthy flights in another order: pieces from random places, with random signs.
    `innovations` has shape (n, 3).
    """

    def __init__(self, innovations: Sequence[Floats], count: int, rng: np.random.Generator) -> None:
        self._innovations: Floats = np.vstack([flight[~_near_kicks(flight)] for flight in innovations])
        self._rng, self.count = rng, count
        # For each draw: row of its next innovation, sign of its present piece, (count,), and the scale of its
        # day for each axis, (count, 3).
        self._row, self._sign = np.zeros(count, int), np.ones(count)
        self._scale: Floats = np.exp(_DAY_STD * rng.normal(size=(count, 3)))
        self._rows_left_in_piece = 0

    def next(self) -> Floats:
        """Return the next innovation of each draw, (count, 3)."""
        if not self._rows_left_in_piece:
            self._row = self._rng.integers(len(self._innovations), size=self.count)
            self._sign = self._rng.choice((-1.0, 1.0), size=self.count)
            self._rows_left_in_piece = PIECE
        self._rows_left_in_piece -= 1
        # A piece that reaches the last row continues with the first one.
        measured = self._innovations[self._row % len(self._innovations)]
        self._row = self._row + 1
        return np.asarray(self._scale * self._sign[:, None] * measured)


def _near_kicks(innovations: Floats) -> npt.NDArray[np.bool_]:
    """Whether each row of innovations, (n, 3), is within `PIECE` rows of a kick; False if all rows are."""
    kicks = np.flatnonzero(np.any(np.abs(innovations) > CUT_OFF_STD, axis=1))
    rows = np.arange(len(innovations))
    is_near = np.any(np.abs(rows[:, None] - kicks) <= PIECE, axis=1)
    return is_near if not is_near.all() else np.zeros(len(rows), bool)


@dataclass(frozen=True)
class FollowedFlight:
    """A flight that a twin followed without raising an alarm."""

    history: History  # Time [s] and evidence [nats] of each measurement
    innovations: Floats  # (n, 3): Innovations, in standard deviations
    kicks_s: tuple[float, ...]  # Times of innovations above `CUT_OFF_STD` [s]

    def history_without_kicks(self) -> History:
        """Return the history without the times at which a kick is in the window."""
        return [
            (t_s, nats)
            for t_s, nats in self.history
            if not any(kick_s <= t_s <= kick_s + WINDOW_s for kick_s in self.kicks_s)
        ]


def evidence(twin: TwinModel, disturbances: DisturbanceModel, flight: Flight) -> FollowedFlight:
    """Follow a flight without raising an alarm."""
    innovations: list[Floats] = []
    kicks_s: list[float] = []

    def recorded(count_rad: Floats) -> Evidence:
        """Return evidence that also keeps the innovations."""
        return _RecordedEvidence(LikelihoodRatio(twin.changes, count_rad, draws=2), innovations, kicks_s)

    history = _follow(twin, disturbances, flight, recorded)
    return FollowedFlight(history, np.array(innovations).reshape(-1, 3), tuple(kicks_s))


def drawn_evidence(
    twin: TwinModel, disturbances: DisturbanceModel, flight: Flight, draws: Draws
) -> list[History]:
    """Return the times [s] and the evidence [nats] of each draw along a flight."""
    histories: list[History] = [[] for _ in range(draws.count)]

    def drawn(count_rad: Floats) -> Evidence:
        """Return the evidence of the draws."""
        return _DrawnEvidence(LikelihoodRatio(twin.changes, count_rad, draws.count), draws, histories)

    _follow(twin, disturbances, flight, drawn)
    return histories


def _follow(
    model: TwinModel,
    disturbances: DisturbanceModel,
    flight: Flight,
    new_evidence: Callable[[Floats], Evidence],
) -> History:
    """Follow a flight with a twin that collects the evidence that `new_evidence` makes from the angles of
    one count; return the twin's history.
    """
    samples, sample_s = samples_of(flight)
    count_rad = count_rad_of(flight, model.rig)
    twin = Twin(
        model,
        Calibration(disturbances, NO_ALARM),
        count_rad,
        sample_s,
        evidence=lambda: new_evidence(count_rad),
        watches_glitches=False,
    )
    twin.records_evidence = True
    twin.update(samples)
    return twin.evidence_history


class _RecordedEvidence:
    """Persistent evidence; also keeps the innovations."""

    def __init__(self, ratio: LikelihoodRatio, innovations: list[Floats], kicks_s: list[float]) -> None:
        self.ratio, self._evidence = ratio, PersistentEvidence(ratio)
        self._innovations, self._kicks_s = innovations, kicks_s

    def add(self, innovation: Innovation, t_s: float) -> float:
        """Record an innovation, and add it to the evidence."""
        self._innovations.append(innovation.value)
        if np.any(np.abs(innovation.value) > CUT_OFF_STD):
            self._kicks_s.append(t_s)
        return self._evidence.add(innovation, t_s)


class _DrawnEvidence:
    """Evidence of drawn innovations, with the sensitivities of the measured ones. It raises no alarm."""

    def __init__(self, ratio: LikelihoodRatio, draws: Draws, histories: list[History]) -> None:
        self.ratio, self._draws, self._histories = ratio, draws, histories
        # Evidence of each draw, (count,), at the latest measurements.
        self._latest_nats: deque[Floats] = deque(maxlen=PERSISTENCE_BLOCKS)

    def add(self, innovation: Innovation, t_s: float) -> float:
        """Add the next drawn innovations instead of the measured one."""
        drawn = np.clip(self._draws.next(), -CUT_OFF_STD, CUT_OFF_STD)
        self._latest_nats.append(self.ratio.update_draws(drawn, innovation.sensitivity))
        if len(self._latest_nats) == PERSISTENCE_BLOCKS:
            persistent_nats = np.min(self._latest_nats, axis=0)
            for history, nats in zip(self._histories, persistent_nats, strict=True):
                history.append((t_s, float(nats)))
        return -math.inf  # no evidence for the twin, which must not raise an alarm


_TORQUE_SHARE: Final = 0.5
"""Standard deviation of the constant torques of simulated flights as a share of `TORQUE_STD_Nm`: the torques
of an identified rig are better known than their prior."""

_TIME_RANGE_s: Final = (0.02, 20.0)
"""Shortest and longest correlation time of gusts that the simulation accepts [s]."""
_OTHER_SEGMENTS_s: Final = 28.0
"""Duration of a random plan without its sines [s]: take-off, settling, waypoints and hover."""
_MIN_SINES_s: Final = 17.0
"""Shortest duration of the sines [s]: a period of the fastest travel."""
_PLAN: Final = """
title = "Healthy {seed}"
[start]
elevation_deg = 0
rate_deg_s = 8
settle_s = 3
[[segment]]
kind = "sine"
travel_amplitude_deg = {travel}
travel_period_s = {travel_s}
elevation_amplitude_deg = {elevation}
elevation_period_s = {elevation_s}
duration_s = {sines_s}
{excite}
[[segment]]
kind = "waypoints"
path = "straight"
points = [
  {{ at_s = 6, elevation_deg = {up}, travel_deg = {corner} }},
  {{ at_s = 12, elevation_deg = -{up}, travel_deg = 0 }},
]
duration_s = 13
[[segment]]
kind = "hold"
duration_s = 8
"""


def random_plan(seed: int, duration_s: float = 60.0) -> Plan:
    """Draw a plan of about `duration_s` in the air: sines, waypoints and hover."""
    rng = np.random.default_rng(seed)
    travel_deg = round(float(rng.uniform(10, 40)), 1)
    excite = 'excite = { signal = "multisine", front_V = 0.2, back_V = 0.2, start_Hz = 0.1, stop_Hz = 3 }'
    text = _PLAN.format(
        seed=seed,
        travel=travel_deg,
        # A period in proportion to the amplitude limits the rate of travel.
        travel_s=round(max(16.0, 0.62 * travel_deg), 1),
        elevation=round(float(rng.uniform(2, 9)), 1),
        elevation_s=round(float(rng.uniform(7, 12)), 1),
        sines_s=round(max(duration_s - _OTHER_SEGMENTS_s, _MIN_SINES_s), 1),
        up=round(float(rng.uniform(3, 10)), 1),
        corner=round(float(rng.uniform(10, 40))),
        excite=excite if rng.random() < 0.5 else "",
    )
    return Plan.parse(text, f"healthy-{seed}.toml")


def with_process_noise(model: Model, disturbances: DisturbanceModel) -> Model:
    """Add random gusts and a slow random drift about each axis to a model, for its simulation."""
    specs = catalogue()
    effects: list[Effect] = [*without_random_effects(model).effects]
    for axis, name in enumerate(AXES):
        spec = specs[f"random_torque.{name}"]
        gusts = spec.make(
            {
                spec.full("Nm"): float(disturbances.fast_std[axis]),
                spec.full("s"): float(np.clip(disturbances.correlation_time_s[axis], *_TIME_RANGE_s)),
            }
        )
        slow_std_Nm = float(disturbances.slow_std[axis])
        effects += [
            gusts,
            _with_other_parameters(gusts, f"slow_drift.{name}", slow_std_Nm, SLOW_CORRELATION_TIME_s),
        ]
    return type(model)(tuple(effects))


def _with_other_parameters(gusts: Effect, name: str, std_Nm: float, correlation_time_s: float) -> Effect:
    """Return the same process with another name, standard deviation and correlation time."""
    # Names of parameters and states begin with the effect's name, in which a dot becomes an underscore.
    old_prefix, new_prefix = gusts.prefix, name.replace(".", "_")

    def renamed(quantity: Quantity) -> Quantity:
        return replace(quantity, name=quantity.name.replace(old_prefix, new_prefix))

    return replace(
        gusts,
        name=name,
        parameters=tuple(renamed(parameter) for parameter in gusts.parameters),
        states=tuple(renamed(state) for state in gusts.states),
        values={f"{new_prefix}_Nm": std_Nm, f"{new_prefix}_s": correlation_time_s},
        priors={},
        multimodal=(),
    )


def fly_simulated(model: Model, rig: Rig, plans: Plan | Sequence[Plan], seed: int) -> Flight:
    """Simulate a flight of plans with the flight code on the simulated board."""
    rng = np.random.default_rng(seed)
    rig_with_torques = rig.replace(
        **{name: rig[name].value + _TORQUE_SHARE * std * rng.normal() for name, std in TORQUE_STD_Nm.items()}
    )
    with connected(world_of(Plant(model, rig_with_torques, seed), seed)) as heli:
        set_hover(heli, model, rig)
        flight, summary = fly_and_read(heli, plans)
    if not np.any(flight.voltages_V):
        raise FlightAborted(summary.outcome, "check the rig: heli-host rig check FILE")
    return flight
