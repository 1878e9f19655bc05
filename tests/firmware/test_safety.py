"""Whatever happens to program or power, the bridges go off in time, and the host gets the reason."""

import struct
from collections.abc import Callable
from pathlib import Path

import pytest
from heli_host.board.heli import Heli
from heli_host.declaration import Axes, Axis, Fault, Reset, State
from heli_host.errors import HeliError
from heli_host.link.events import BOARD_RESTARTED

from firmware.due.report import Image
from tests.firmware.desk import (
    ENABLE_PINS,
    GIVE_UP,
    GPBR,
    HANGS,
    MAGIC,
    MAX_MS,
    POLL,
    TICK,
    TICK_INTERRUPT,
    TRAVEL_INTERRUPT,
    Board,
    FASTEST_Hz,
    Hang,
    SLOWEST_Hz,
    flying_board_and_host,
    halt_at,
    off_after_ms,
    open_loop,
    recorded,
    store,
)

pytestmark = pytest.mark.emulated

PWM_FPE1, PWM_FPE2 = 0x4009406C, 0x40094070
STOP_INPUT = 1 << 2


UNDEFINED = b"\x00\xde"
SUPERVISOR_CALL = b"\x00\xdf"
PUSH_FOR_EVER = b"\xff\xb5\xfd\xe7"
NVIC_ISER, NVIC_ISPR, SCB_ICSR = 0xE000E100, 0xE000E200, 0xE000ED04
NMI_PENDING, PENDSV_PENDING, SYSTICK_PENDING = 1 << 31, 1 << 28, 1 << 26
UART_INTERRUPT = 8
"""The firmware uses the UART without interrupts."""
UNEXPECTED_INTERRUPTS = tuple(number for number in range(45) if number not in (14, 30))
AT_ONCE_MS = 0.02
A_TICK_MS = 1.1


