"""The ELF on the emulated Due flies like the flight code on this machine, and a world is good for either."""

from __future__ import annotations

import os
from pathlib import Path

import heli_host
import numpy as np
import pytest
from due_emulator import read_image
from heli_host.board.heli import Heli
from heli_host.data.log.reader import read_log
from heli_host.data.log.summary import FlightSummary
from heli_host.declaration import (
    Param,
    ParamSetMessage,
    ParamsReadMessage,
    ParamsSaveMessage,
    ParamsSource,
    Reset,
    Result,
    State,
)
from heli_host.errors import LinkLost
from heli_host.fly.runner import fly
from heli_host.link.events import BOARD_RESTARTED
from heli_sim import _native
from heli_sim.due import firmware
from heli_sim.due.errors import BoardStopped, FirmwareError
from heli_sim.errors import OptionError, SimError
from heli_sim.rig import load_rig
from heli_sim.sil.boards import EmulatedDue, choose
from heli_sim.sil.inprocess import InProcessTransport
from heli_sim.sil.options import parse_options
from heli_sim.sil.world import SilWorld

from tests.running.long import samples
from tests.sil.harness import Host, world

pytestmark = pytest.mark.emulated

Board = dict[str, str]
# Steps of the duty over its whole range, as in firmware/core/board.hpp.
FULL_DUTY = 2100
COUNTS = ("elevation_count", "pitch_count", "travel_count")
POLL = "_ZN4heli4Core4pollEv"
BRANCH_TO_SELF = b"\xfe\xe7"


def url(options: Board, **more: str) -> str:
    return "sil://?" + "&".join(f"{key}={value}" for key, value in {**options, **more}.items())


def world_of(heli: Heli) -> SilWorld:
    transport = heli.session.transport
    assert isinstance(transport, InProcessTransport)
    return transport.world


def due_of(world: SilWorld) -> EmulatedDue:
    assert isinstance(world.board, EmulatedDue)
    return world.board


def flown(options: Board, plan: str, log: Path, **more: str) -> FlightSummary:
    with heli_host.connect(url(options, **more)) as heli:
        return fly(heli, plan, log_path=log)


@pytest.mark.parametrize(("plan", "seed"), [("step", "3"), ("sine", "2"), ("identify", "2")][: samples(3, 1)])
def test_the_same_flight_on_both_boards_agrees_tick_by_tick(
    plan: str, seed: str, elf: Path, tmp_path: Path
) -> None:
    boards = {"native": {"board": "native"}, "due": {"board": "due", "elf": str(elf)}}
    logs = {}
    for name, options in boards.items():
        path = tmp_path / f"{name}.mcap"
        assert flown(options, plan, path, seed=seed).completed
        logs[name] = read_log(path).ticks
    native, due = logs["native"], logs["due"]
    assert len(native) > 20_000
    assert np.array_equal(native["tick"], due["tick"])
    for count in COUNTS:
        assert np.array_equal(native[count], due[count]), count
    step_V = load_rig("makki2024")["supply"].value / FULL_DUTY
    for motor in ("front_volt", "back_volt"):
        # The log has millivolts.
        assert np.abs(native[motor] - due[motor]).max() <= step_V + 1e-3, motor
    assert np.array_equal(native["state"], due["state"])


def test_the_same_seed_gives_the_same_log_from_either_board(board: Board, tmp_path: Path) -> None:
    logs = [tmp_path / "a.mcap", tmp_path / "b.mcap"]
    for log in logs:
        assert flown(board, "hover", log, seed="7", flip="1e-6", drop="1e-5").completed
    assert logs[0].read_bytes() == logs[1].read_bytes()


def test_a_line_with_faults_is_flown_over_and_its_faults_are_counted(board: Board, tmp_path: Path) -> None:
    summary = flown(board, "hover", tmp_path / "f.mcap", flip="1e-5", drop="1e-4", stall="10:0.2")
    assert summary.completed
    assert summary.link["frames_bad"] > 0
    assert summary.link["board_frames_bad"] > 0
    assert summary.ticks_lost > 0


def test_a_pulled_cable_resets_no_board_and_the_session_goes_on(board: Board) -> None:
    with heli_host.connect(url(board, unplug="3:0.4")) as heli:
        boots = world_of(heli).board.sim.boots
        heli.wait(5.0)
        assert heli.counters.reconnects == 1
        assert heli.counters.restarts == 0
        assert world_of(heli).board.sim.boots == boots


def test_a_hung_idle_loop_is_reset_and_the_session_gets_the_reason(elf: Path) -> None:
    with heli_host.connect(url({"board": "due", "elf": str(elf)})) as heli:
        due = due_of(world_of(heli)).sim.due
        address = read_image(elf).address(POLL)
        instruction = due.peek(address, 2)
        resets = due.resets
        due.poke(address, BRANCH_TO_SELF)
        for _ in range(50):
            heli.session.transport.read(0.01)
            if due.resets > resets:
                break
        assert due.resets == resets + 1
        due.poke(address, instruction)
        with pytest.raises(LinkLost, match="restarted"):
            heli.wait(1.0)
        assert heli.counters.restarts == 1
        (restart,) = [event for event in heli.session.events if event.kind == BOARD_RESTARTED]
        assert "watchdog" in restart.text
        heli.wait(0.1)
        # The milliseconds follow the program's tick again: it flies.
        heli.take_off(0.0)
        heli.land()
        assert heli.state is State.IDLE
        assert heli.session.status().overruns == 0


