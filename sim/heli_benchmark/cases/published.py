"""Cases of the published benchmark: conditions first, then causes that may be hidden under them.

Conditions do not depend on the causes: rate, length and number of flights give no hint of the truth.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from typing import Final

import numpy as np
from typing_extensions import override

from heli_benchmark.cases.clean import Stream
from heli_benchmark.cases.disturbed import (
    LAG,
    MAKERS,
    NEVER_DRAWN,
    PAPER_RIG,
    PAPER_RIG_ONLY,
    QUANSER_RIG,
    SIZES,
    SPEED_LAG,
    STRENGTH_FACTORS,
    STRONGLY_EXCITED_ONLY,
    WEAK_EXCITATION_FACTOR,
    DisturbedCase,
    RATES_Hz,
)
from heli_benchmark.effects.disturbances import CORRELATION_TIMES_s, DisturbanceModel, STRENGTHS_Nm
from heli_benchmark.effects.unlisted import DISTURBED
from heli_benchmark.flights import CONTROLLERS, Route

LISTED_CAUSES: Final = tuple(name for name in SIZES if not name.startswith(NEVER_DRAWN))
"""Causes that a case may hide, by their names in the catalogue."""
KINDS: Final = ("nothing",) * 4 + ("one",) * 3 + ("two",) * 2 + ("three", "unlisted", "unlisted and one")
"""Kinds of twelve cases; nothing is hidden in a third."""
_LISTED_COUNT: Final = {"nothing": 0, "one": 1, "two": 2, "three": 3, "unlisted": 0, "unlisted and one": 1}
_DISTURBANCES: Final = ("none", "weak", "moderate", "strong", "slow", "drifting")
"""Without disturbances, and five kinds of them."""
_ON_QUANSER, _WEAKLY_EXCITED = 0.3, 0.25
"""Shares of the cases on the rig of the other type, and with weak excitation."""
_TRAINING_s, _VALIDATION_s = (30.0, 45.0, 60.0), (20.0, 30.0, 40.0)
"""Lengths of flights. No shorter training flight: a shock happens 15 to 28 s after the start."""
_LATE: Final = (LAG, SPEED_LAG, "input_delay")
"""Effects that delay the thrust. A case has one of them at most, because they imitate each other."""
_FADING: Final = ("thrust_fade", "supply_fade")
_MAX_CONFLICTS: Final = 40


@dataclass(frozen=True)
class Draw:
    """Source of a case: its split, place and kind."""

    split_seed: int  # Seed that all cases of the split share; a sealed one derives it from its secret
    number: int  # Place of the case in its split, from 0
    kind: str  # One of `KINDS`
    redraws: int = 0  # Number of earlier draws whose rig could not be flown

    def rng(self, stream: int) -> np.random.Generator:
        """Return the random numbers of one subject."""
        again = (self.redraws,) if self.redraws else ()
        return np.random.default_rng([self.split_seed, stream, self.number, *again])


@dataclass(frozen=True)
class PublishedCase(DisturbedCase):
    """A case of a split, with one to three training flights and one or two validation flights."""

    training_s: tuple[float, ...] = (30.0,)  # training_s, validation_s: Lengths of the flights
    validation_s: tuple[float, ...] = (20.0,)
    attempt: int = 0
    """Number of the draw of routes and controllers, after a flight that left the safe range of angles."""
    draw: Draw = Draw(0, number=0, kind="nothing")  # Where it comes from: split, place and kind

    @property
    def durations_s(self) -> tuple[float, ...]:
        """Lengths of all flights, training flights first."""
        return (*self.training_s, *self.validation_s)

    @override
    def route(self, flight: int, duration_s: float) -> Route:
        """Draw the route of a flight; each flight has another one."""
        rng = Stream.ROUTE.rng(self.seed, flight, self.attempt)
        weaker = 0.45 if self.gentle else 1.0
        travel_deg, elevation_deg = rng.uniform(40.0, 75.0), rng.uniform(10.0, 15.0)
        # The rotors of the Quanser rig give a quarter of the thrust per volt.
        excitation_V = rng.uniform(0.12, 0.3) * (2.5 if self.rig_name == QUANSER_RIG else 1.0)
        return Route(
            duration_s,
            weaker * travel_deg,
            weaker * elevation_deg,
            bool(rng.integers(2)),
            weaker * excitation_V,
        )


def published_cases(seed: int, count: int) -> Iterator[PublishedCase]:
    """Draw the cases of a split; a larger split of the same seed begins with the cases of a smaller one."""
    order = np.random.default_rng([seed, 0])
    for number in range(count):
        if number % len(KINDS) == 0:
            kinds = order.permutation(KINDS)
        yield _draw_case(f"case-{number + 1:03d}", Draw(seed, number, str(kinds[number % len(KINDS)])))


def redrawn(case: PublishedCase) -> PublishedCase:
    """Return another case of the same name and kind: other conditions, rig and causes."""
    return _draw_case(case.name, replace(case.draw, redraws=case.draw.redraws + 1))


def base_rates() -> dict[str, float]:
    """Return the probability that a case hides each cause, with `nothing` and `unlisted`."""
    kinds = len(KINDS)
    rates = {
        "nothing": KINDS.count("nothing") / kinds,
        "unlisted": sum(kind.startswith("unlisted") for kind in KINDS) / kinds,
        **dict.fromkeys(LISTED_CAUSES, 0.0),
    }
    listed = sum(_LISTED_COUNT[kind] for kind in KINDS) / kinds
    for on_quanser, weak in ((False, False), (False, True), (True, False), (True, True)):
        share = (_ON_QUANSER if on_quanser else 1.0 - _ON_QUANSER) * (
            _WEAKLY_EXCITED if weak else 1.0 - _WEAKLY_EXCITED
        )
        names = _possible_causes(LISTED_CAUSES, on_quanser, weak)
        for name in names:
            rates[name] += share * listed / len(names)
    return rates


def _draw_case(name: str, draw: Draw) -> PublishedCase:
    """Draw conditions, causes and sizes of a case."""
    # The order of the draws determines the published cases, in separate streams of conditions and truth.
    conditions, truth, kind = draw.rng(1), draw.rng(2), draw.kind
    on_quanser = bool(conditions.random() < _ON_QUANSER)
    weak = bool(conditions.random() < _WEAKLY_EXCITED)
    disturbances, size_factor = _draw_disturbances(conditions)
    training_count = int(conditions.choice([1, 2, 3], p=[0.6, 0.25, 0.15]))
    training_s = conditions.choice(_TRAINING_s, training_count)
    validation_count = int(conditions.choice([1, 2], p=[0.7, 0.3]))
    validation_s = conditions.choice(_VALIDATION_s, validation_count)
    rate_Hz, controller = int(conditions.choice(RATES_Hz)), str(conditions.choice(CONTROLLERS))
    effects = _draw_listed_causes(truth, _LISTED_COUNT[kind], on_quanser, weak)
    unlisted: tuple[str, ...] = ()
    if kind.startswith("unlisted"):
        unlisted = (str(truth.choice(_possible_causes(tuple(DISTURBED), on_quanser, weak))),)
    size_factor *= WEAK_EXCITATION_FACTOR if weak else 1.0

    def size(cause: str, typical: float) -> float:
        # A lag depends on the rotors, not on the disturbances.
        return typical * (1.0 if cause in _LATE else size_factor) * float(truth.uniform(0.75, 1.3))

    return PublishedCase(
        name=name,
        effects=tuple((cause, size(cause, SIZES[cause])) for cause in effects),
        unlisted=tuple((cause, size(cause, DISTURBED[cause].size)) for cause in unlisted),
        seed=int(draw.rng(3).integers(1 << 31)),
        makers=tuple(MAKERS[cause] for cause in (*effects, *unlisted)),
        rig_name=QUANSER_RIG if on_quanser else PAPER_RIG,
        rate_Hz=rate_Hz,
        gentle=weak,
        controller=controller,
        disturbances=disturbances,
        training_s=tuple(map(float, training_s)),
        validation_s=tuple(map(float, validation_s)),
        draw=draw,
    )


def _draw_disturbances(rng: np.random.Generator) -> tuple[DisturbanceModel, float]:
    """Draw disturbances, and the factor of the sizes that suit them."""
    kind = str(rng.choice(_DISTURBANCES))
    weak, moderate, strong = range(len(STRENGTHS_Nm))
    strength = {"none": weak, "weak": weak, "strong": strong}.get(kind, moderate)
    gusts_Nm = STRENGTHS_Nm[strength]
    *shorter_s, longest_s = CORRELATION_TIMES_s
    correlation_time_s = longest_s if kind == "slow" else shorter_s[int(rng.integers(len(shorter_s)))]
    # The drift is a share of the gusts. Its draws are made in each case, because their order must not change.
    shares, drift_s = rng.uniform(0.5, 1.0, 3), float(rng.uniform(20.0, 40.0))
    if kind == "none":
        gusts_Nm = (0.0, 0.0, 0.0)
    if kind != "drifting":
        shares = np.zeros(3)
    elevation_Nm, pitch_Nm, travel_Nm = map(float, shares * gusts_Nm)
    disturbances = DisturbanceModel(
        gusts_Nm, correlation_time_s, slow_std_Nm=(elevation_Nm, pitch_Nm, travel_Nm), drift_s=drift_s
    )
    return disturbances, STRENGTH_FACTORS[strength]


@cache
def _possible_causes(names: tuple[str, ...], on_quanser: bool, weak: bool) -> tuple[str, ...]:
    """Return the causes that may be hidden on this rig, with this excitation."""
    excluded = (PAPER_RIG_ONLY if on_quanser else ()) + (STRONGLY_EXCITED_ONLY if weak else ())
    return tuple(name for name in names if not (excluded and name.startswith(excluded)))


def _draw_listed_causes(
    rng: np.random.Generator, count: int, on_quanser: bool, weak: bool
) -> tuple[str, ...]:
    """Draw listed causes that are possible together on this rig."""
    names = _possible_causes(LISTED_CAUSES, on_quanser, weak)
    for _ in range(_MAX_CONFLICTS):
        drawn = tuple(str(name) for name in rng.choice(names, count, replace=False))
        if all(sum(name in group for name in drawn) <= 1 for group in (_LATE, _FADING)):
            return drawn
    return drawn[:1]