def pend(board: Board, interrupt: int) -> None:
    store(board, NVIC_ISER + 4 * (interrupt // 32), 1 << interrupt % 32)
    store(board, NVIC_ISPR + 4 * (interrupt // 32), 1 << interrupt % 32)


def assert_fault_reported(heli: Heli, reset: Reset, fault: Fault) -> None:
    """The session that flew finds the board again and says why it restarted."""
    session = heli.session
    session.wait_for(lambda: any(event.kind == BOARD_RESTARTED for event in session.events), 5.0)
    events = [event for event in session.events if event.kind == BOARD_RESTARTED]
    assert len(events) == 1
    [event] = events
    assert f"({reset.name.lower()})" in event.text
    assert fault is Fault.NONE or fault.name.lower().replace("_", " ") in event.text.replace("_", " ")
    assert (session.welcome.reset, session.welcome.boot_fault) == (reset, fault)
    assert session.counters.restarts == 1
    heli.wait(0.05)
    assert heli.state is State.IDLE


# -- hangs ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("hang", HANGS, ids=str)
def test_a_program_that_hangs_is_reset_and_the_host_is_informed(elf: Path, image: Image, hang: Hang) -> None:
    board, heli = flying_board_and_host(elf, image)
    resets = board.due.resets
    with hang.of(board):
        assert board.milliseconds_until_off() <= MAX_MS
        board.wait_for_reset(resets)
    assert_fault_reported(heli, Reset.WATCHDOG, Fault.WATCHDOG)
    assert board.off()


@pytest.mark.parametrize("slow_Hz", [SLOWEST_Hz, FASTEST_Hz])
def test_the_motors_are_off_in_time_over_the_watchdogs_tolerance(
    elf: Path, image: Image, slow_Hz: int
) -> None:
    # A restart comes every 16 ms, so some phase of these is just behind it.
    hang = HANGS[1]
    off_ms = [off_after_ms(elf, image, hang, slow_Hz, phase_ms) for phase_ms in range(16)]
    longest_ms = 27 * 128e3 / slow_Hz
    assert longest_ms - 2.0 <= max(off_ms) <= longest_ms + 1.0 <= MAX_MS
    assert min(off_ms) >= longest_ms - 18.0


def test_the_watchdog_leaves_a_normal_flight_alone_with_three_times_to_spare(elf: Path, image: Image) -> None:
    board, heli = flying_board_and_host(elf, image)
    board.due.set_slow_clock(3 * FASTEST_Hz)
    heli.setpoint(elevation_deg=5.0, travel_deg=10.0)
    heli.wait(2.0)
    heli.land()
    heli.params.save()
    heli.wait(0.2)
    assert board.due.resets == 1
    assert heli.session.counters.restarts == 0


# -- faults -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("instruction", "fault"), [(UNDEFINED, Fault.HARD_FAULT), (SUPERVISOR_CALL, Fault.UNEXPECTED_INTERRUPT)]
)
@pytest.mark.parametrize("where", [TICK, POLL])
def test_a_fault_switches_off_at_once_and_the_host_is_informed(
    elf: Path, image: Image, where: str, instruction: bytes, fault: Fault
) -> None:
    board, heli = flying_board_and_host(elf, image)
    resets = board.due.resets
    address = image.symbols[where] & ~1
    code = board.due.peek(address, 2)
    board.due.poke(address, instruction)
    # The function is called once a millisecond.
    assert board.milliseconds_until_off() <= A_TICK_MS
    board.wait_for_reset(resets)
    board.due.poke(address, code)
    assert_fault_reported(heli, Reset.SOFTWARE, fault)


def test_an_unexpected_interrupt_switches_off_and_informs_the_host(elf: Path, image: Image) -> None:
    board, heli = flying_board_and_host(elf, image)
    pend(board, UART_INTERRUPT)
    assert board.milliseconds_until_off(step_us=1.0) <= AT_ONCE_MS
    assert_fault_reported(heli, Reset.SOFTWARE, Fault.UNEXPECTED_INTERRUPT)


@pytest.mark.parametrize("pending", [NMI_PENDING, PENDSV_PENDING, SYSTICK_PENDING])
def test_exceptions_of_the_processor_switch_off_at_once(elf: Path, image: Image, pending: int) -> None:
    board, heli = flying_board_and_host(elf, image)
    store(board, SCB_ICSR, pending)
    assert board.milliseconds_until_off(step_us=1.0) <= AT_ONCE_MS
    assert_fault_reported(heli, Reset.SOFTWARE, Fault.UNEXPECTED_INTERRUPT)


def test_every_other_interrupt_switches_off_at_once(board: Board) -> None:
    for interrupt in UNEXPECTED_INTERRUPTS:
        heli = board.connect()
        heli.arm()
        assert board.on()
        pend(board, interrupt)
        assert board.milliseconds_until_off(step_us=1.0) <= AT_ONCE_MS, f"interrupt {interrupt}"
        board.advance(20)


def test_pwm_pins_go_low_with_the_enables(elf: Path, image: Image) -> None:
    board, _ = flying_board_and_host(elf, image)
    assert not board.pwm_low()
    # The reset that follows leaves the pins to their pull-ups: look before it comes.
    board.due.add_breakpoint(image.symbols["fault_handler"] & ~1)
    pend(board, UART_INTERRUPT)
    board.due.run_us(50.0)
    assert board.due.halt == "breakpoint"
    assert board.on()
    resets = board.due.resets
    board.due.resume()
    low = False
    while board.due.resets == resets:
        low = board.off() and board.pwm_low()
        board.due.step()
    assert low


def test_a_lost_stack_is_no_way_around_the_fault_handler(elf: Path, image: Image) -> None:
    board, heli = flying_board_and_host(elf, image)
    board.due.run_us(500.0)
    board.due.set_check("unmapped", False)
    # Register 13 is the stack pointer; it then points to addresses without memory.
    board.due.set_reg(13, 0x10000000)
    assert board.milliseconds_until_off() <= A_TICK_MS
    assert_fault_reported(heli, Reset.SOFTWARE, Fault.HARD_FAULT)


def test_a_stack_that_went_too_deep_is_a_fault(elf: Path, image: Image) -> None:
    board, heli = flying_board_and_host(elf, image)
    store(board, image.symbols["__stack_bottom"], 0)
    assert board.milliseconds_until_off() <= A_TICK_MS
    assert_fault_reported(heli, Reset.SOFTWARE, Fault.HARD_FAULT)


def test_endless_recursion_is_a_fault_though_no_memory_ends_there(elf: Path, image: Image) -> None:
    board, heli = flying_board_and_host(elf, image)
    resets = board.due.resets
    # As on the chip, where SRAM0 repeats below itself.
    board.due.set_check("unmapped", False)
    address = image.symbols[POLL] & ~1
    code = board.due.peek(address, len(PUSH_FOR_EVER))
    board.due.poke(address, PUSH_FOR_EVER)
    # A tick wakes the idle loop, and the next one looks at the stack.
    assert board.milliseconds_until_off() <= 2 * A_TICK_MS
    board.wait_for_reset(resets)
    board.due.poke(address, code)
    assert_fault_reported(heli, Reset.SOFTWARE, Fault.HARD_FAULT)


# -- noise on the travel encoder ---------------------------------------------------------------------


def send_travel_edges(board: Board, edges_per_s: float, milliseconds: int, direction: int = 0) -> None:
    """Edges of travel at that rate from now on, in one direction; 0 turns back at each edge."""
    start_us = board.due.now_us + 1.0
    for k in range(round(1e-3 * milliseconds * edges_per_s)):
        board.due.schedule_step(Axis.TRAVEL, direction or (1, -1)[k % 2], start_us + 1e6 * k / edges_per_s)


@pytest.mark.parametrize("direction", [0, 1])
@pytest.mark.parametrize("edges_per_s", [5e5, 2.5e6])
def test_edges_too_fast_to_count_switch_off_and_inform_the_host(
    board: Board, heli: Heli, edges_per_s: float, direction: int
) -> None:
    heli.arm()
    heli.control(Axes(0), front_V=6.0, back_V=6.0)
    heli.wait(0.05)
    assert max(board.duties()) > 0.05
    overruns = heli.session.status().overruns
    ticks = board.due.exception_stats(TICK_INTERRUPT).count
    start_us = board.due.now_us
    send_travel_edges(board, edges_per_s=edges_per_s, milliseconds=150, direction=direction)
    assert board.milliseconds_until_off() <= 2 * A_TICK_MS
    heli.wait(0.1)
    # The flood goes on: the tick does too, and so does the link.
    elapsed_ms = 1e-3 * (board.due.now_us - start_us)
    assert abs(board.due.exception_stats(TICK_INTERRUPT).count - ticks - elapsed_ms) <= 1
    # The flood may begin within a tick: then the first tick has only a step of hundreds of counts.
    assert heli.fault in (Fault.ENCODER_OVERLOAD, Fault.TRAVEL_STEP)
    [event] = [event for event in heli.session.events if event.kind == "fault"]
    assert str(heli.fault) in event.text
    heli.clear_fault()
    with pytest.raises(HeliError, match="encoder_overload"):
        heli.arm()
    assert heli.session.status().overruns == overruns
    assert board.due.resets == 1
    heli.wait(0.1)
    heli.zero()
    heli.arm()
    assert board.on()


def test_200000_edges_a_second_are_no_overload(board: Board, heli: Heli) -> None:
    heli.arm()
    send_travel_edges(board, edges_per_s=2e5, milliseconds=100)
    heli.wait(0.1)
    assert board.on()


# -- pins without a program -------------------------------------------------------------------------


def test_bridges_are_off_from_power_up_until_armed(board: Board) -> None:
    for _ in range(2000):
        assert board.off()
        board.due.run_us(10.0)
    heli = board.connect()
    heli.wait(0.1)
    assert board.off()
    heli.arm()
    assert board.on()
    assert board.duties() == [0.0, 0.0]


def test_stopping_takes_every_enable_low(board: Board, heli: Heli) -> None:
    heli.arm()
    assert board.on()
    heli.stop()
    assert not any(board.due.pin(pin) for pin in ENABLE_PINS)
    assert board.pwm_low()


def test_the_reset_line_switches_off_and_off_it_stays(elf: Path, image: Image) -> None:
    board, heli = flying_board_and_host(elf, image)
    board.due.set_nrst(True)
    assert board.milliseconds_until_off(step_us=1.0) <= AT_ONCE_MS
    for held in (True, False):
        board.due.set_nrst(held)
        for _ in range(2000):
            board.due.run_us(10.0)
            assert board.off()
    assert_fault_reported(heli, Reset.USER, Fault.NONE)
    assert board.off()


def test_without_pull_downs_a_reset_would_switch_the_bridges_on(elf: Path, image: Image) -> None:
    board = Board(elf, image)
    for pin in ENABLE_PINS:
        board.due.set_pin(pin, "open")
    board.advance(20)
    assert board.off()
    board.due.set_nrst(True)
    board.due.run_us(100.0)
    assert board.on()


def test_power_loss_switches_off(elf: Path, image: Image) -> None:
    board, _ = flying_board_and_host(elf, image)
    board.cut_power()
    assert board.off()


def test_an_erased_flash_leaves_the_bridges_off(elf: Path, image: Image) -> None:
    board, _ = flying_board_and_host(elf, image)
    board.due.usb_line_coding(1200)
    board.due.usb_control_lines(False)
    # Erased under a running program: it locks up, and the reset that the bridge gives ends that.
    board.due.set_strict(False)
    board.due.set_check("lockup", False)
    board.due.run_us(900_000.0)
    assert board.off()
    assert set(board.due.flash()) == {0xFF}
    assert board.due.in_rom
    board.cut_power()
    board.restore_power()
    for _ in range(100):
        assert board.off()
        board.due.run_us(100.0)


# -- hardware stop ----------------------------------------------------------------------------------


def press(board: Board) -> None:
    board.press_stop()


def wire_to_supply(board: Board) -> None:
    board.due.set_pin("PD6", "high")


@pytest.mark.parametrize("stop", [press, wire_to_supply])
def test_hardware_stop_cuts_the_duty_with_the_processor_halted(
    elf: Path, image: Image, stop: Callable[[Board], None]
) -> None:
    board, _ = flying_board_and_host(elf, image)
    assert max(board.duties()) > 0.05
    instructions = board.due.instructions
    board.due.hold_processor(True)
    stop(board)
    board.due.run_us(1.0)
    assert board.pwm_low()
    board.due.run_us(10_000.0)
    assert board.pwm_low()
    assert board.due.instructions == instructions


@pytest.mark.parametrize("volts_V", [6.0, -6.0])
def test_hardware_stop_cuts_every_half_bridge_in_both_directions(
    board: Board, heli: Heli, volts_V: float
) -> None:
    open_loop(heli, volts_V, volts_V)
    assert all(duty * volts_V > 0.05 for duty in board.duties())
    board.due.hold_processor(True)
    board.press_stop()
    board.due.run_us(1.0)
    assert board.pwm_low()
    board.due.run_us(10_000.0)
    assert board.pwm_low()


def test_every_half_bridge_has_the_stop_enabled_in_its_own_channel_too(board: Board) -> None:
    """Synchronous channels follow channel 0; one that leaves the group must not lose the stop with it."""
    board.connect()
    assert board.register(PWM_FPE1) == STOP_INPUT
    assert board.register(PWM_FPE2) == STOP_INPUT * 0x01010101


def test_hardware_stop_trips_and_must_be_released_and_cleared(elf: Path, image: Image) -> None:
    board, heli = flying_board_and_host(elf, image)
    # Shorter than a tick, and nothing of the program runs until it is over: the fault input alone keeps it,
    # through periods of the outputs that end after it.
    board.due.hold_processor(True)
    board.press_stop()
    board.due.run_us(20.0)
    board.release_stop()
    for _ in range(200):
        board.due.run_us(1.0)
        assert board.pwm_low()
    board.due.hold_processor(False)
    heli.wait(0.05)
    assert board.off()
    assert heli.state is State.FAULT
    assert heli.fault is Fault.HARDWARE_STOP
    assert any(event.kind == "fault" and "stop" in event.text for event in heli.session.events)
    heli.clear_fault()
    assert heli.state is State.IDLE


def test_a_stop_input_that_is_not_wired_keeps_the_motors_off(board: Board) -> None:
    board.press_stop()
    heli = board.connect()
    with pytest.raises(Exception, match="stop"):
        heli.arm()
    assert board.off()


SCB_CCR = 0xE000ED14
HARD_FAULT = 3
NOWHERE = 0x50000000

LOAD_FROM_NOWHERE = struct.pack("<3H", 0x2050, 0x0600, 0x6800)
DIVISION_BY_ZERO = struct.pack("<3H", 0x2000, 0xFBB0, 0xF0F0)
UNALIGNED_LOAD = struct.pack("<3H", 0x4668, 0x3001, 0x6800)
BFARVALID, UNDEFINSTR, UNALIGNED, DIVBYZERO = 1 << 15, 1 << 16, 1 << 24, 1 << 25


def assert_off_before(board: Board, symbol: str) -> None:
    """From the start of a function of the firmware on, the bridges go off before anything is recorded."""
    halt_at(board, symbol)
    assert board.on()
    before = recorded(board)
    while not (board.off() and board.pwm_low()):
        assert recorded(board) == before
        board.due.step()
    assert recorded(board) == before


@pytest.mark.parametrize(
    ("code", "place", "flag"),
    [
        (UNDEFINED, 0, UNDEFINSTR),
        (DIVISION_BY_ZERO, 2, DIVBYZERO),
        (UNALIGNED_LOAD, 4, UNALIGNED),
        (LOAD_FROM_NOWHERE, 4, BFARVALID),
    ],
)
def test_a_fault_is_recorded_with_its_place_its_caller_and_its_cause(
    board: Board, code: bytes, place: int, flag: int
) -> None:
    for check in ("unaligned", "unmapped"):
        board.due.set_check(check, False)
    board.connect().arm()
    resets = board.due.resets
    address = board.image.symbols[POLL] & ~1
    original_code = board.due.peek(address, len(code))
    board.due.poke(address, code)
    halt_at(board, "fault_handler")
    while board.due.resets == resets:
        fault = recorded(board)
        board.due.step()
    board.due.poke(address, original_code)
    assert fault.pc == address + place
    assert board.due.describe(fault.lr).startswith("heli::due::run()")
    assert fault.record == MAGIC | HARD_FAULT << 8 | Fault.HARD_FAULT
    assert fault.cfsr & flag
    assert flag != BFARVALID or fault.bfar == NOWHERE
    welcome = board.connect().session.welcome
    assert (welcome.reset, welcome.boot_fault) == (Reset.SOFTWARE, Fault.HARD_FAULT)


def test_an_unexpected_interrupt_is_recorded_with_its_number(board: Board) -> None:
    board.connect().arm()
    resets = board.due.resets
    pend(board, UART_INTERRUPT)
    while board.due.resets == resets:
        record = recorded(board).record
        board.due.step()
    assert record == MAGIC | (16 + UART_INTERRUPT) << 8 | Fault.UNEXPECTED_INTERRUPT


def test_the_bridges_go_off_before_a_fault_is_recorded(board: Board) -> None:
    board.connect().arm()
    pend(board, UART_INTERRUPT)
    assert_off_before(board, "fault_handler")


def test_the_bridges_go_off_before_giving_up_is_recorded(board: Board) -> None:
    board.connect().arm()
    store(board, board.image.symbols["__stack_bottom"], 0)
    assert_off_before(board, GIVE_UP)


def test_no_interrupt_gets_between_giving_up_and_the_reset(board: Board) -> None:
    board.connect().arm()
    store(board, board.image.symbols["__stack_bottom"], 0)
    halt_at(board, GIVE_UP)
    resets = board.due.resets
    served = board.due.exception_stats(TRAVEL_INTERRUPT).count
    for _ in range(10):
        board.due.step()
    board.due.schedule_step(Axis.TRAVEL, direction=1, when_us=board.due.now_us)
    board.wait_for_reset(resets)
    assert board.due.exception_stats(TRAVEL_INTERRUPT).count == served


def hang(board: Board) -> Fault:
    """Let the idle loop of an armed board hang, and return the report of the next start."""
    board.connect().arm()
    resets = board.due.resets
    with HANGS[1].of(board):
        board.milliseconds_until_off(max_ms=MAX_MS)
        board.wait_for_reset(resets)
    welcome = board.connect().session.welcome
    assert welcome.reset == Reset.WATCHDOG
    return Fault(welcome.boot_fault)


def test_a_record_is_reported_after_the_next_reset_and_never_again(board: Board) -> None:
    board.advance(20)
    store(board, GPBR, MAGIC | Fault.HARD_FAULT)
    assert hang(board) is Fault.HARD_FAULT
    assert hang(board) is Fault.WATCHDOG


def test_a_record_from_before_a_reset_by_the_user_is_old(board: Board) -> None:
    board.advance(20)
    store(board, GPBR, MAGIC | Fault.HARD_FAULT)
    board.reset()
    welcome = board.connect().session.welcome
    assert (welcome.reset, welcome.boot_fault) == (Reset.USER, Fault.NONE)
    assert hang(board) is Fault.WATCHDOG


def test_a_register_without_a_record_reports_nothing(board: Board) -> None:
    board.advance(20)
    store(board, GPBR, Fault.HARD_FAULT)
    assert hang(board) is Fault.WATCHDOG


def test_zero_division_and_unaligned_access_trap_and_stacks_are_aligned(board: Board) -> None:
    board.advance(20)
    assert board.register(SCB_CCR) == 1 << 9 | 1 << 4 | 1 << 3
