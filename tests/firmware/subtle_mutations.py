"""Mistakes that flights seldom show, and the claim that must notice: filters, locks, traps, order, races."""

from __future__ import annotations

from collections.abc import Callable

from tests.firmware import test_board as claims
from tests.firmware import test_noise as noise
from tests.firmware import test_records as records
from tests.firmware import test_safety as safety
from tests.firmware import test_since_when as since_when
from tests.firmware import test_timing as timing
from tests.firmware.hangs import FASTEST_Hz
from tests.firmware.mutations import Mutation

CLEAR_EDGES = "  static_cast<void>(PIOD->PIO_ISR.read());\n"
LOOK_AT_LINES = "  const std::uint32_t now = PIOD->PIO_PDSR.read() & kEdgeMask;\n"


def locking(right: str, wrong: str) -> Mutation:
    return Mutation(
        "clock.cpp",
        right,
        wrong,
        timing.test_the_clock_starts_over_the_tolerance_of_what_times_it,
        (FASTEST_Hz,),
    )


def filtering(right: str, wrong: str) -> Mutation:
    return Mutation(
        "encoders.cpp", right, wrong, noise.test_pulses_shorter_than_the_filter_are_nothing_to_a_decoder, (0,)
    )


def numbering(right: str, wrong: str) -> Mutation:
    return Mutation("random.cpp", right, wrong, claims.test_every_start_has_another_boot_id)


def bouncing(right: str, wrong: str) -> Mutation:
    return Mutation(
        "encoders.cpp",
        right,
        wrong,
        noise.test_an_edge_that_bounces_back_at_any_moment_leaves_the_count_where_it_was,
    )


def stepping(right: str, wrong: str) -> Mutation:
    return Mutation("encoders.cpp", right, wrong, noise.test_travel_counts_every_step_in_both_directions)


def motors(right: str, wrong: str, claim: Callable[..., None], *arguments: object) -> Mutation:
    return Mutation("motors.cpp", right, wrong, claim, arguments)


def missing(right: str, wrong: str, stalled_ms: float) -> Mutation:
    return Mutation(
        "tick_timer.cpp",
        right,
        wrong,
        timing.test_ticks_that_nobody_served_make_the_next_one_late_by_their_number,
        (stalled_ms,),
    )


def waking(right: str, wrong: str) -> Mutation:
    return Mutation(
        "main.cpp",
        right,
        wrong,
        timing.test_a_tick_at_any_moment_of_the_idle_loop_is_followed_by_its_work_at_once,
    )


def recording(
    right: str, wrong: str, code: bytes = safety.UNDEFINED, place: int = 0, flag: int = records.UNDEFINSTR
) -> Mutation:
    return Mutation(
        "faults.cpp",
        right,
        wrong,
        records.test_a_fault_is_recorded_with_its_place_its_caller_and_its_cause,
        (code, place, flag),
    )


def trapping(right: str, wrong: str, code: bytes, place: int, flag: int) -> Mutation:
    return Mutation(
        "startup.cpp",
        right,
        wrong,
        records.test_a_fault_is_recorded_with_its_place_its_caller_and_its_cause,
        (code, place, flag),
    )


def telling(right: str, wrong: str, claim: Callable[..., None]) -> Mutation:
    return Mutation("faults.cpp", right, wrong, claim)


def starting(right: str, wrong: str) -> Mutation:
    return Mutation(
        "startup.cpp", right, wrong, timing.test_enables_are_driven_low_within_microseconds_of_a_reset
    )


def receiving(right: str, wrong: str, claim: Callable[..., None], *arguments: object) -> Mutation:
    return Mutation("uart.cpp", right, wrong, claim, arguments)


def core(file: str, right: str, wrong: str, claim: Callable[..., None], *arguments: object) -> Mutation:
    return Mutation(f"core/{file}", right, wrong, claim, arguments)


