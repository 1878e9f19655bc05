"""Simulated flights with known disturbances, which are stored so that all tests share them."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from heli_host.data.flight import Flight
from heli_lab.fit.records import Record, prepare
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import parse_effects
from heli_sim.rig import load_rig

from tests.identify import made
from tests.identify.made import flown, thinned
from tests.running.kept import FLOWN, KEPT

GUST_Nm = {"elevation": 0.012, "pitch": 0.004, "travel": 0.008}
RIG = load_rig("makki2024")
TRUE_RIG = RIG.replace(thrust_gain=0.62, friction_travel=0.05)
SECONDS = 34.0
MADE_BY = (Path(__file__), Path(made.__file__))


def _flown(share: float = 1.0, *further: str) -> Flight:
    """Fly with a `share` of the disturbances `GUST_Nm`, and with `further` effects."""
    disturbances = parse_effects([f"random_torque.{axis}={share * size}" for axis, size in GUST_Nm.items()])
    return thinned(flown(TRUE_RIG, 21, SECONDS, MultibodyModel((*disturbances, *parse_effects(further)))), 2)


@cache
def flight_with_disturbances() -> Record:
    """Return a flight of `TRUE_RIG` with disturbances that are correlated over half a second."""
    flight = KEPT(f"windy {GUST_Nm} {SECONDS}", _flown, made_by=MADE_BY, rooms=FLOWN)
    return prepare(flight, RIG, "windy")


@cache
def flown_with(effect: str) -> Record:
    """Return a flight of `TRUE_RIG` with an effect, and with a third of those disturbances."""
    flight = KEPT(
        f"{effect} {GUST_Nm} {SECONDS}", lambda: _flown(1 / 3, effect), made_by=MADE_BY, rooms=FLOWN
    )
    return prepare(flight, RIG, effect)
