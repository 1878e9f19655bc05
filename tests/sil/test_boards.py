"""The two boards: the same flights, the same rig parameters, and what only the emulated Due shows."""

import os
import struct
import zlib
from pathlib import Path

import heli_host
import numpy as np
import pytest
from due_chip import Build, build
from due_emulator import Image, read_image
from heli_host import declaration as d
from heli_host.board.heli import Heli
from heli_host.board.parameters import read_origin
from heli_host.board.rig_check import BoardProperty, rig_differences, rig_parameters
from heli_host.data.log.reader import read_log
from heli_host.data.log.summary import FlightSummary
from heli_host.errors import LinkLost, RigMismatch
from heli_host.fly.runner import fly
from heli_host.link.events import BOARD_RESTARTED
from heli_host.ui.cli.board import open_board
from heli_sim import _native
from heli_sim.due import firmware
from heli_sim.due._due_board import DueBoard
from heli_sim.errors import BoardStopped, FirmwareError, OptionError, RigError, SimError
from heli_sim.rig import load_rig, write_rig
from heli_sim.sil.boards import choose
from heli_sim.sil.options import parse_options
from heli_sim.sil.world import saved

from tests.running.long import samples
from tests.sil.harness import Host, due_of, world, world_of

__all__ = ["build"]


Board = dict[str, str]
# Steps of the duty over its whole range, as in firmware/core/board.hpp.
FULL_DUTY = 2100
COUNTS = ("elevation_count", "pitch_count", "travel_count")
POLL = "_ZN4heli4Core4pollEv"
BRANCH_TO_SELF = b"\xfe\xe7"


def url(options: Board, **more: str) -> str:
    return "sil://?" + "&".join(f"{key}={value}" for key, value in {**options, **more}.items())


def flown(options: Board, plan: str, log: Path, **more: str) -> FlightSummary:
    with heli_host.connect(url(options, **more)) as heli:
        return fly(heli, plan, log_path=log)


@pytest.mark.emulated
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


@pytest.mark.emulated
def test_a_line_with_faults_is_flown_over_counted_and_the_same_for_a_seed(
    board: Board, tmp_path: Path
) -> None:
    logs = [tmp_path / "a.mcap", tmp_path / "b.mcap"]
    for log in logs:
        summary = flown(board, "hover", log, seed="7", flip="1e-5", drop="1e-4", stall="10:0.2")
        assert summary.completed
        assert summary.link["frames_bad"] > 0
        assert summary.link["board_frames_bad"] > 0
        assert summary.ticks_lost > 0
    assert logs[0].read_bytes() == logs[1].read_bytes()


@pytest.mark.emulated
def test_a_pulled_cable_resets_no_board_and_the_session_goes_on(board: Board) -> None:
    with heli_host.connect(url(board, unplug="3:0.4")) as heli:
        boots = world_of(heli).board.sim.boots
        heli.wait(5.0)
        assert heli.counters.reconnects == 1
        assert heli.counters.restarts == 0
        assert world_of(heli).board.sim.boots == boots


@pytest.mark.emulated
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
        assert heli.state is d.State.IDLE
        assert heli.session.status().overruns == 0


@pytest.mark.emulated
def test_the_stop_switch_cuts_the_motors_by_itself(board: Board) -> None:
    host = Host(world(**board))
    host.drive(1.9, 1.9)
    assert host.world.native.volts_V == pytest.approx([1.9, 1.9], abs=0.006)
    host.world.board.sim.set_stop(True)
    host.wait(1)
    assert host.world.native.volts_V == [0.0, 0.0]