LOCK_TIMES = (
    locking("PLLACOUNT(0x3F)", "PLLACOUNT(0)"),
    locking("PLLACOUNT(0x3F)", "PLLACOUNT(6)"),
    locking("MOSCXTST(8)", "MOSCXTST(0)"),
    locking("MOSCXTST(8)", "MOSCXTST(7)"),
    locking("if (!wait_for(PMC_SR_LOCKA)) return false;", ""),
    locking("if (!wait_for(PMC_SR_MOSCXTS)) return false;", ""),
    locking(
        "return select(PMC_MCKR_PRES_CLK_2 | PMC_MCKR_CSS_MAIN_CLK) &&\n         select(", "return select("
    ),
    locking("return wait_for(PMC_SR_MCKRDY);", "return true;"),
    locking("kMaxPolls = 20000", "kMaxPolls = 200"),
)

FILTERS = (
    filtering(" | kFilter;", ";"),
    filtering("TC_BMR_FILTER | TC_BMR_MAXFILT(63)", "TC_BMR_MAXFILT(63)"),
    filtering("TC_BMR_MAXFILT(63)", "TC_BMR_MAXFILT(31)"),
    filtering("start_decoder(TC0);", "start_decoder(TC0);\n  TC0->TC_BMR.write(kDecoder & ~kFilter);"),
    motors(
        " | PWM_FMR_FFIL(kStopInput)",
        "",
        noise.test_a_spike_shorter_than_a_clock_is_no_stop_and_a_longer_one_is,
    ),
    motors(
        " && !pressed && !enabled)",
        " && !pressed)",
        noise.test_a_stop_that_bounces_keeps_the_outputs_low_until_the_enables_are,
    ),
    motors(
        "  enabled = command.enable;",
        "",
        noise.test_a_stop_that_bounces_keeps_the_outputs_low_until_the_enables_are,
    ),
    motors(
        "return active || pressed;",
        "return pressed;",
        noise.test_a_spike_shorter_than_a_clock_is_no_stop_and_a_longer_one_is,
    ),
)

TRAPS = (
    trapping(" | CCR_DIV_0_TRP", "", records.DIVISION_BY_ZERO, 2, records.DIVBYZERO),
    trapping(" | CCR_UNALIGN_TRP", "", records.UNALIGNED_LOAD, 4, records.UNALIGNED),
    Mutation(
        "startup.cpp",
        "CCR_STKALIGN | ",
        "",
        records.test_zero_division_and_unaligned_access_trap_and_stacks_are_aligned,
    ),
    recording("kFramePc = 6", "kFramePc = 5"),
    recording("kFrameLr = 5", "kFrameLr = 4"),
    recording("GPBR->SYS_GPBR[kPc].write(frame[kFramePc]);", ""),
    recording("GPBR->SYS_GPBR[kCfsr].write(SCB->CFSR.read());", ""),
    recording(
        "GPBR->SYS_GPBR[kBfar].write(SCB->BFAR.read());", "", records.LOAD_FROM_NOWHERE, 4, records.BFARVALID
    ),
    recording("(exception & 0xFFU) << 8U", "(exception & 0xFFU) << 4U"),
    recording("exception >= kHardFault", "exception > kHardFault"),
    telling(
        " && reset != link::Reset::user",
        "",
        records.test_a_record_from_before_a_reset_by_the_user_is_old,
    ),
    telling(
        "(recorded & kMagicMask) == kMagic && ",
        "",
        records.test_a_register_without_a_record_reports_nothing,
    ),
    telling(
        "GPBR->SYS_GPBR[kRecord].write(0);",
        "",
        records.test_a_record_is_reported_after_the_next_reset_and_never_again,
    ),
    telling(
        "      report.boot_fault = static_cast<std::uint8_t>(recorded);",
        "",
        records.test_a_record_is_reported_after_the_next_reset_and_never_again,
    ),
    telling(
        "kUsageFault = 6",
        "kUsageFault = 60",
        records.test_an_unexpected_interrupt_is_recorded_with_its_number,
    ),
    Mutation(
        "faults.cpp",
        "frame >= __stack_bottom && frame + kFrameWords <= __stack_top",
        "frame != nullptr",
        safety.test_a_lost_stack_is_no_way_around_the_fault_handler,
    ),
    Mutation(
        "faults.cpp",
        '      "mov sp, r1\\n\\t"\n',
        "",
        safety.test_a_lost_stack_is_no_way_around_the_fault_handler,
    ),
)

