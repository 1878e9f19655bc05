"""Behaviour of the firmware on the emulated board."""

import itertools
import struct
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from heli_host import declaration as d
from heli_host.board.heli import Heli
from heli_host.link.frames import FrameParser, encode_frame
from heli_host.link.session import Session
from heli_sim.due._due_board import motor_duty

from firmware.due.report import Image
from tests.channels.groups import COUNTS
from tests.firmware.desk import (
    STOP_PIN,
    TICK_INTERRUPT,
    TRAVEL_INTERRUPT,
    Board,
    boot_to_first_frame_ms,
    flying_board_and_host,
    open_loop,
    rx_lost_bytes,
    travel_counts_lost,
)

pytestmark = pytest.mark.emulated


EFC0_FMR, EFC1_FMR = 0x400E0A00, 0x400E0C00
DECODER_ERRORS = "_ZN4heli3due8encoders12_GLOBAL__N_114decoder_errorsE"
TRAVEL_ILLEGAL = "_ZN4heli3due8encoders12_GLOBAL__N_113illegal_edgesE"
UART_RCR, UART_RNCR = 0x400E0904, 0x400E0914


def counted(heli: Heli) -> npt.NDArray[np.int32]:
    """Counts of elevation, pitch and travel in the newest tick."""
    latest = heli.session.latest
    assert latest is not None
    return latest.raw[COUNTS]


def test_a_flight_goes_where_it_is_sent_and_ends_on_the_table(elf: Path, image: Image) -> None:
    board, heli = flying_board_and_host(elf, image)
    assert board.arm is not None
    heli.setpoint(elevation_deg=5.0, travel_deg=20.0)
    heli.wait(6.0)
    elevation_deg, _, travel_deg = np.rad2deg(board.arm.state[:3])
    assert abs(elevation_deg - 5.0) < 2.0
    assert abs(travel_deg - 20.0) < 6.0
    heli.land()
    assert board.off()
    status = heli.session.status()
    assert status.overruns == status.frames_bad == status.ticks_dropped == 0
    assert status.illegal_elevation == status.illegal_pitch == status.illegal_travel == 0
    assert heli.session.counters.ticks_lost == 0
    assert board.due.uart_overruns == 0
    assert board.stack_used_bytes() <= image.stack_needed_bytes()


def test_processor_sleeps_when_there_is_nothing_to_do(board: Board) -> None:
    board.advance(20)
    cycles, asleep = board.due.cycles, board.due.sleep_cycles
    board.advance(100)
    assert (board.due.sleep_cycles - asleep) / (board.due.cycles - cycles) > 0.5


def test_ticks_come_once_a_millisecond(board: Board) -> None:
    board.advance(20)
    before = board.due.exception_stats(TICK_INTERRUPT).count
    board.advance(3000)
    assert abs(board.due.exception_stats(TICK_INTERRUPT).count - before - 3000) <= 1


def test_both_flash_banks_have_the_wait_states_of_84_MHz(board: Board) -> None:
    board.advance(20)
    assert board.due.mck_Hz == 84_000_000
    assert [board.register(address) >> 8 & 0xF for address in (EFC0_FMR, EFC1_FMR)] == [4, 4]


def test_encoders_count_alike_and_a_before_b_is_up(board: Board, heli: Heli) -> None:
    heli.wait(0.05)
    before = counted(heli)
    start_us = board.due.now_us
    counts = {d.Axis.ELEVATION: 500, d.Axis.PITCH: -400, d.Axis.TRAVEL: 300}
    for k in range(max(map(abs, counts.values()))):
        for axis, count in counts.items():
            if k < abs(count):
                board.due.schedule_step(axis, 1 if count > 0 else -1, start_us + 10.0 + 10.0 * k)
    heli.wait(0.1)
    assert list(counted(heli) - before) == [500, -400, 300]


def test_no_travel_edge_is_lost_at_200000_a_second(board: Board, heli: Heli) -> None:
    edges = 5000
    start_us = board.due.now_us
    board.due.clear_stats()
    for k in range(edges):
        board.due.schedule_step(d.Axis.TRAVEL, direction=1, when_us=start_us + 10.0 + 5.0 * k)
    heli.wait(0.05)
    assert counted(heli)[d.Axis.TRAVEL] == edges
    assert heli.session.status().illegal_travel == 0
    handler = board.due.exception_stats(TRAVEL_INTERRUPT)
    assert handler.count == edges
    assert handler.max_instructions <= 60


def test_no_travel_edge_is_lost_while_the_law_flies(board: Board) -> None:
    assert travel_counts_lost(board) == 0


