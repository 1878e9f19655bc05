"""The boards in WebAssembly send the bytes of the native build, and a plant computes its numbers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from heli_host.board.heli import Heli
from heli_host.errors import HeliError
from heli_host.link.session import Session
from heli_sim.model.effects.catalogue import catalogue
from heli_sim.model.multibody import MultibodyModel
from heli_sim.model.plant import Plant
from heli_sim.rig import load_rig
from heli_sim.sil.inprocess import InProcessTransport
from heli_sim.sil.options import parse_url
from heli_sim.sil.world import SilWorld
from heli_web.plant import plant_module

from tests.web.recording import RecordedWorld, encoded, replayed, run_piece, setup_of

STEPS = 40

pytestmark = pytest.mark.slow


def fly(world: SilWorld) -> None:
    """Take off, turn, land; whatever a fault makes of that."""
    session = Session(InProcessTransport(world), session_number=1)
    session.connect()
    heli = Heli(session)
    try:
        heli.take_off()
        heli.setpoint(travel_deg=15.0)
        heli.wait(4.0)
        heli.land()
    except HeliError:
        heli.wait(2.0)
    heli.close()


@pytest.mark.parametrize("board_name", ["native", "due"])
@pytest.mark.parametrize(
    "fault", ["effect=rotor_lag=0.12", "encoder_out=pitch:5", "unplug=4:0.5", "supply_out=6"]
)
def test_both_boards_send_the_bytes_of_the_native_build(
    board: Path, node: str, board_name: str, fault: str
) -> None:
    world = SilWorld(parse_url(f"sil://?board={board_name}&{fault}"))
    recorded, setup = RecordedWorld(world), setup_of(world)
    fly(world)
    repeated = replayed(node, board, setup, recorded.calls)
    assert len(recorded.sent) > 20_000
    assert repeated["sent"] == bytes(recorded.sent)
    assert repeated["tick"] == world.tick


def test_a_delay_of_the_voltages_acts_as_in_the_native_build(board: Path, node: str) -> None:
    world = SilWorld(parse_url("sil://?board=native&effect=input_delay=0.0174"))
    recorded, setup = RecordedWorld(world), setup_of(world)
    fly(world)
    assert setup["delay_s"] == 0.0174
    assert replayed(node, board, setup, recorded.calls)["sent"] == bytes(recorded.sent)


def test_each_effect_of_the_catalogue_steps_as_in_casadi(board: Path, node: str) -> None:
    random, rig, cases, expected = np.random.default_rng(1), load_rig("makki2024"), [], []
    for kind in catalogue().values():
        if kind.delay:
            continue  # a delay is the line's before the plant, see above
        plant = Plant(MultibodyModel((kind.make(kind.typical),)), rig)
        state, steps = plant.rest_state(), []
        inputs = random.uniform(0.0, 4.0, (STEPS, 2))
        state[:6] += random.normal(0.0, 0.1, 6)
        first = state.tolist()
        for volts_V in inputs:
            state, angles = plant.step(state, volts_V)
            steps.append([*state, *angles])
        module = encoded(plant_module(plant.function))
        cases.append(
            {
                "plant": module,
                "state": first,
                "parameters": plant.parameters.tolist(),
                "volts": inputs.tolist(),
            }
        )
        expected.append(np.array(steps))
    answers = run_piece(node, "plants", {"board": str(board), "cases": cases})
    assert len(answers) == len(expected) > 40
    for answer, wanted in zip(answers, expected, strict=True):
        np.testing.assert_allclose(np.array(answer), wanted, rtol=1e-9, atol=1e-12)
