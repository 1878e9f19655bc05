"""Flights to distort: of simulated rigs with their effects, and the measured ones where they are."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Final

from heli_host.data.flight import Flight
from heli_host.data.log.reader import read_flight
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import parse_effects
from heli_sim.rig import Rig, load_rig

from tests.identify.made import flown_by_plan, perturbed

DATA: Final = Path(__file__).resolve().parents[3] / "shared" / "data" / "measured"
EFFECTS: Final = (
    (),
    ("rotor_lag=0.12",),
    ("rotor_lag=0.1", "gyroscopic_torque=0.03"),
    ("rotor_lag=0.08", "cable_spring.travel=0.03"),
)
SIMULATED: Final = len(EFFECTS)


@functools.cache
def simulated(number: int) -> tuple[Flight, Rig]:
    """Fly a rig drawn from the tolerances of makki2024, with the effects of `number`; and what a user knows
    of it, the rig file.
    """
    known = load_rig("makki2024")
    model = MultibodyModel(parse_effects(EFFECTS[number], ()))
    return flown_by_plan(perturbed(number, known), number, "identify", model), known


def measured() -> list[Path]:
    """Files of the measured flights; none where they are not."""
    return sorted(DATA.glob("*.csv.gz"))


@functools.cache
def measured_flight(path: Path) -> tuple[Flight, Rig]:
    """A measured flight, and its rig file."""
    return read_flight(path), load_rig("quanser-course")
