"""Cases without disturbances, flown by the flight code; their flights are made once and kept."""

from __future__ import annotations

import argparse
import fnmatch
import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from pathlib import Path
from typing import TypeVar

import numpy as np
from heli_host.data.log.table import write_csv
from heli_sim.rig import Rig, load_rig

from heli_benchmark.effects.listed import LISTED, MORE_LISTED, OTHER_FORMS, ListedEffect, Maker
from heli_benchmark.effects.unlisted import MORE_OFF_LIST, OFF_LIST, UnlistedEffect
from heli_benchmark.flights import flown, plan
from heli_benchmark.plant import HiddenEffect


class Stream(IntEnum):
    """Streams of random numbers of one seed: a case changes in one respect without a change in the others."""

    # The numbers are those of published results. A new subject takes an unused number.

    SIZE = 0
    RIG = 1
    LISTED_EFFECT = 2
    UNLISTED_EFFECT = 3
    FLOWN_PLAN = 4
    EFFECT_IN_FLIGHT = 5
    DISTURBED_CASE = 6
    DISTURBANCES = 7
    ROUTE = 8
    SECOND_SLIP = 11
    CALM_CASE = 12
    NOISE_CASE = 13
    NOISE = 14
    PLAY_CASE = 15

    def rng(self, seed: int, *numbers: int) -> np.random.Generator:
        """Return the random numbers of a seed, such as those of its flight of a number."""
        return np.random.default_rng([seed, self, *numbers])


TRAIN_S, VALIDATE_S = 60.0, 40.0
_NOTHING = 12
_SEVERAL = (
    ("rotor_lag", "coulomb_friction.elevation"),
    ("rotor_lag", "cable_spring.travel"),
    ("thrust_asymmetry", "travel_drag_quadratic"),
    ("thrust_fade", "coulomb_friction.travel"),
    ("input_delay", "ground_effect"),
    ("rotor_lag", "axis_tilt", "coulomb_friction.travel"),
    ("rotor_lag", "thrust_step.front", "cable_spring.elevation"),
    ("thrust_quadratic", "periodic_torque.travel"),
)
"""Combinations of two or three effects."""


_OFF_FACTOR = {2: 1.0, 1: 0.6}
"""Factors of the size for large and small cases."""


@dataclass(frozen=True)
class Case:
    """A rig with something hidden, and two flights of it."""

    name: str  # Name for files and tables
    effects: tuple[tuple[str, float], ...]  # Listed effects and their sizes, in the unit of the effect
    unlisted: tuple[tuple[str, float], ...]  # Effects that the catalogue does not list, and their sizes
    seed: int  # Seed of rig, flights and effects
    makers: tuple[Maker, ...] = field(repr=False)  # Factory of each effect, listed ones first

    @property
    def kind(self) -> str:
        """Kind of the case: nothing, one, several or off_list."""
        if self.unlisted:
            return "off_list"
        return ("nothing", "one", "several")[min(2, len(self.effects))]

    def rig(self) -> Rig:
        """Draw the true rig: thrust within 20 %, friction half to double, masses and lengths within 1 %."""
        rng = Stream.RIG.rng(self.seed)
        rig = load_rig("makki2024")
        numbers = {"thrust_gain": rng.uniform(0.8, 1.2)}
        for axis in ("elevation", "pitch", "travel"):
            numbers[f"friction_{axis}"] = 2.0 ** rng.uniform(-1.0, 1.0)
        for name in ("M_f", "M_b", "M_w", "M_h", "M_l", "L_a", "L_b", "L_h", "L_phi", "L_theta", "L_x"):
            numbers[name] = rng.uniform(0.99, 1.01)
        if any(name == "removed.dead_zone" for name, _ in self.effects):
            # Without a dead zone the arm hovers at voltages below the dead band of the usual drivers.
            numbers["driver_dead_band"] = 0.0
        return rig.replace(**{name: factor * rig[name].value for name, factor in numbers.items()})

    def hidden(self, flight: int = 0) -> list[HiddenEffect]:
        """Create the hidden effects, with the same moments, angles and frequencies in both flights."""
        effects: list[HiddenEffect] = []
        for number, ((_, size), maker) in enumerate(
            zip((*self.effects, *self.unlisted), self.makers, strict=True)
        ):
            # Listed and unlisted effects have separate sequences of seeds.
            is_listed = number < len(self.effects)
            rng = (
                Stream.LISTED_EFFECT.rng(self.seed, number)
                if is_listed
                else Stream.UNLISTED_EFFECT.rng(self.seed, number - len(self.effects))
            )
            effect = maker(size, rng)
            effect.flight_rng = Stream.EFFECT_IN_FLIGHT.rng(self.seed, flight, number)
            effects.append(effect)
        return effects

    def truth(self) -> dict[str, dict[str, float]]:
        """Return the true parameters of the listed effects."""
        return {name: effect.truth for (name, _), effect in zip(self.effects, self.hidden(), strict=False)}

    def flights(
        self, folder: Path, durations_s: tuple[float, float] = (TRAIN_S, VALIDATE_S)
    ) -> tuple[Path, Path]:
        """Fly both flights, unless their files exist."""
        paths = (folder / self.name / "a.csv.gz", folder / self.name / "b.csv.gz")
        for number, (path, duration_s) in enumerate(zip(paths, durations_s, strict=True)):
            if path.exists():
                continue
            path.parent.mkdir(parents=True, exist_ok=True)
            rng = Stream.FLOWN_PLAN.rng(self.seed, number)
            flight_plan = plan(f"{self.seed}", duration_s, rng)
            # Renamed when complete, so that an interrupted run leaves no partial flight.
            unfinished = path.with_name("unfinished-" + path.name)
            write_csv(
                flown(self.rig(), self.hidden(number), flight_plan, self.seed + number),
                unfinished,
                notes_inside=True,
            )
            unfinished.rename(path)
        return paths


