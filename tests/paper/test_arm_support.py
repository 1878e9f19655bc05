"""An arm whose masses balance above its table is held there while the motors are off, and no other arm is."""

from __future__ import annotations

import numpy as np
import pytest
from heli_host.board.heli import Heli
from heli_host.link.session import Session
from heli_sim.model import Model, MultibodyModel, PaperModel
from heli_sim.model.plant import Plant
from heli_sim.rig import load_rig
from heli_sim.sil.inprocess import InProcessTransport
from heli_sim.sil.options import SilOptions
from heli_sim.sil.world import SilWorld

pytestmark = pytest.mark.slow

RIG = load_rig("makki2024")
TABLE_RAD = np.deg2rad(-25.0)


def world_of(model: Model) -> SilWorld:
    return SilWorld(SilOptions(), Plant(model, RIG))


def test_table_2_as_point_masses_balances_at_minus_22_degrees() -> None:
    plant = Plant(MultibodyModel(), RIG.replace(friction_elevation=2.0))
    ticks, still = 10_000, np.zeros(3)
    seconds = plant.function.mapaccum(ticks)
    state = plant.rest_state()
    for _ in range(4):
        after, _ = seconds(state, np.zeros((2, ticks)), still, plant.parameters)
        state = np.asarray(after)[:, -1]
    assert np.rad2deg(state[0]) == pytest.approx(-22.08, abs=0.01)


def test_the_arm_of_the_multibody_rig_stays_on_its_table_until_somebody_flies_it() -> None:
    world = world_of(MultibodyModel())
    session = Session(InProcessTransport(world))
    session.connect()
    with Heli(session) as heli:
        heli.wait(8.0)
        assert world.state[0] == TABLE_RAD
        heli.take_off()
        assert heli.latest.elevation_deg == pytest.approx(0.0, abs=2.5)
        heli.land()
        heli.wait(8.0)
        assert world.state[0] == pytest.approx(TABLE_RAD, abs=np.deg2rad(0.3))
        heli.take_off()


def test_the_hand_lets_go_within_milliseconds_of_the_first_voltage() -> None:
    world = world_of(MultibodyModel())
    session = Session(InProcessTransport(world))
    session.connect()
    with Heli(session) as heli:
        heli.arm()
        assert world.native.locked == [True, False, False]
        heli.control()
        heli.setpoint(elevation_deg=0.0)
        heli.wait(0.2)
        assert world.native.locked == [False, False, False]


def test_an_arm_that_rests_by_itself_and_pins_of_others_are_left_alone() -> None:
    heavy = world_of(PaperModel())
    heavy.advance(100)
    assert heavy.native.locked == [False, False, False]
    locked = world_of(MultibodyModel())
    locked.native.locked = [False, True, True]
    locked.advance(2000)
    assert locked.native.locked == [False, True, True]
    assert locked.state[0] > TABLE_RAD + np.deg2rad(1.0)