ORDER = (
    motors(
        "    disable_drivers();\n    PWM->PWM_OSS.write(kOverride);\n",
        "    disable_drivers();\n",
        noise.test_stopping_takes_the_outputs_low_at_once_and_not_at_the_end_of_their_period,
    ),
    motors("    disable_drivers();\n    PWM->", "    PWM->", safety.test_stopping_takes_every_enable_low),
    telling(
        "  motors::cut();\n  const std::uint32_t exception = exception_number();",
        "  const std::uint32_t exception = exception_number();\n"
        "  record(heli::link::Fault::hard_fault, exception);\n  motors::cut();",
        records.test_the_bridges_go_off_before_a_fault_is_recorded,
    ),
    telling(
        "  motors::cut();\n  record(link::Fault::hard_fault, 0);",
        "  record(link::Fault::hard_fault, 0);\n  motors::cut();",
        records.test_the_bridges_go_off_before_giving_up_is_recorded,
    ),
    starting("  motors::hold_off();\n", ""),
    starting(
        "  motors::hold_off();\n  watchdog::start();",
        "  watchdog::start();\n  initialise_memory();\n  motors::hold_off();",
    ),
    Mutation(
        "motors.cpp",
        "  if constexpr (kEnablesD != 0U) drive_output(PIOD, kEnablesD, kOff);\n",
        "",
        timing.test_enables_are_driven_low_within_microseconds_of_a_reset,
    ),
    Mutation(
        "startup.cpp",
        "for (std::uint32_t* to = __bss_start; to != __bss_end; ++to) *to = 0;",
        "",
        claims.test_opening_the_port_is_distinguished_from_power_up,
    ),
    Mutation(
        "main.cpp",
        "  tick_timer::acknowledge();\n  flight_core->tick(last_tick);",
        "  flight_core->tick(last_tick);\n  tick_timer::acknowledge();",
        timing.test_a_tick_that_takes_longer_than_its_millisecond_is_one_late_tick,
    ),
    Mutation(
        "main.cpp", "  last_tick = tick_timer::timing();\n", "", timing.test_a_tick_takes_as_long_as_it_does
    ),
    bouncing(
        f"{CLEAR_EDGES}{LOOK_AT_LINES}",
        f"{LOOK_AT_LINES}{CLEAR_EDGES}",
    ),
    Mutation(
        "encoders.cpp",
        "  line_state = PIOD->PIO_PDSR.read() & kEdgeMask;\n",
        "",
        noise.test_where_the_travel_encoder_stands_at_the_start_is_its_zero,
        (1,),
    ),
    stepping("    -1,       0,        kIllegal, 1,", "    0,        0,        kIllegal, 1,"),
    stepping("    1,        kIllegal, 0,        -1,", "    1,        kIllegal, 0,        1,"),
    stepping("    kIllegal, -1,       1,        0,", "    kIllegal, 1,        -1,       0,"),
)

