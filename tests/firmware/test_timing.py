"""The firmware and time: ticks missed and late, wake-ups, the watchdog, clocks, the first microseconds."""

import numpy as np
import pytest
from heli_host.board.heli import Heli
from heli_host.declaration import PARAMS, ArmMessage, Channel, Fault, Param, State
from heli_host.link.engine import UNNUMBERED

from tests.firmware.desk import (
    CLOCK_DISABLE,
    ENABLE_PINS,
    MAX_MS,
    POLL,
    TICK,
    TICK_INTERRUPT,
    TICK_TIMER_CONTROL,
    TRAVEL,
    Board,
    FASTEST_Hz,
    SLOWEST_Hz,
    boot_to_first_frame_ms,
    halt_at,
    store,
)
from tests.flight.harness import TRACKING

pytestmark = pytest.mark.emulated


QUIET_TICK_US = 60
CYCLES_PER_US = 84.0


def tick_end(board: Board) -> float:
    """Let time pass until a tick has been served; when it was due [us], to about a microsecond."""
    served = board.due.exception_stats(TICK_INTERRUPT).count
    while board.due.exception_stats(TICK_INTERRUPT).count == served:
        board.due.run_us(1.0)
    return float(board.due.now_us)


def entered_us(board: Board) -> float:
    """When the newest tick's interrupt was entered [us]."""
    since = board.due.cycles - board.due.last_entry_cycle(TICK_INTERRUPT)
    return float(board.due.now_us - since / CYCLES_PER_US)


def test_a_tick_takes_as_long_as_it_does(heli: Heli) -> None:
    heli.wait(0.1)
    status = heli.session.status()
    assert status.overruns == 0
    assert 20 <= status.tick_max_us <= QUIET_TICK_US


@pytest.mark.parametrize("stalled_ms", [1.5, 2.1, 2.5, 2.9, 4.3, 7.8])
def test_ticks_that_nobody_served_make_the_next_one_late_by_their_number(
    board: Board, heli: Heli, stalled_ms: float
) -> None:
    heli.wait(0.02)
    ended_us = tick_end(board)
    board.due.hold_processor(True)
    board.due.run_us(1e3 * stalled_ms)
    board.due.hold_processor(False)
    assert board.due.now_us - ended_us < 1e3 * stalled_ms + 1.0
    heli.wait(0.05)
    status = heli.session.status()
    assert status.overruns == (1 if stalled_ms >= 2.0 else 0)
    # One tick may come when it is due; all the time from then on is late.
    late_us = 1e3 * (stalled_ms - 1.0)
    assert late_us <= status.tick_max_us <= late_us + 2 * QUIET_TICK_US


def test_a_tick_that_takes_longer_than_its_millisecond_is_one_late_tick(board: Board, heli: Heli) -> None:
    heli.wait(0.02)
    tick_end(board)
    served, entered = board.due.exception_stats(TICK_INTERRUPT).count, entered_us(board)
    halt_at(board, TICK, max_us=1500.0)
    board.due.hold_processor(True)
    board.due.run_us(1400.0)
    board.due.hold_processor(False)
    heli.wait(0.05)
    status = heli.session.status()
    assert status.overruns == 1
    assert 1400 <= status.tick_max_us <= 1400 + QUIET_TICK_US
    # The one after it comes late too, but it comes.
    tick_end(board)
    ticks = board.due.exception_stats(TICK_INTERRUPT).count - served
    assert ticks == round(1e-3 * (entered_us(board) - entered))


def test_an_edge_between_two_looks_at_the_clock_makes_no_tick_late(board: Board, heli: Heli) -> None:
    heli.wait(0.02)
    tick_end(board)
    ticked_us = entered_us(board)
    # From the tick's first instruction on, a cycle later in each.
    for k in range(200):
        board.due.schedule_step(TRAVEL, (1, -1)[k % 2], ticked_us + 1e3 * (k + 1) + k / CYCLES_PER_US)
    heli.wait(0.25)
    assert heli.session.status().overruns == 0


def test_a_tick_at_any_moment_of_the_idle_loop_is_followed_by_its_work_at_once(board: Board) -> None:
    board.advance(20)
    due = board.due
    due.add_breakpoint(board.image.symbols[POLL] & ~1)

    def idle_loop_turns_within(us: float) -> bool:
        due.run_us(us)
        is_turning = due.halt == "breakpoint"
        due.resume()
        return is_turning

    assert idle_loop_turns_within(1500.0)
    asleep, steps = due.sleep_cycles, 0
    while due.sleep_cycles == asleep:
        due.step()
        steps += 1
    # The last 60 instructions of a turn: behind the idle loop's work, up to its sleep.
    for instructions in range(steps - 60, steps + 1):
        assert idle_loop_turns_within(1500.0)
        ticked_us = entered_us(board)
        for _ in range(instructions):
            due.step()
        due.hold_processor(True)
        due.run_until_us(ticked_us + 1001.0)
        due.hold_processor(False)
        assert idle_loop_turns_within(150.0), f"a tick came after {instructions} of {steps} instructions"