def test_illegal_transitions_are_counted_on_every_encoder(board: Board, heli: Heli) -> None:
    board.due.glitch_encoder(d.Axis.ELEVATION)
    for _ in range(2):
        board.due.glitch_encoder(d.Axis.PITCH)
        board.advance(2)
    for _ in range(3):
        board.due.glitch_encoder(d.Axis.TRAVEL)
        board.advance(1)
    status = heli.session.status()
    assert (status.illegal_elevation, status.illegal_pitch, status.illegal_travel) == (1, 2, 3)


@pytest.mark.parametrize("axis", range(3))
def test_illegal_transitions_are_counted_beyond_16_bits(board: Board, heli: Heli, axis: int) -> None:
    place = board.image.symbols[TRAVEL_ILLEGAL if axis == d.Axis.TRAVEL else DECODER_ERRORS]
    place += 4 * (axis == d.Axis.PITCH)
    # Two below what the 16 bits of the status hold.
    board.due.poke(place, struct.pack("<I", 0xFFFD))
    heli.wait(0.05)
    heli.arm()
    heli.wait(0.01)
    assert board.on()
    for _ in range(int(heli.session.read_params()[d.Param.ENCODER_ILLEGAL_MAX]) + 1):
        board.due.glitch_encoder(axis)
        heli.wait(0.005)
    heli.wait(0.05)
    assert board.off()
    assert heli.fault == d.Fault.ENCODER_ELEVATION + axis
    assert getattr(heli.session.status(), f"illegal_{d.Axis(axis).name.lower()}") == 0xFFFF


def test_a_tick_that_is_late_is_counted_and_reported(board: Board, heli: Heli) -> None:
    assert heli.session.status().overruns == 0
    board.due.hold_processor(True)
    board.due.run_us(2800.0)
    board.due.hold_processor(False)
    heli.wait(0.02)
    status = heli.session.status()
    assert status.overruns >= 1
    assert status.tick_max_us > 1000


@pytest.mark.parametrize(("front_V", "back_V"), [(6.0, 3.0), (-2.0, 1.0), (0.0, 0.0), (9.0, -4.0)])
def test_duties_are_the_voltages_within_one_step(
    board: Board, heli: Heli, front_V: float, back_V: float
) -> None:
    open_loop(heli, front_V, back_V)
    assert board.on()
    supply_V = heli.session.read_params()[d.Param.SUPPLY_V]
    assert motor_duty(board.due, 0) == pytest.approx(front_V / supply_V, abs=1.01 / 2100)
    assert motor_duty(board.due, 1) == pytest.approx(back_V / supply_V, abs=1.01 / 2100)
    assert board.due.pwm_period_cycles(4) == 84_000_000 // 20_000


def test_opening_the_port_is_distinguished_from_power_up(board: Board) -> None:
    before = board.connect().session.welcome
    assert before.reset == d.Reset.POWER_UP
    board.due.usb_control_lines(False)
    board.due.usb_control_lines(True)
    board.advance(300)
    welcome = board.connect().session.welcome
    assert welcome.reset == d.Reset.USER
    assert welcome.boot_fault == d.Fault.NONE
    assert welcome.boot_id != before.boot_id


def test_the_handshake_names_the_kind_of_board(board: Board) -> None:
    assert board.connect().info.board == "Arduino Due"


def test_every_start_has_another_boot_id(board: Board) -> None:
    ids = {board.connect().session.welcome.boot_id}
    for _ in range(3):
        board.cut_power()
        board.restore_power()
        board.advance(30)
        ids.add(board.connect().session.welcome.boot_id)
        board.reset()
        ids.add(board.connect().session.welcome.boot_id)
    assert len(ids) == 7
    assert max(ids) < 2**24
    # The odds that none of 7 random numbers is above a tenth of the range are 1 in 10^7.
    assert max(ids) > 2**24 / 10


def test_saved_parameters_outlive_a_reset_and_the_pages_take_turns(board: Board) -> None:
    pages = []
    for value in (1.5, 2.5, 0.25, 3.0):
        heli = board.connect()
        heli.session.command(d.ParamSetMessage(0, d.Param.ELEVATION_KP, value))
        heli.session.command(d.ParamsSaveMessage(0))
        pages.append(board.due.flash()[-1024:])
        # Programming asks for more wait states than reading.
        assert board.register(EFC1_FMR) >> 8 & 0xF == 4
        board.reset()
        session = Session(board, session_number=2)
        assert session.connect().params_source == d.ParamsSource.STORED
        assert session.read_params()[d.Param.ELEVATION_KP] == value
    assert pages[0][:512] == pages[0][512:]
    for before, after in itertools.pairwise(pages):
        changed = [before[at : at + 512] != after[at : at + 512] for at in (0, 512)]
        assert sorted(changed) == [False, True]


def test_ticks_go_on_while_the_flash_is_written(heli: Heli) -> None:
    heli.session.command(d.ParamsSaveMessage(0))
    heli.wait(0.1)
    assert heli.session.status().overruns == 0
    assert heli.session.counters.ticks_lost == 0


