"""Flights that the loggers of the zoo record: few rigs, flown by several controllers."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from heli_host.data.flight import Flight
from heli_sim.rig import Rig, load_rig

from heli_benchmark.effects.listed import RotorLag
from heli_benchmark.flights import Route, flown, plan, tracked

_FLIGHT_CODE: Final = "flight code"
_COLUMNS: Final = ("t_s", "front_V", "back_V", "elevation_rad", "pitch_rad", "travel_rad")


@dataclass(frozen=True)
class FlightRecipe:
    """A rig and the controller that flies it."""

    rig_name: str  # Rig file, from whose tolerances the rig is drawn
    controller: str  # The project's flight code, which starts on the table, or a controller of `flights`
    seed: int
    rotor_lag_s: float  # Lag of the rotors, which real rigs have; 0 for none

    @property
    def starts_on_table(self) -> bool:
        """Whether the flight starts at rest on the table; otherwise it starts level, in the air."""
        return self.controller == _FLIGHT_CODE


RECIPES: Final = (
    FlightRecipe("makki2024", controller=_FLIGHT_CODE, seed=501, rotor_lag_s=0.07),
    FlightRecipe("quanser-course", controller="cascade", seed=502, rotor_lag_s=0.06),
    FlightRecipe("makki2024", controller="state_feedback", seed=503, rotor_lag_s=0.09),
    FlightRecipe("makki2024", controller=_FLIGHT_CODE, seed=504, rotor_lag_s=0.0),
    FlightRecipe("quanser-course", controller="soft", seed=505, rotor_lag_s=0.1),
)
_DURATION_S: Final = 42.0


def fly(recipe: FlightRecipe) -> Flight:
    """Fly a recipe."""
    nominal = load_rig(recipe.rig_name)
    rig = _drawn_rig(nominal, recipe.seed)
    rng = np.random.default_rng([recipe.seed, 1])
    hidden = (
        [RotorLag(recipe.rotor_lag_s, np.random.default_rng([recipe.seed, 3]))] if recipe.rotor_lag_s else []
    )
    for effect in hidden:
        effect.flight_rng = np.random.default_rng([recipe.seed, 4])
    if recipe.starts_on_table:
        return flown(rig, hidden, plan(f"zoo-{recipe.seed}", _DURATION_S, rng), recipe.seed)
    route = Route(
        _DURATION_S,
        travel_deg=40.0,
        elevation_deg=8.0,
        sines=bool(recipe.seed % 2),
        excitation_V=0.04 * nominal["supply"].value,
    )
    return tracked(rig, nominal, hidden, route, controller=recipe.controller, rate_Hz=500, rng=rng)


def kept_flight(recipe: FlightRecipe, folder: Path) -> Flight:
    """Return the flight of a recipe from the `folder`; fly it if it is not there."""
    path = folder / f"{recipe.rig_name}-{recipe.controller.replace(' ', '-')}-{recipe.seed}.npz"
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        flight = fly(recipe)
        # Renamed when complete, so that an interrupted run leaves no partial flight.
        unfinished = path.with_suffix(f".{os.getpid()}.npz")
        np.savez_compressed(unfinished, **{name: getattr(flight, name) for name in _COLUMNS})
        unfinished.rename(path)
    with np.load(path) as columns:
        return Flight(*(columns[name] for name in _COLUMNS))


def _drawn_rig(nominal: Rig, seed: int) -> Rig:
    """Draw a rig of the type of `nominal`: thrust within 12 %, friction from 0.6 to 1.6 times."""
    rng = np.random.default_rng([seed, 2])
    factors = {"thrust_gain": rng.uniform(0.88, 1.12)}
    for axis in ("elevation", "pitch", "travel"):
        factors[f"friction_{axis}"] = 1.6 ** rng.uniform(-1.0, 1.0)
    return nominal.replace(**{name: factor * nominal[name].value for name, factor in factors.items()})
