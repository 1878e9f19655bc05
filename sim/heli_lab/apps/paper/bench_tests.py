"""Bench tests of section IV of the paper: locked axes, initial angles and voltages.

The paper states which axes it locked and from which angles it released pitch, but neither voltages nor
durations. They are chosen here so that the free axes move far without reaching a stop.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from heli_host.data.flight import Flight
from heli_sim.model import MultibodyModel
from heli_sim.model.linear import trim
from heli_sim.rig import Rig
from heli_sim.rig.encoders import count_rad

from heli_lab.errors import IdentifyError
from heli_lab.fit.identify.record import Record

TABLE_DEG: Final = -25.0
"""Elevation of the arm on its table [deg]."""
_HOVER_V: Final = 1.7
"""Voltage of each motor at which the rig of Table 2 hovers [V]."""
_HOVER_TOLERANCE_V: Final = 0.15
"""Largest deviation of the hover voltage [V]; beyond it the elevation steps end at a stop or on the table."""


@dataclass(frozen=True)
class BenchTest:
    """Experiment on a rig with some axes locked."""

    name: str  # Name in lists and records
    panel: str  # Figure and panel of the paper, such as ``16 (a)``
    locked: tuple[bool, bool, bool]  # Whether elevation, pitch and travel are locked
    elevation_deg: float = 0.0  # Initial elevation; all axes are locked until the test starts
    pitch_deg: float = 0.0  # Initial pitch
    front_V: float = 0.0  # front_V, back_V: Voltages during the test; if both are 0, the motors are off
    back_V: float = 0.0
    duration_s: float = 15.0  # Duration of the test


PITCH_RELEASES: Final = (
    BenchTest("pitch released from 13 deg", "16 (a)", (True, False, True), pitch_deg=13.0),
    BenchTest("pitch released from 8.8 deg", "16 (b)", (True, False, True), pitch_deg=8.8),
)
ELEVATION_STEPS: Final = (
    BenchTest("elevation, 1.5 V each", "17 (a)", (False, True, True), TABLE_DEG, 0.0, 1.5, 1.5, 30.0),
    BenchTest("elevation, 1.7 V each", "17 (b)", (False, True, True), TABLE_DEG, 0.0, 1.7, 1.7, 30.0),
)
TRAVEL_STEPS: Final = (
    BenchTest("travel, 1.85 V and 1.55 V", "18 (a)", (True, False, False), 0.0, 0.0, 1.85, 1.55, 7.5),
    BenchTest("travel, 2.1 V and 1.6 V", "18 (b)", (True, False, False), 0.0, 0.0, 2.1, 1.6, 5.5),
)

THRUST_V: Final[tuple[float, ...]] = (0.5, *(float(volts) for volts in range(1, 11)))
"""Voltages of the thrust curve in Fig. 15 [V]."""


def check_rig(rig: Rig) -> None:
    """Check that the voltages of these tests suit a rig."""
    hover_V = float(np.mean(trim(MultibodyModel(), rig).volts_V))
    if abs(hover_V - _HOVER_V) > _HOVER_TOLERANCE_V:
        raise IdentifyError(
            f"the paper's tests and flights need a rig that hovers at {_HOVER_V:g} V per motor, but rig "
            f"'{rig.name}' hovers at {hover_V:.2f} V",
            "give makki2024 or a similar rig",
        )


def record_of(test: BenchTest, flight: Flight, rig: Rig) -> Record:
    """Convert the flight of a bench test to a record for fitting."""
    angles_deg = np.rad2deg(flight.angles_rad)
    elevation_deg, pitch_deg, travel_deg = (angles_deg[:, axis] for axis in range(3))
    elevation_locked, pitch_locked, travel_locked = test.locked
    reaches_stop = (
        (not elevation_locked and elevation_deg.max() >= rig["elevation_max"].value)
        or (not pitch_locked and np.abs(pitch_deg).max() >= rig["pitch_max"].value)
        or (not travel_locked and np.abs(travel_deg).max() >= rig["travel_max"].value)
    )
    if reaches_stop:
        raise IdentifyError(
            f"{test.name}: rig '{rig.name}' reaches a stop; its parameters are too far from Table 2",
            "give makki2024 or a similar rig",
        )
    if flight.gaps.size:
        raise IdentifyError(f"{test.name}: rows are missing", "run the command again")
    return Record(
        label=test.name,
        t_s=flight.t_s,
        angles_rad=flight.angles_rad,
        voltages_V=flight.voltages_V,
        step_s=flight.step_s,
        count_rad=count_rad(rig),
        segments=((0, len(flight)),),
        cuts=(),
    )
