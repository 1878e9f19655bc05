"""The simulated board behaves like a board: power stage, reset, flash, stop input, locked axes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from heli_host.declaration import (
    MessageId,
    Param,
    ParamSetMessage,
    ParamsReadMessage,
    ParamsSaveMessage,
    ParamsSource,
    Reset,
    Result,
)
from heli_host.link.telemetry import TelemetryDecoder
from heli_sim import _native
from heli_sim.model import PaperModel
from heli_sim.plant import Plant
from heli_sim.rig import load_rig
from heli_sim.sil.options import SilOptions
from heli_sim.sil.world import SilWorld

from tests.channels.groups import COUNTS
from tests.sil.harness import Host, world

pytestmark = pytest.mark.medium


@pytest.mark.parametrize(
    ("asked_V", "acts_V"),
    [
        (0.0, 0.0),
        (0.6, 0.0),  # 5 % duty: swallowed by the switching delays
        (0.8, 0.8),
        (1.7, 1.7),
        (10.0, 10.0),
    ],
)
def test_drivers_swallow_duties_below_their_dead_band(asked_V: float, acts_V: float) -> None:
    host = Host()
    host.drive(asked_V, 1.2)
    # Steps of the duty are 12 V / 2100.
    assert host.world.native.volts_V == pytest.approx([acts_V, 1.2], abs=0.006)


def test_a_duty_near_one_is_simply_on() -> None:
    rig = load_rig("makki2024").replace(driver_dead_band=0.2)
    host = Host(SilWorld(SilOptions(), Plant(PaperModel(), rig)))
    host.drive(9.8, 9.4)
    assert host.world.native.volts_V == pytest.approx([12.0, 9.4], abs=0.006)


def test_the_supply_of_the_rig_scales_what_acts() -> None:
    rig = load_rig("makki2024").replace(supply=6.0)
    host = Host(SilWorld(SilOptions(), Plant(PaperModel(), rig)))
    host.hello()
    # The board starts with the supply of its rig; this one is set to another.
    assert host.order(ParamSetMessage, Param.SUPPLY_V, 12.0).result == Result.OK
    host.drive(3.0, 2.0)
    assert host.world.native.volts_V == pytest.approx([1.5, 1.0], abs=0.003)


def test_the_rest_position_is_the_table_and_encoders_start_anywhere() -> None:
    counts = [world(seed=str(seed)).native.counts for seed in (1, 2)]
    assert counts[0] != counts[1]
    assert world(seed="1").native.counts == counts[0]
    assert world().state[:3] == pytest.approx([np.deg2rad(-25.0), 0.0, 0.0])


def test_a_reset_in_flight_stops_the_motors_at_once_and_the_board_is_back_after_205_ms() -> None:
    host = Host()
    host.drive(1.9, 1.9)
    assert host.world.native.volts_V == pytest.approx([1.9, 1.9], abs=0.006)
    before = host.hello()
    host.world.reset_board()
    assert host.world.board.sim.in_reset
    host.wait(1)
    assert host.world.native.volts_V == [0.0, 0.0]
    host.wait(203)
    assert host.world.board.sim.in_reset
    host.wait(2)
    assert not host.world.board.sim.in_reset
    welcome = Host(host.world).hello()
    assert welcome.reset == Reset.USER
    assert welcome.boot_id != before.boot_id


def test_bytes_sent_to_a_board_in_reset_are_not_heard() -> None:
    host = Host()
    host.world.reset_board()
    with pytest.raises(AssertionError, match="no answer"):
        host.hello()
    host.wait(150)
    assert host.hello().reset == Reset.USER


def test_encoder_counters_restart_at_a_reset() -> None:
    pushed = world()
    board = pushed.board.sim
    assert isinstance(board, _native.NativeBoard)
    pushed.state = np.array([0.1, 0.05, 0.3, 0, 0, 0])
    pushed.native.locked = [True] * 3
    pushed.advance(1)
    assert board.counts == pushed.native.counts
    pushed.reset_board()
    pushed.advance(300)
    assert board.counts == [0, 0, 0]


def test_the_stop_input_cuts_the_motors_by_itself() -> None:
    host = Host()
    host.drive(1.9, 1.9)
    assert host.world.native.volts_V[0] > 0.0
    host.world.board.sim.set_stop(True)
    host.wait(1)
    assert host.world.native.volts_V == [0.0, 0.0]


def test_a_pinned_axis_does_not_move_while_the_others_fly() -> None:
    host = Host()
    host.drive(2.6, 2.1)
    host.world.native.locked = [False, True, False]
    host.wait(450)
    state = host.world.state
    assert (state[1], state[4]) == (0.0, 0.0)
    assert state[0] > np.deg2rad(-24.0)


def test_what_the_board_reports_are_the_true_angles_to_one_count() -> None:
    host = Host()
    host.hello()
    angles_rad = np.array([0.2, -0.3, 1.1])
    host.world.state = np.concatenate([angles_rad, np.zeros(3)])
    host.world.native.locked = [True] * 3
    host.wait(100)
    host.frames.clear()
    host.wait(100)
    batches = [frame.payload for frame in host.frames if frame.id == MessageId.TELEMETRY]
    raw = TelemetryDecoder().decode(batches).raw[:, COUNTS]
    assert np.abs(raw - angles_rad * 4096 / (2 * np.pi)).max() <= 1.0


def test_saved_parameters_survive_in_the_flash_file(tmp_path: Path) -> None:
    flash = tmp_path / "flash.bin"
    host = Host(world(flash=str(flash)))
    assert host.hello().params_source == ParamsSource.DEFAULTS
    assert host.order(ParamSetMessage, Param.HOVER_V, 1.25).result == Result.OK
    assert host.order(ParamsSaveMessage).result == Result.OK
    again = Host(world(flash=str(flash)))
    assert again.hello().params_source == ParamsSource.STORED
    values = again.ask(ParamsReadMessage, Param.HOVER_V)
    assert np.frombuffer(values[3:7], np.float32)[0] == 1.25


def test_a_flash_file_of_another_length_is_refused(tmp_path: Path) -> None:
    flash = tmp_path / "flash.bin"
    flash.write_bytes(b"short")
    with pytest.raises(Exception, match="delete it"):
        world(flash=str(flash))


def test_flash_can_be_taken_out_and_put_back() -> None:
    first, second = Host(), Host()
    first.hello()
    first.order(ParamSetMessage, Param.HOVER_V, 1.25)
    first.order(ParamsSaveMessage)
    board, other = first.world.board.sim, second.world.board.sim
    assert isinstance(board, _native.NativeBoard)
    assert isinstance(other, _native.NativeBoard)
    other.flash = board.flash
    assert second.hello().params_source == ParamsSource.STORED
    with pytest.raises(ValueError, match="flash holds"):
        other.flash = b""


def test_a_board_that_counts_edges_agrees_with_the_encoders_every_millisecond() -> None:
    plant = Plant(PaperModel(), load_rig("makki2024"))
    swinging = [0.3, 0.6, 0.1, 0.2, -1.0, 0.8]
    board = _native.NativeBoard(from_edges=True)
    native = _native.World(
        plant.native_step(),
        swinging,
        plant.parameters.tolist(),
        supply_V=12.0,
        dead_band=0.06,
        counts_per_rad=[4096 / (2 * np.pi)] * 3,
        offset_count=[123.4, -55.5, 0.9],
        board=board,
    )
    start = np.array(native.counts)
    moved = 0
    for _ in range(3000):
        native.advance(1, b"")
        turned = np.array(native.counts) - start
        assert board.counts == turned.tolist()
        moved = max(moved, int(np.abs(turned).max()))
    assert moved > 300