def test_a_reset_in_flight_stops_the_motors_and_the_board_is_back_after_205_ms(board: Board) -> None:
    host = Host(world(**board))
    host.drive(1.9, 1.9)
    host.world.reset_board()
    host.wait(1)
    assert host.world.native.volts_V == [0.0, 0.0]
    assert host.world.board.sim.in_reset
    host.wait(220)
    assert not host.world.board.sim.in_reset
    assert Host(host.world).hello().reset == Reset.USER


def test_the_stop_switch_cuts_the_motors_by_itself(board: Board) -> None:
    host = Host(world(**board))
    host.drive(1.9, 1.9)
    assert host.world.native.volts_V == pytest.approx([1.9, 1.9], abs=0.006)
    host.world.board.sim.set_stop(True)
    host.wait(1)
    assert host.world.native.volts_V == [0.0, 0.0]


def test_parameters_saved_on_one_board_are_found_by_the_other(elf: Path, tmp_path: Path) -> None:
    boards = {"native": {"board": "native"}, "due": {"board": "due", "elf": str(elf)}}
    for first, second in (("due", "native"), ("native", "due"), ("due", "due")):
        flash = str(tmp_path / f"{first}-{second}.bin")
        host = Host(world(**boards[first], flash=flash))
        assert host.hello().params_source == ParamsSource.DEFAULTS
        assert host.order(ParamSetMessage, Param.HOVER_V, 1.25).result == Result.OK
        assert host.order(ParamsSaveMessage).result == Result.OK
        host.wait(50)
        again = Host(world(**boards[second], flash=flash))
        assert again.hello().params_source == ParamsSource.STORED
        values = again.ask(ParamsReadMessage, Param.HOVER_V)
        assert np.frombuffer(values[3:7], np.float32)[0] == 1.25


def test_a_flash_file_of_another_length_is_refused(board: Board, tmp_path: Path) -> None:
    flash = tmp_path / "flash.bin"
    flash.write_bytes(b"short")
    with pytest.raises((SimError, RuntimeError), match="delete it"):
        world(**board, flash=str(flash))


def test_what_strict_mode_finds_ends_the_simulation_in_one_line(elf: Path) -> None:
    host = Host(world(board="due", elf=str(elf)))
    host.hello()
    due = due_of(host.world).sim.due
    # Load the word at 0x40000000, a peripheral that is not modelled: ldr r0, [r0] after movs, lsls.
    due.poke(read_image(elf).address(POLL), bytes.fromhex("4ff080400068"))
    with pytest.raises(BoardStopped, match="HSMCI") as stopped:
        host.wait(10)
    assert "\n" not in str(stopped.value)


class TestWhichElf:
    def test_firmware_for_another_link_is_refused_with_both_versions(
        self, elf: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        identity = _native.identity()
        monkeypatch.setattr(_native, "identity", lambda: (0x1234, 9, 8, "7.6.5"))
        with pytest.raises(FirmwareError) as refused:
            choose("due", str(elf))
        message = str(refused.value)
        assert f"link version {identity[1]}.{identity[2]} ({identity[0]:08x})" in message
        assert "this host has 9.8 (00001234)" in message
        assert "make firmware" in message

    def test_a_program_that_says_nothing_is_refused(self, tmp_path: Path) -> None:
        # Stack pointer, reset handler, and a branch to itself.
        quiet = tmp_path / "quiet.bin"
        quiet.write_bytes((0x20088000).to_bytes(4, "little") + (0x00080101).to_bytes(4, "little"))
        quiet.write_bytes(quiet.read_bytes().ljust(0x100, b"\0") + BRANCH_TO_SELF * 2)
        with pytest.raises(FirmwareError, match="does not answer"):
            choose("due", str(quiet))

    def test_a_missing_file_is_refused(self) -> None:
        with pytest.raises(FirmwareError, match="nowhere"):
            choose("due", "nowhere.elf")

    def test_without_any_auto_is_native_and_due_says_how_to_get_one(
        self, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setattr(firmware, "candidates", list)
        choice = choose("auto")
        assert (choice.name, choice.elf) == ("native", "")
        assert "make firmware" in choice.reason
        with pytest.raises(FirmwareError, match="apt-get install"):
            choose("due")

    def test_the_newest_that_fits_is_taken(
        self, elf: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        misfit = tmp_path / "newer.bin"
        misfit.write_bytes(bytes(64))
        monkeypatch.setattr(firmware, "candidates", lambda: [misfit, elf])
        choice = choose("auto")
        assert (choice.name, choice.elf) == ("due", os.fspath(elf))

    @pytest.mark.parametrize("query", [{"board": "uno"}, {"board": "native", "elf": "a.elf"}])
    def test_options_that_make_no_sense_are_refused(self, query: Board) -> None:
        with pytest.raises(OptionError):
            parse_options(query)