def test_no_byte_is_lost_of_20000_in_a_row_under_full_telemetry(board: Board) -> None:
    assert rx_lost_bytes(board) == 0


@pytest.mark.parametrize("before", [0, 1, 511, 512, 513])
@pytest.mark.parametrize("stalled", [1023, 1024, 1025, 1400])
def test_the_board_hears_again_after_a_stall_that_filled_its_receive_ring(
    board: Board, before: int, stalled: int
) -> None:
    board.advance(20)
    # Between frames zeros mean nothing.
    board.write(bytes(before))
    board.advance(30)
    board.due.hold_processor(True)
    board.write(bytes(stalled))
    board.advance(60)
    board.due.hold_processor(False)
    heli = board.connect()
    heli.wait(0.1)
    assert board.due.resets == 1
    # One byte short of full, the frame that fills the ring ends in the middle.
    assert heli.session.status().frames_bad <= (1 if stalled == 1023 else 0)


def test_bytes_that_find_no_room_are_lost_and_no_older_ones(board: Board) -> None:
    board.connect()
    # The slow clock [Hz] runs the watchdog, which must bear with two stalls in a row.
    board.due.set_slow_clock(20_000)
    pings = [encode_frame(d.MessageId.PING, k, d.PingMessage(0, k).pack()) for k in range(150)]
    board.due.hold_processor(True)
    room = board.register(UART_RCR) + board.register(UART_RNCR)
    kept = room // len(pings[0])
    board.write(b"".join(pings))
    board.advance(50)
    board.due.hold_processor(False)
    # The bytes that found room still arrive if the processor stalls again after it has begun to fetch them.
    board.due.run_us(200.0)
    board.due.hold_processor(True)
    sent = board.advance(50)
    board.due.hold_processor(False)
    frames = FrameParser().feed(sent + board.advance(300))
    received = [
        d.PongMessage.unpack(frame.payload).host_us for frame in frames if frame.id == d.MessageId.PONG
    ]
    assert kept >= 512 // len(pings[0])
    assert received[:kept] == list(range(kept))


def test_no_byte_of_the_board_is_lost_or_wrong_wherever_its_ring_ends(heli: Heli) -> None:
    heli.session.command(d.ParamSetMessage(0, d.Param.TELEMETRY_BATCH_TICKS, 4))
    heli.wait(1.0)
    counters = heli.session.counters
    assert (counters.frames_bad, counters.frames_lost, counters.ticks_lost) == (0, 0, 0)
    # The ring of 2 KiB has come round often.
    assert counters.bytes_received > 5 * 2048


def test_answers_that_wait_for_the_line_overwrite_nothing_that_is_being_sent(board: Board) -> None:
    """Sixty questions with answers of 200 bytes: six times what the transmit ring holds."""
    # A board that has no room drops an answer, and the host asks again; what the board does send is whole.
    board.advance(20)
    parser = FrameParser()
    sent_values = [
        encode_frame(
            d.MessageId.HELLO, 0, d.HelloMessage(request=1, link_hash=d.LINK_HASH, session=1).pack()
        ),
        *(
            encode_frame(d.MessageId.PARAMS_READ, 1 + k, d.ParamsReadMessage(2 + k, 0).pack())
            for k in range(60)
        ),
    ]
    board.write(b"".join(sent_values))
    frames = parser.feed(board.advance(1200))
    assert sum(frame.id == d.MessageId.PARAMS for frame in frames) > 10
    assert (parser.frames_bad, parser.frames_lost) == (0, 0)


def test_first_answer_comes_within_50_ms_of_power_up(board: Board) -> None:
    assert boot_to_first_frame_ms(board) <= 50.0


DECODER_PINS = (("PB25", "PB27"), ("PC25", "PC26"))
CYCLES_PER_US = 84.0
WRITE_MOTORS = "_ZN4heli3due6motors5writeERKNS_12MotorCommandE"
PWM_FSR = 0x4009_4060
STOP_INPUT = 1 << 2
TRAVEL_COUNT = "_ZN4heli3due8encoders12_GLOBAL__N_110edge_countE"


def word(board: Board, symbol: str) -> int:
    """A signed variable of the firmware, as it is now."""
    [value] = struct.unpack("<i", board.due.peek(board.image.symbols[symbol], 4))
    return int(value)


@pytest.mark.parametrize("axis", [0, 1])
def test_pulses_shorter_than_the_filter_are_nothing_to_a_decoder(board: Board, heli: Heli, axis: int) -> None:
    before = list(counted(heli))
    for _ in range(5):
        # The switching of a motor couples a pulse into both lines of a cable at once. A running processor
        # would end its instruction first, and so stretch a pulse past the 0.76 us of the filter.
        board.due.hold_processor(True)
        for level in ("high", "low"):
            for pin in DECODER_PINS[axis]:
                board.due.set_pin(pin, level)
            board.due.run_us(0.7)
        board.due.hold_processor(False)
        heli.wait(0.003)
    assert list(counted(heli)) == before
    status = heli.session.status()
    assert (status.illegal_elevation, status.illegal_pitch) == (0, 0)