def test_the_watchdog_is_restarted_every_16_ticks_and_no_oftener(board: Board) -> None:
    board.advance(20)
    restarts = board.due.watchdog_restarts
    board.advance(1600)
    assert abs(board.due.watchdog_restarts - restarts - 100) <= 1


def test_an_idle_loop_that_other_interrupts_wake_does_not_hide_a_tick_that_died(board: Board) -> None:
    board.connect().arm()
    resets = board.due.resets
    store(board, TICK_TIMER_CONTROL, CLOCK_DISABLE)
    for k in range(300):
        board.due.schedule_step(TRAVEL, (1, -1)[k % 2], board.due.now_us + 1.0 + 1e3 * k)
    assert board.milliseconds_until_off(max_ms=MAX_MS) <= MAX_MS
    board.wait_for_reset(resets)


@pytest.mark.parametrize("slow_Hz", [SLOWEST_Hz, FASTEST_Hz])
def test_the_clock_starts_over_the_tolerance_of_what_times_it(board: Board, slow_Hz: int) -> None:
    board.due.set_slow_clock(slow_Hz)
    assert boot_to_first_frame_ms(board) <= 50.0
    assert board.due.mck_Hz == 84_000_000


def test_enables_are_driven_low_within_microseconds_of_a_reset(board: Board) -> None:
    board.advance(20)
    # Without the pull-downs that the wiring asks for, the chip's own pull-ups switch the bridges on.
    for pin in ENABLE_PINS:
        board.due.set_pin(pin, "open")
    board.cut_power()
    board.restore_power()
    board.due.set_nrst(True)
    board.due.run_us(100.0)
    assert board.on()
    board.due.set_nrst(False)
    assert board.milliseconds_until_off(step_us=1.0, max_ms=1.0) <= 0.15
    for _ in range(20):
        assert board.off()
        board.due.run_us(1000.0)


def make_late(board: Board, heli: Heli, ticks: int) -> None:
    """Let so many ticks run late."""
    for _ in range(ticks):
        tick_end(board)
        board.due.hold_processor(True)
        board.due.run_us(2500.0)
        board.due.hold_processor(False)
        heli.wait(0.004)


def test_late_ticks_from_before_arming_are_no_fault_and_later_ones_are(board: Board, heli: Heli) -> None:
    most = int(heli.session.read_params()[Param.OVERRUN_MAX])
    make_late(board, heli, most + 1)
    assert heli.session.status().overruns == most + 1
    heli.arm()
    make_late(board, heli, most)
    assert heli.state is State.ARMED
    assert board.on()
    make_late(board, heli, 1)
    assert heli.fault is Fault.TICK_OVERRUN
    assert board.off()


def test_an_arm_that_was_zeroed_just_now_is_not_moving(board: Board, heli: Heli) -> None:
    for axis in range(3):
        for k in range(400):
            board.due.schedule_step(axis, direction=1, when_us=board.due.now_us + 10.0 + 100.0 * k)
        heli.wait(0.05)
    heli.wait(0.2)
    heli.zero()
    # At once: `Heli.arm` would wait until pitch has been still for 2 s.
    heli.session.command(ArmMessage(UNNUMBERED))
    heli.session.wait_for_state(State.ARMED)
    assert board.on()


def test_a_hold_stays_where_it_began_on_every_axis_that_it_holds(heli: Heli) -> None:
    # An arm that does not move when it is driven would be a fault first.
    for spec in PARAMS:
        if spec.name.endswith(TRACKING):
            heli.params[spec.name] = spec.max
    heli.arm()
    heli.control()
    heli.setpoint(travel_deg=60.0, elevation_deg=0.0, lead_s=0.5)
    heli.wait(0.1)
    # No setpoint comes any more, and the arm stays where it is.
    heli.session.keep_alive(None)
    heli.wait(heli.session.read_params()[Param.SETPOINT_HOLD_S] + 0.1)
    assert heli.state is State.HOLD
    latest = heli.session.latest
    assert latest is not None
    setpoints_deg = np.degrees(1e-5 * latest.raw[[Channel.ELEVATION_SETPOINT, Channel.TRAVEL_SETPOINT]])
    assert setpoints_deg == pytest.approx([-25.0, 0.0], abs=0.2)