@pytest.mark.emulated
def test_parameters_saved_on_one_board_are_found_by_the_other(elf: Path, tmp_path: Path) -> None:
    boards = {"native": {"board": "native"}, "due": {"board": "due", "elf": str(elf)}}
    for first, second in (("due", "native"), ("native", "due"), ("due", "due")):
        flash = str(tmp_path / f"{first}-{second}.bin")
        host = Host(world(**boards[first], flash=flash))
        assert host.hello().params_source == d.ParamsSource.DEFAULTS
        assert host.order(d.ParamSetMessage, d.Param.HOVER_V, 1.25).result == d.Result.OK
        assert host.order(d.ParamsSaveMessage).result == d.Result.OK
        host.wait(50)
        again = Host(world(**boards[second], flash=flash))
        assert again.hello().params_source == d.ParamsSource.STORED
        values = again.ask(d.ParamsReadMessage, d.Param.HOVER_V)
        assert np.frombuffer(values[3:7], np.float32)[0] == 1.25


@pytest.mark.emulated
def test_a_flash_file_of_another_length_is_refused(board: Board, tmp_path: Path) -> None:
    flash = tmp_path / "flash.bin"
    flash.write_bytes(b"short")
    with pytest.raises((SimError, RuntimeError), match="delete it"):
        world(**board, flash=str(flash))


@pytest.mark.emulated
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


STILL = (0, 0, 0)
SYSTICK = 15


@pytest.fixture(scope="module")
def image(build: Build) -> Image:
    return read_image(build("board.c", "-O2"))


@pytest.mark.emulated
def test_a_new_program_at_the_same_path_is_read_again(build: Build, tmp_path: Path) -> None:
    path = tmp_path / "program.elf"
    addresses = []
    for name in ("board.c", "hello.c", "board.c"):
        path.write_bytes(build(name, "-O1").read_bytes())
        addresses.append({symbol.name for symbol in read_image(path).symbols})
    assert addresses[0] == addresses[2] != addresses[1]


def loaded(image: Image) -> DueBoard:
    board = DueBoard()
    for address, data in image.segments:
        board.due.load(address, data)
    return board


def booted(image: Image) -> DueBoard:
    board = loaded(image)
    stand_still(board, 20)
    return board


def stand_still(board: DueBoard, milliseconds: int) -> None:
    """Let time pass while no encoder moves."""
    for _ in range(milliseconds):
        board.run(STILL, [])


def words(board: DueBoard, image: Image, name: str, count: int) -> tuple[int, ...]:
    return struct.unpack(f"<{count}i", board.due.peek(image.address(name), 4 * count))


@pytest.mark.emulated
def test_a_millisecond_is_84000_cycles(image: Image) -> None:
    board = booted(image)
    before = board.due.cycles
    stand_still(board, 100)
    assert board.due.cycles - before == pytest.approx(100 * 84_000, abs=20)


@pytest.mark.emulated
def test_edges_reach_decoders_and_interrupt(image: Image) -> None:
    board = booted(image)
    position = [0, 0, 0]
    for step in range(200):
        direction = 1 if step % 50 < 40 else -1
        count = (position[0], position[1], position[2])
        edges = [(20.0 + 50.0 * i, axis, direction) for i in range(10) for axis in range(3)]
        board.run(count, edges)
        for axis in range(3):
            position[axis] += 10 * direction
    board.run((position[0], position[1], position[2]), [])
    assert words(board, image, "counts", 3) == tuple(position) == (1200,) * 3


@pytest.mark.emulated
def test_duties_are_those_of_the_registers(image: Image) -> None:
    board = booted(image)
    board.due.poke(image.address("duty"), struct.pack("<4I", 1050, 0, 0, 700))
    assert board.run(STILL, []) == (0.0, 0.0, False)
    board.due.poke(image.address("on"), struct.pack("<I", 1))
    front, back, enabled = board.run(STILL, [])
    assert (front, back, enabled) == (0.5, -1 / 3, True)


@pytest.mark.emulated
def test_bytes_pass_at_25_a_millisecond(image: Image) -> None:
    board = booted(image)
    board.receive(bytes(range(100)))
    sent_values = [board.take_sent() for _ in range(6) if board.run(STILL, []) is not None]
    assert b"".join(sent_values) == bytes(b ^ 0x20 for b in range(100))
    assert max(len(part) for part in sent_values) == 25


