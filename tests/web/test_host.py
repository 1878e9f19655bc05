"""The boards in WebAssembly send the bytes of the native build; the small host, the frames of heli_host."""

import tomllib
from pathlib import Path
from typing import Any

import heli_host
import numpy as np
import pytest
from heli_host.board.heli import Heli
from heli_host.board.law_flight import engage
from heli_host.board.rest_check import HoverTilt, RestAngles
from heli_host.board.samples import Samples
from heli_host.data.log.reader import read_log
from heli_host.errors import HeliError
from heli_host.fly.plan import load_plan
from heli_host.fly.runner import fly
from heli_host.link.session import Session
from heli_sim.model.effects.catalogue import catalogue
from heli_sim.model.multibody import MultibodyModel
from heli_sim.model.plant import Plant
from heli_sim.rig import load_rig
from heli_sim.sil.inprocess import InProcessTransport
from heli_sim.sil.options import parse_url
from heli_sim.sil.world import SilWorld
from heli_web.facts import law_facts, page_facts
from heli_web.plant import plant_module
from numpy.typing import NDArray

from tests.page.page_server import tired
from tests.web.recording import RecordedEngine, RecordedWorld, encoded, replayed, run_piece, setup_of

pytestmark = pytest.mark.slow

LINKS = {"quiet": "", "noise": "&flip=1e-5&seed=4", "interruption": "&unplug=8:1.5&stall=14:0.4"}


@pytest.fixture(scope="module")
def facts() -> dict[str, Any]:
    plan = load_plan("step")
    return page_facts([plan], {"step": tomllib.loads(plan.text)}, [load_rig("makki2024")])


@pytest.mark.parametrize("link", LINKS)
def test_small_host_sends_the_frames_of_heli_host(node: str, tmp_path: Path, link: str) -> None:
    world = SilWorld(parse_url(f"sil://?board=native{LINKS[link]}"))
    session = Session(InProcessTransport(world), session_number=1)
    recorded = RecordedEngine(session._engine)
    session.connect()
    heli = Heli(session)
    try:
        heli.take_off()
        heli.setpoint(travel_deg=10.0)
        heli.params.set("travel_kp", 0.5)
        heli.wait(10.0)
        heli.land()
    except HeliError:
        heli.wait(1.0)
    session.stop_now()
    heli.wait(0.5)
    heli.close()
    answer = run_piece(node, "engine", recorded.calls)
    assert answer["sent"] == recorded.sent
    counters = session.counters
    for name in (
        "frames_ok",
        "frames_bad",
        "frames_lost",
        "retries",
        "ticks_received",
        "ticks_lost",
        "setpoints_sent",
    ):
        assert answer["counters"][name] == getattr(counters, name), name
    by_host = ("link_lost", "cable")
    events = [[event.tick, event.kind, event.text] for event in session.events if event.kind not in by_host]
    assert answer["events"] == events


def flown(
    node: str, board: Path, facts: dict[str, Any], log: Path, law: str = "", **settings: Any
) -> dict[str, Any]:
    """Fly the plan step with the small host into a log."""
    given = {"board": str(board), "facts": facts, "settings": settings, "plans": ["step"], "log": str(log)}
    answer: dict[str, Any] = run_piece(node, "fly", given | {"law": law})
    return answer


def test_heli_host_reads_a_log_of_the_small_host(
    board: Path, node: str, facts: dict[str, Any], tmp_path: Path
) -> None:
    answer = flown(
        node, board, facts, tmp_path / "page.mcap", effect="rotor_lag", values={"rotor_lag.s": 0.12}
    )
    log = read_log(tmp_path / "page.mcap")
    assert answer["outcome"] == log.metadata["result"]["outcome"] == "completed"
    assert not log.notes
    assert log.ticks_lost == 0
    assert len(log.ticks) == int(log.metadata["result"]["ticks_logged"]) > 40_000
    assert np.all(np.diff(log.ticks["tick"].astype(np.int64)) == 1)
    assert log.metadata["plan"] == {"step": load_plan("step").text}
    assert [str(event["message"]) for event in log.events if event["name"] == "phase"] == [
        "take-off",
        "step",
        "landing",
    ]
    assert float(log.metadata["parameters"]["travel_kp"]) == log.parameters["travel_kp"]