def clean_cases() -> list[Case]:
    """Return all clean cases, in an order in which the first are a fair sample of all."""
    cases = list(_cases_by_kind())
    return [cases[i] for i in np.random.default_rng(0).permutation(len(cases))]


_SMALL, _LARGE = 1, 2
_SIZES = (_LARGE, _SMALL)
_SIZE_WORD = {_SMALL: "small", _LARGE: "large"}


def _cases_by_kind() -> Iterator[Case]:
    """Yield the cases by kind. Each later kind has its own range of seeds, which keeps earlier cases."""
    seeds = itertools.count(1001)
    nothing_numbers = itertools.count()
    for size in _SIZES:
        for name, listed in LISTED.items():
            yield _listed_case(name, listed, size, next(seeds))
        for _ in range(_NOTHING // len(_SIZES)):
            name = f"nothing-{next(nothing_numbers)}"
            yield Case(name, effects=(), unlisted=(), seed=next(seeds), makers=())
        for name, off_list in OFF_LIST.items():
            yield _unlisted_case(name, off_list, size, next(seeds))
        # Each combination occurs twice at the same sizes: another seed draws another rig and other flights.
        for names in _SEVERAL:
            yield _combined_case(names, size, next(seeds))
    # Kinds that were added later: effects in another form, then further unlisted and listed effects.
    seeds = itertools.count(1501)
    for name, form in OTHER_FORMS.items():
        effects = ((form.effect, form.size),)
        yield Case(name, effects=effects, unlisted=(), seed=next(seeds), makers=(form.maker,))
    for size in _SIZES:
        for name, off_list in MORE_OFF_LIST.items():
            yield _unlisted_case(name, off_list, size, next(seeds))
    seeds = itertools.count(1601)
    for size in _SIZES:
        for name, listed in MORE_LISTED.items():
            yield _listed_case(name, listed, size, next(seeds))


def _listed_case(name: str, listed: ListedEffect, size: int, seed: int) -> Case:
    """Make a case with one listed effect."""
    value = (listed.large if size == _LARGE else listed.small) * _size_factor(seed)
    return Case(
        f"{name}-{_SIZE_WORD[size]}", effects=((name, value),), unlisted=(), seed=seed, makers=(listed.maker,)
    )


def _combined_case(names: Sequence[str], number: int, seed: int) -> Case:
    """Make a case with several listed effects of medium size; `number` only completes its name."""
    return Case(
        "+".join(names) + f"-{number}",
        effects=tuple((name, float(np.mean([LISTED[name].small, LISTED[name].large]))) for name in names),
        unlisted=(),
        seed=seed,
        makers=tuple(LISTED[name].maker for name in names),
    )


def _unlisted_case(name: str, off_list: UnlistedEffect, size: int, seed: int) -> Case:
    """Make a case with one unlisted effect."""
    return Case(
        f"off-{name}-{_SIZE_WORD[size]}",
        effects=(),
        unlisted=((name, off_list.size * _OFF_FACTOR[size]),),
        seed=seed,
        makers=(off_list.maker,),
    )


def _size_factor(seed: int) -> float:
    """Draw a factor by which the size of an effect differs from the small or large one in its list."""
    return float(Stream.SIZE.rng(seed).uniform(0.8, 1.3))


AnyCase = TypeVar("AnyCase", bound=Case)


def add_choice(parser: argparse.ArgumentParser) -> None:
    """Add to a `parser` the options that `chosen` reads, and the option for the folder of results."""
    parser.add_argument("only", nargs="*", help="names of cases, with wildcards; default: all")
    parser.add_argument("--first", type=int, help="only the first N, a fair sample")
    parser.add_argument("--folder", type=Path, default=Path("build/blind"), help="flights and results")


def matches(name: str, patterns: Sequence[str]) -> bool:
    """Return whether a `name` matches one of the `patterns`; True if there are none."""
    return not patterns or any(fnmatch.fnmatchcase(name, pattern) for pattern in patterns)


def chosen(cases: Iterable[AnyCase], options: argparse.Namespace) -> list[AnyCase]:
    """Return the `cases` that the parsed command line, `options`, selects, in their order."""
    return [case for case in cases if matches(case.name, options.only)][: options.first]