@pytest.mark.emulated
def test_the_reset_line_stops_the_motors_for_205_ms(image: Image) -> None:
    board = booted(image)
    board.due.poke(image.address("duty"), struct.pack("<4I", 1050, 0, 0, 700))
    board.due.poke(image.address("on"), struct.pack("<I", 1))
    _, _, are_enabled = board.run(STILL, [])
    assert are_enabled
    board.reset()
    # The pins are inputs; pull-downs hold the enables.
    _, _, are_enabled = board.run(STILL, [])
    assert not are_enabled
    stand_still(board, 203)
    assert board.due.held_in_reset
    stand_still(board, 3)
    assert not board.due.held_in_reset
    assert board.due.last_reset == "user"


@pytest.mark.emulated
def test_power_up_starts_the_program_again(image: Image) -> None:
    board = booted(image)
    board.power_cycle()
    stand_still(board, 20)
    assert board.due.last_reset == "general"
    assert words(board, image, "loops", 1)[0] > 0


def ticking(build: Build) -> DueBoard:
    """A program whose SysTick comes every millisecond."""
    board = loaded(read_image(build("hello.c", "-O1")))
    board.align(SYSTICK)
    return board


@pytest.mark.emulated
def test_milliseconds_begin_with_the_programs_own_tick_after_every_start(build: Build) -> None:
    board = ticking(build)
    for _ in range(2):
        stand_still(board, 30)
        for _ in range(20):
            end, before = board.due.cycles, board.due.last_entry_cycle(SYSTICK)
            board.run(STILL, [])
            assert board.due.last_entry_cycle(SYSTICK) - before == pytest.approx(84_000, abs=20)
            # The quiet moment after the last edge, and the entry itself.
            assert board.due.last_entry_cycle(SYSTICK) - end == pytest.approx(5 * 84, abs=30)
        board.power_cycle()


@pytest.mark.emulated
def test_time_begins_with_the_first_tick(build: Build) -> None:
    board = ticking(build)
    board.run(STILL, [])
    assert board.due.last_entry_cycle(SYSTICK) > 0
    assert board.due.exception_stats(SYSTICK).count == 1


@pytest.mark.emulated
def test_edges_of_a_millisecond_come_between_its_command_and_the_next_tick(build: Build) -> None:
    board = ticking(build)
    stand_still(board, 5)
    board.run(STILL, [(0.0, 2, 1), (999.9, 2, 1)])
    assert board.due.encoder(2) == 2
    assert board.due.cycles < board.due.last_entry_cycle(SYSTICK) + 84_000


@pytest.mark.emulated
def test_an_arm_that_is_moved_gives_edges(image: Image) -> None:
    board = booted(image)
    for _ in range(10):
        board.run((1000, 0, -400), [])
    assert words(board, image, "counts", 3) == (1000, 0, -400)


@pytest.mark.emulated
def test_the_stop_switch_is_closed_until_it_is_pressed_or_its_wire_is_cut(image: Image) -> None:
    board = booted(image)
    assert not board.due.pin("PD6")
    board.set_stop(True)
    assert board.due.pin("PD6")
    board.set_stop(False)
    assert not board.due.pin("PD6")


@pytest.mark.emulated
def test_an_erased_board_starts_nothing(image: Image) -> None:
    board = booted(image)
    board.erase()
    stand_still(board, 300)
    assert board.due.in_rom
    assert set(board.due.flash()) == {0xFF}


PAGE_BYTES = 512