def test_a_law_that_fails_is_taken_over_and_its_signals_are_named(
    board: Path, node: str, facts: dict[str, Any], tmp_path: Path
) -> None:
    program = tired().program
    offered = facts | {"laws": law_facts([program])}
    answer = flown(node, board, offered, tmp_path / "page.mcap", law="tired")
    with heli_host.connect("sil://?board=native") as heli:
        expected = fly(
            heli, "step", log_path=tmp_path / "host.mcap", on_taken_off=lambda: engage(heli, program)
        )
    page, host = read_log(tmp_path / "page.mcap"), read_log(tmp_path / "host.mcap")
    assert answer["outcome"] == page.metadata["result"]["outcome"] == expected.outcome
    assert answer["outcome"].startswith("law_taken_over: voltage_jump")
    assert page.law_signals == host.law_signals == {"signal_1": "wanted_pitch", "signal_2": "kp"}


def test_a_flight_of_the_small_host_is_the_flight_of_heli_host(
    board: Path, node: str, facts: dict[str, Any], tmp_path: Path
) -> None:
    # Commands leave some milliseconds apart. So the board looks at other moments whether a silent travel
    # encoder still counts, which turns the arm a little.
    flown(node, board, facts, tmp_path / "page.mcap")
    with heli_host.connect("sil://?board=native") as heli:
        heli.fly("step", log=tmp_path / "host.mcap")
    page, host = read_log(tmp_path / "page.mcap"), read_log(tmp_path / "host.mcap")
    rows = min(len(page.ticks), len(host.ticks))
    # heli_host records longer, because it compares the angles at rest.
    assert abs(len(page.ticks) - len(host.ticks)) < 1000
    for axis, bound_deg in (("elevation", 0.3), ("travel", 2.0)):
        difference = page.ticks[f"{axis}_rad"][:rows] - host.ticks[f"{axis}_rad"][:rows]
        assert np.degrees(np.sqrt(np.mean(difference**2))) < bound_deg


def angles_after_landings() -> list[tuple[RestAngles, NDArray[np.float64], NDArray[np.float64]]]:
    """Angles at rest, shifted, swinging, held or floating; drawn by chance."""
    random, cases = np.random.default_rng(20), []
    for _ in range(100):
        before = RestAngles(-25.0, float(random.choice([0.0, 1.2, np.nan])), 0.1, HoverTilt(0.1))
        before.hover.mean_deg = float(random.choice([np.nan, 0.0, -8.0, 5.0]))
        tick = np.arange(int(random.choice([100, 1000, 3000, 16_000])))
        decay = np.exp(-tick * 1e-3 / random.choice([0.5, 2.0, 1e3]))
        shift_deg, swing_deg = (
            random.choice([0.0, *random.uniform(-9.0, 9.0, 3)]),
            random.choice([0.0, 0.05, 3.0]),
        )
        pitch_deg = shift_deg + swing_deg * decay * np.cos(2e-3 * tick)
        sink_deg = random.choice([0.0, 0.7, 1.3]) * np.exp(-tick * 1e-3)
        cases.append((before, -25.0 + random.choice([0.0, 1.2, -1.4]) + sink_deg, pitch_deg))
    return cases


def test_small_host_compares_angles_at_rest_like_heli_host(node: str) -> None:
    given, expected = [], []
    for before, elevation_deg, pitch_deg in angles_after_landings():
        columns: dict[str, Any] = {field: np.zeros(len(pitch_deg)) for field in Samples.__dataclass_fields__}
        columns |= {"elevation_rad": np.radians(elevation_deg), "pitch_rad": np.radians(pitch_deg)}
        expected.append(before.shift_after(Samples(**columns)))
        start = [value if np.isfinite(value) else None for value in (before.pitch_deg, before.hover.mean_deg)]
        given.append([before.elevation_deg, *start, elevation_deg.tolist(), pitch_deg.tolist()])
    assert None in expected
    assert "" in expected
    assert len(set(expected)) > 10
    assert run_piece(node, "rest", given) == expected


def test_a_seed_draws_the_numbers_of_numpy(node: str) -> None:
    seeds = [1, 2, 7, 12345, 2**32 - 1]
    drawn = [
        [*np.random.default_rng(seed).uniform(-5e4, 5e4, 3), np.random.default_rng(seed).integers(2**31 - 2)]
        for seed in seeds
    ]
    assert run_piece(node, "random", seeds) == drawn


STEPS = 40


def take_off_and_turn(world: SilWorld) -> None:
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
    take_off_and_turn(world)
    repeated = replayed(node, board, setup, recorded.calls)
    assert len(recorded.sent) > 20_000
    assert repeated["sent"] == bytes(recorded.sent)
    assert repeated["tick"] == world.tick


def test_a_delay_of_the_voltages_acts_as_in_the_native_build(board: Path, node: str) -> None:
    world = SilWorld(parse_url("sil://?board=native&effect=input_delay=0.0174"))
    recorded, setup = RecordedWorld(world), setup_of(world)
    take_off_and_turn(world)
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