RACES = (
    waking("  mask_interrupts();\n", ""),
    waking(
        "if (ticks.load(std::memory_order_relaxed) == seen) wait_for_interrupt();", "wait_for_interrupt();"
    ),
    waking(
        "    const std::uint32_t seen = ticks.load(std::memory_order_relaxed);\n    code.core.poll();",
        "    code.core.poll();\n    const std::uint32_t seen = ticks.load(std::memory_order_relaxed);",
    ),
    Mutation(
        "tick_timer.cpp",
        " + kPeriod / 2)",
        ")",
        timing.test_an_edge_between_two_looks_at_the_clock_makes_no_tick_late,
    ),
    Mutation(
        "tick_timer.cpp",
        "const std::uint32_t due = free_channel().TC_CV.read() - since_due;",
        "const std::uint32_t due = due_at + kPeriod + 0U * since_due;",
        timing.test_ticks_that_nobody_served_make_the_next_one_late_by_their_number,
        (4.3,),
    ),
    missing("missed_ticks > 0 || ", "", 2.1),
    missing("missed_ticks * link::kTick_us + ", "", 4.3),
    missing("kPeriod / 2) / kPeriod", "kPeriod) / kPeriod", 1.5),
    Mutation(
        "tick_timer.cpp",
        " || elapsed >= kPeriod",
        "",
        timing.test_a_tick_that_takes_longer_than_its_millisecond_is_one_late_tick,
    ),
    Mutation(
        "watchdog.cpp",
        "kInterval = 16",
        "kInterval = 1",
        timing.test_the_watchdog_is_restarted_every_16_ticks_and_no_oftener,
    ),
    Mutation(
        "watchdog.cpp",
        "  restarted_at = ticks;\n",
        "",
        timing.test_the_watchdog_is_restarted_every_16_ticks_and_no_oftener,
    ),
    Mutation(
        "watchdog.cpp",
        "if (ticks - restarted_at < kInterval) return;",
        "",
        timing.test_an_idle_loop_that_other_interrupts_wake_does_not_hide_a_tick_that_died,
    ),
    receiving(
        "remaining > 2U",
        "remaining > 0U",
        claims.test_the_board_hears_again_after_a_stall_that_filled_its_receive_ring,
        0,
        1023,
    ),
    receiving(
        "if (offered - fetched > kReceiveHalf) return;",
        "",
        claims.test_bytes_that_find_no_room_are_lost_and_no_older_ones,
    ),
    receiving(
        "if (next_counter.read() != 0U) return false;",
        "",
        claims.test_bytes_that_find_no_room_are_lost_and_no_older_ones,
    ),
    receiving(
        "std::memcpy(transmit_ring, bytes + first, count - first);",
        "",
        claims.test_no_byte_of_the_board_is_lost_or_wrong_wherever_its_ring_ends,
    ),
    receiving(
        "available < until_ring_end ? available : until_ring_end",
        "waiting",
        claims.test_no_byte_of_the_board_is_lost_or_wrong_wherever_its_ring_ends,
    ),
    Mutation(
        "startup.cpp",
        "to != stack_pointer(); ++to) *to = stack::kPaint",
        "to != __stack_bottom; ++to) *to = stack::kPaint",
        claims.test_first_answer_comes_within_50_ms_of_power_up,
    ),
)

CORE = (
    core(
        "flight/supervisor.cpp",
        "  at_arming_.overruns = observation_->overruns;\n",
        "",
        since_when.test_late_ticks_from_before_arming_are_no_fault_and_later_ones_are,
    ),
    core(
        "flight/supervisor.cpp",
        "    at_arming_.illegal[axis] = observation_->illegal[axis];\n",
        "",
        claims.test_illegal_transitions_are_counted_beyond_16_bits,
        2,
    ),
    core(
        "core.cpp",
        "      filters_[axis].restart();\n",
        "",
        since_when.test_an_arm_that_was_zeroed_just_now_is_not_moving,
    ),
    core(
        "flight/supervisor.cpp",
        "    setpoints_.hold_at(kTravel, observation_->angle_rad[kTravel]);\n",
        "",
        since_when.test_a_hold_stays_where_it_began_on_every_axis_that_it_holds,
    ),
    core(
        "flight/limits.cpp",
        "  // Checked first, because a wrong count exceeds the other limits too.\n"
        "  if (observation.overload_edges > 0U) {",
        "  if (false) {",
        safety.test_edges_too_fast_to_count_switch_off_and_inform_the_host,
        2.5e6,
        1,
    ),
)

BOOT_IDS = (
    numbering("PMC->PMC_PCER1.write(bit(ID_TRNG - 32));", ""),
    numbering("kKey | TRNG_CR_ENABLE", "kKey"),
    numbering("kMaxPolls = 100", "kMaxPolls = 0"),
    numbering("TRNG_CR_KEY(0x524E47)", "TRNG_CR_KEY(0x524E46)"),
)

SUBTLE = (*LOCK_TIMES, *FILTERS, *TRAPS, *ORDER, *RACES, *CORE, *BOOT_IDS)