@pytest.fixture
def flash(tmp_path: Path) -> Path:
    """Flash in which hover_V was saved as 1.75, under another schema that had no parameter `controller`."""
    content = bytearray(saved({"hover_V": 1.75}))
    for start in (0, PAGE_BYTES):
        content[start + 3] = len(d.PARAMS) - 1
        content[start + 4 : start + 8] = struct.pack("<I", d.PARAMS_HASH ^ 1)
        crc = zlib.crc32(content[start : start + PAGE_BYTES - 4])
        content[start + PAGE_BYTES - 4 : start + PAGE_BYTES] = struct.pack("<I", crc)
    file = tmp_path / "flash.bin"
    file.write_bytes(content)
    return file


def test_the_host_learns_what_was_kept_and_what_is_new(flash: Path) -> None:
    with heli_host.connect(f"sil://?flash={flash}") as heli:
        assert heli.params["hover_V"] == 1.75
        origin = read_origin(heli.session)
        assert (origin.source, origin.kept, origin.dropped) == (d.ParamsSource.MIGRATED, len(d.PARAMS) - 1, 0)
        assert origin.new == (d.PARAMS[-1].name,)
        heli.params.save()
        assert read_origin(heli.session).source is d.ParamsSource.STORED
    with heli_host.connect(f"sil://?flash={flash}") as heli:
        assert heli.info.params_source == "stored"