def test_an_edge_that_bounces_back_at_any_moment_leaves_the_count_where_it_was(board: Board) -> None:
    board.advance(20)
    for cycles in range(1, 90):
        start_us = board.due.now_us + 1.0
        board.due.schedule_step(d.Axis.TRAVEL, direction=1, when_us=start_us)
        board.due.schedule_step(d.Axis.TRAVEL, direction=-1, when_us=start_us + cycles / CYCLES_PER_US)
        board.due.run_us(20.0)
        assert (word(board, TRAVEL_COUNT), word(board, TRAVEL_ILLEGAL)) == (0, 0), f"after {cycles} cycles"


@pytest.mark.parametrize("steps", [1, 2, 3])
def test_where_the_travel_encoder_stands_at_the_start_is_its_zero(
    elf: Path, image: Image, steps: int
) -> None:
    board = Board(elf, image)
    board.cut_power()
    board.due.set_encoder(d.Axis.TRAVEL, steps)
    board.restore_power()
    board.advance(20)
    board.due.schedule_step(d.Axis.TRAVEL, direction=1, when_us=board.due.now_us + 10.0)
    board.due.schedule_step(d.Axis.TRAVEL, direction=1, when_us=board.due.now_us + 30.0)
    board.advance(1)
    assert (word(board, TRAVEL_COUNT), word(board, TRAVEL_ILLEGAL)) == (2, 0)


def test_travel_counts_every_step_in_both_directions(board: Board) -> None:
    board.advance(20)
    place = 0
    for direction in (1, 1, 1, 1, 1, -1, 1, 1, -1, -1, -1, -1, -1, -1, -1, -1, -1, 1):
        board.due.schedule_step(d.Axis.TRAVEL, direction, board.due.now_us + 5.0)
        board.due.run_us(20.0)
        place += direction
        assert (word(board, TRAVEL_COUNT), word(board, TRAVEL_ILLEGAL)) == (place, 0)
    assert board.due.exception_stats(TRAVEL_INTERRUPT).count == 18


def test_a_spike_shorter_than_a_clock_is_no_stop_and_a_longer_one_is(board: Board, heli: Heli) -> None:
    open_loop(heli, front_V=6.0, back_V=3.0)
    board.due.set_pin(STOP_PIN, "high")
    board.due.set_pin(STOP_PIN, "low")
    heli.wait(0.02)
    assert board.on()
    assert not board.pwm_low()
    board.due.set_pin(STOP_PIN, "high")
    board.due.run_us(0.1)
    board.due.set_pin(STOP_PIN, "low")
    heli.wait(0.02)
    assert board.off()
    assert heli.fault is d.Fault.HARDWARE_STOP


def test_a_stop_that_bounces_keeps_the_outputs_low_until_the_enables_are(board: Board, heli: Heli) -> None:
    open_loop(heli, front_V=6.0, back_V=3.0)
    # Between two ticks, so that the next one finds the switch open again.
    board.due.run_us(500.0)
    for open_us, closed_us in ((2.0, 5.0), (1.0, 20.0), (5.0, 1.0)):
        board.press_stop()
        board.due.run_us(open_us)
        board.release_stop()
        board.due.run_us(closed_us)
    # Outputs come back at the end of a PWM period, which a tick may lie within: the latch itself is asked
    # too, where the tick is about to switch the enables off.
    write = board.image.symbols[WRITE_MOTORS] & ~1
    board.due.add_breakpoint(write)
    while board.due.halt != "breakpoint":
        assert board.pwm_low()
        board.due.run_us(1.0)
    assert board.register(PWM_FSR) >> 8 & STOP_INPUT
    board.due.remove_breakpoint(write)
    board.due.resume()
    heli.wait(0.02)
    assert board.off() and board.pwm_low()
    assert heli.state is d.State.FAULT


def test_stopping_takes_the_outputs_low_at_once_and_not_at_the_end_of_their_period(
    board: Board, heli: Heli
) -> None:
    open_loop(heli, front_V=9.5, back_V=9.5)
    for _ in range(6):
        board.due.glitch_encoder(d.Axis.TRAVEL)
        board.due.run_us(5.0)
    board.milliseconds_until_off(step_us=1.0, max_ms=2.0)
    board.due.run_us(2.0)
    assert board.pwm_low()
    heli.wait(0.02)
    assert heli.fault is d.Fault.ENCODER_TRAVEL