def test_the_command_line_warns_at_connect(flash: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with open_board(None, f"sil://?flash={flash}"):
        pass
    output = "".join(capsys.readouterr())
    assert f"{len(d.PARAMS) - 1} kept, {d.PARAMS[-1].name} at the default, 0 dropped" in output


BOARDS = ["native", pytest.param("due", marks=pytest.mark.emulated)]
COARSE = {"encoder_counts_elevation": 2000.0, "encoder_counts_pitch": 2000.0, "encoder_counts_travel": 3000.0}
"""An encoder of 500 lines on elevation and pitch, and one of 750 on travel."""


def rig_file(folder: Path, **values: float) -> Path:
    path = folder / "mine.toml"
    write_rig(load_rig("makki2024").replace(**values), path)
    return path


def address_of_board(board: str, rig: Path, **more: str) -> str:
    if board == "due" and not firmware.candidates():
        pytest.skip("no firmware is built")
    return url({"rig": str(rig), "board": board}, **more)


def true_deg(heli: Heli) -> list[float]:
    return [float(angle) for angle in np.rad2deg(world_of(heli).state[:3])]


@pytest.mark.medium
@pytest.mark.parametrize("board", BOARDS)
def test_a_simulated_board_starts_with_what_its_rig_determines(board: str, tmp_path: Path) -> None:
    rig = rig_file(tmp_path, **COARSE, elevation_min=-20.0, supply=9.0, elevation_max=20.0, pitch_max=36.0)
    with heli_host.connect(address_of_board(board, rig)) as heli:
        assert heli.info.params_source == "stored"
        wanted = {
            "elevation_counts_per_rev": 2000.0,
            "pitch_counts_per_rev": 2000.0,
            "travel_counts_per_rev": 3000.0,
            "elevation_rest_deg": -20.0,
            "supply_V": 9.0,
            "motor_max_V": 9.0,
            "elevation_max_deg": 19.0,
            "pitch_max_deg": 31.0,
            "pitch_setpoint_max_deg": 26.0,
            "travel_max_deg": 175.0,
        }
        assert {name: heli.params[name] for name in wanted} == wanted
        heli.arm()


def test_the_default_rig_leaves_the_declared_parameters_alone() -> None:
    with heli_host.connect("sil://") as heli:
        assert heli.info.params_source == "defaults"


@pytest.mark.medium
@pytest.mark.parametrize("board", BOARDS)
def test_a_setpoint_is_reached_in_truth_whatever_the_encoders_count(board: str, tmp_path: Path) -> None:
    with heli_host.connect(address_of_board(board, rig_file(tmp_path, **COARSE))) as heli:
        heli.take_off()
        heli.setpoint(elevation_deg=5.0, travel_deg=8.0)
        heli.wait(9.0)
        elevation_deg, _, travel_deg = true_deg(heli)
        sample = heli.latest
    # A count is 0.18 deg: at half the counts of before, the true angles were twice those of the log.
    assert abs(elevation_deg - sample.elevation_deg) < 0.4 and abs(elevation_deg - 5.0) < 1.0
    assert abs(travel_deg - sample.travel_deg) < 0.4 and abs(travel_deg - 8.0) < 1.5


@pytest.mark.parametrize(
    ("name", "value"),
    [("travel_counts_per_rev", 2000.0), ("travel_counts_per_rev", -4096.0), ("motor_front_sign", -1.0)],
)
def test_a_simulated_board_with_a_wrong_scale_or_sign_does_not_arm(name: str, value: float) -> None:
    with heli_host.connect("sil://") as heli:
        heli.params[name] = value
        with pytest.raises(RigMismatch, match=f"{name} is {value:g}.*leave {name} out"):
            heli.arm()
        assert heli.state is heli_host.State.IDLE


def test_parameters_in_a_flash_file_hold_and_are_compared(tmp_path: Path) -> None:
    flash, rig = tmp_path / "flash.bin", rig_file(tmp_path, **COARSE)
    with heli_host.connect(f"sil://?flash={flash}") as heli:
        heli.params.save()
    with heli_host.connect(f"sil://?flash={flash}&rig={rig}") as heli:
        assert heli.params["travel_counts_per_rev"] == 4096.0
        with pytest.raises(RigMismatch, match="travel_counts_per_rev is 4096 count, but the rig has 3000"):
            heli.take_off()


def test_a_rig_that_no_board_can_be_set_to_is_refused(tmp_path: Path) -> None:
    rig = rig_file(tmp_path, encoder_counts_elevation=70_000.0)
    with pytest.raises(RigError, match="needs elevation_counts_per_rev = 70000, and the board takes"):
        heli_host.connect(f"sil://?rig={rig}")


def test_on_hardware_a_sign_is_wiring_and_each_part_is_named() -> None:
    stated = rig_parameters("makki2024").values
    board = {
        **stated,
        "pitch_counts_per_rev": -4096.0,
        "travel_counts_per_rev": -2000.0,
        "elevation_rest_deg": -27.5,
        "supply_V": 9.0,
        "elevation_max_deg": 40.0,
    }
    parts = {
        difference.parameter: difference.part
        for difference in rig_differences(stated, board, simulated=False)
    }
    assert parts == {
        "travel_counts_per_rev": BoardProperty.SCALE,
        "elevation_rest_deg": BoardProperty.REST,
        "supply_V": BoardProperty.SUPPLY,
        "elevation_max_deg": BoardProperty.LIMIT,
    }
    simulated = rig_differences(stated, board, simulated=True)
    assert simulated[0].parameter == "pitch_counts_per_rev" and simulated[0].part is BoardProperty.DIRECTION


@pytest.mark.medium
def test_an_encoder_with_another_scale_counts_otherwise_and_nothing_says_so() -> None:
    with heli_host.connect("sil://?encoder_scale=travel:0.5,elevation:1.01") as heli:
        assert heli.params["travel_counts_per_rev"] == 4096.0
        heli.take_off()
        heli.setpoint(travel_deg=4.0)
        heli.wait(6.0)
        elevation_deg, _, travel_deg = true_deg(heli)
        sample = heli.latest
    assert abs(travel_deg - sample.travel_deg / 0.5) < 0.3 and travel_deg > 5.0
    assert abs((elevation_deg + 25.0) * 1.01 - (sample.elevation_deg + 25.0)) < 0.15


@pytest.mark.parametrize("text", ["roll:0.5", "travel:0", "travel:nan", "travel:x", "travel"])
def test_a_scale_that_means_nothing_is_refused(text: str) -> None:
    with pytest.raises(OptionError):
        parse_options({"encoder_scale": text})
