"""One mistake in one register of a driver each, and the claim that must notice."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from heli_host.declaration import Fault

from tests.firmware import test_board as claims
from tests.firmware import test_safety as safety
from tests.firmware.hangs import HANGS, POLL


@dataclass(frozen=True)
class Mutation:
    """A mistake in a driver.

    Parameters
    ----------
    file : str
        In firmware/due; with a slash in it, in firmware.
    right : str
        Code that the file has once.
    wrong : str
        The same code with a mistake.
    claim : callable
        A test that must fail then.
    arguments : tuple
        Its arguments after a board, or after ELF file and image.
    """

    file: str
    right: str
    wrong: str
    claim: Callable[..., None]
    arguments: tuple[Any, ...] = ()


def clock(right: str, wrong: str) -> Mutation:
    return Mutation("clock.cpp", right, wrong, claims.test_ticks_come_once_a_millisecond)


def tick(right: str, wrong: str, claim: Callable[..., None] | None = None) -> Mutation:
    return Mutation("tick_timer.cpp", right, wrong, claim or claims.test_ticks_come_once_a_millisecond)


def encoders(right: str, wrong: str) -> Mutation:
    return Mutation("encoders.cpp", right, wrong, claims.test_encoders_count_alike_and_a_before_b_is_up)


def overload(right: str, wrong: str) -> Mutation:
    return Mutation(
        "encoders.cpp",
        right,
        wrong,
        safety.test_edges_too_fast_to_count_switch_off_and_inform_the_host,
        (2.5e6, 1),
    )


def pwm(right: str, wrong: str) -> Mutation:
    return Mutation(
        "motors.cpp", right, wrong, claims.test_duties_are_the_voltages_within_one_step, (6.0, 3.0)
    )


def cutting(right: str, wrong: str) -> Mutation:
    return Mutation("motors.cpp", right, wrong, safety.test_pwm_pins_go_low_with_the_enables)


def stop(right: str, wrong: str, file: str = "motors.cpp") -> Mutation:
    return Mutation(
        file, right, wrong, safety.test_hardware_stop_cuts_the_duty_with_the_processor_halted, (safety.press,)
    )


def stopping(right: str, wrong: str) -> Mutation:
    return Mutation("motors.cpp", right, wrong, safety.test_stopping_takes_every_enable_low)


def greeting(right: str, wrong: str) -> Mutation:
    return Mutation("uart.cpp", right, wrong, claims.test_first_answer_comes_within_50_ms_of_power_up)


def stream(right: str, wrong: str) -> Mutation:
    return Mutation(
        "uart.cpp", right, wrong, claims.test_no_byte_is_lost_of_20000_in_a_row_under_full_telemetry
    )


def hearing(right: str, wrong: str) -> Mutation:
    return Mutation(
        "uart.cpp",
        right,
        wrong,
        claims.test_the_board_hears_again_after_a_stall_that_filled_its_receive_ring,
        (0, 1024),
    )


def saving(right: str, wrong: str) -> Mutation:
    return Mutation(
        "flash.cpp", right, wrong, claims.test_saved_parameters_outlive_a_reset_and_the_pages_take_turns
    )


def hanging(file: str, right: str, wrong: str) -> Mutation:
    return Mutation(
        file, right, wrong, safety.test_a_program_that_hangs_is_reset_and_the_host_is_informed, (HANGS[0],)
    )


def fault(right: str, wrong: str) -> Mutation:
    return Mutation(
        "faults.cpp",
        right,
        wrong,
        safety.test_a_fault_switches_off_at_once_and_the_host_is_informed,
        (POLL, safety.UNDEFINED, Fault.HARD_FAULT),
    )


def wire(
    right: str, wrong: str, claim: Callable[..., None], *arguments: object, file: str = "wiring.hpp"
) -> Mutation:
    return Mutation(file, right, wrong, claim, arguments)


CLOCK = (
    clock("EEFC_FMR_FWS(4)", "EEFC_FMR_FWS(3)"),
    clock("EFC0->EEFC_FMR.write(kFlashWaitStates);", ""),
    clock("EFC1->EEFC_FMR.write(kFlashWaitStates);", ""),
    clock("CKGR_MOR_KEY(0x37)", "CKGR_MOR_KEY(0x73)"),
    clock(" | CKGR_MOR_MOSCXTEN;", ";"),
    clock(" | CKGR_MOR_MOSCSEL", ""),
    clock("CKGR_PLLAR_ONE | ", ""),
    clock("MULA(kPllMultiplier - 1)", "MULA(kPllMultiplier)"),
    clock("PMC_MCKR_PRES_CLK_2 | PMC_MCKR_CSS_PLLA_CLK", "PMC_MCKR_CSS_PLLA_CLK"),
)

TICK = (
    tick("bit(ID_TC3) | bit(ID_TC4)", "bit(ID_TC3)"),
    tick("TC_RC.write(kPeriod)", "TC_RC.write(kPeriod - 42)"),
    tick(" | TC_CMR_WAVSEL_UP_RC", ""),
    tick("TC_IER_CPCS", "bit(0)"),
    tick("kInterrupt = ID_TC3", "kInterrupt = ID_TC4"),
    tick("tick_channel().TC_CCR.write(TC_CCR_CLKEN | TC_CCR_SWTRG);", ""),
    tick("static_cast<void>(tick_channel().TC_SR.read());", ""),
    tick(
        "free_channel().TC_CCR.write(TC_CCR_CLKEN | TC_CCR_SWTRG);",
        "",
        claims.test_a_tick_that_is_late_is_counted_and_reported,
    ),
)

ENCODERS = (
    encoders("bit(ID_TC0)", "bit(ID_TC3)"),
    encoders("bit(ID_TC6 - 32)", "bit(ID_TC6 - 31)"),
    encoders("TC_CMR_TCCLKS_XC0", "TC_CMR_TCCLKS(0)"),
    encoders("TC_BMR_QDEN | ", ""),
    encoders(" | TC_BMR_POSEN", ""),
    encoders(" | TC_BMR_EDGPHA", ""),
    encoders("TC_CCR_CLKEN | TC_CCR_SWTRG", "TC_CCR_SWTRG"),
    encoders("start_decoder(TC2)", "start_decoder(TC1)"),
    encoders("  tc->TC_CHANNEL[0].TC_CMR.write(0);\n", "  tc->TC_CHANNEL[0].TC_CMR.write(kPosition);\n"),
    encoders(
        "PIOD->PIO_IER.write(kEdgeMask);\n  enable_interrupt",
        "PIOD->PIO_IER.write(1);\n  enable_interrupt",
    ),
    encoders("static_cast<void>(PIOD->PIO_ISR.read());", ""),
    encoders("enable_interrupt(ID_PIOD,", "enable_interrupt(ID_PIOC,"),
    Mutation(
        "encoders.cpp",
        "TC_QISR_QERR) != 0U",
        "TC_QISR_QERR) == 0U",
        claims.test_illegal_transitions_are_counted_on_every_encoder,
    ),
    overload("PIOD->PIO_IDR.write(kEdgeMask);", ""),
    overload("overloaded = true;", ""),
    overload("PIOD->PIO_IER.write(kEdgeMask);\n  return", "return"),
    overload("overloaded = false;", ""),
    overload("kMaxEdges = 400", "kMaxEdges = 4000"),
    Mutation(
        "encoders.cpp", "  edges_in_tick = 0;", "", claims.test_no_travel_edge_is_lost_at_200000_a_second
    ),
    Mutation(
        "encoders.cpp",
        "kMaxEdges = 400",
        "kMaxEdges = 150",
        safety.test_200000_edges_a_second_are_no_overload,
    ),
    Mutation(
        "encoders.cpp",
        "!= 0U) ++count;",
        "!= 0U && count < 0xFFFF) ++count;",
        claims.test_illegal_transitions_are_counted_beyond_16_bits,
        (1,),
    ),
    Mutation(
        "encoders.cpp",
        "reading.illegal[wiring::kInterruptAxis] = illegal_edges;",
        "reading.illegal[wiring::kInterruptAxis] = illegal_edges < 0xFFFF ? illegal_edges : 0xFFFF;",
        claims.test_illegal_transitions_are_counted_beyond_16_bits,
        (2,),
    ),
    Mutation(
        "priorities.hpp",
        "kEncoderPriority = 0",
        "kEncoderPriority = 9",
        claims.test_no_travel_edge_is_lost_at_200000_a_second,
    ),
)

MOTORS = (
    pwm("PWM_CMR_CALG | ", ""),
    pwm(" | PWM_CMR_CPOL", ""),
    pwm("kGroup = kChannelMask | 1U", "kGroup = kChannelMask"),
    pwm("PWM_CPRD.write(kPeriod)", "PWM_CPRD.write(kPeriod - 100)"),
    pwm("PWM->PWM_SCUC.write(PWM_SCUC_UPDULOCK);", ""),
    pwm("PWM->PWM_OSC.write(kOverride);", ""),
    pwm("PWM->PWM_ENA.write(kGroup);", ""),
    pwm("to_peripheral_b(PIOC, kPwmPins)", "to_peripheral_a(PIOC, kPwmPins)"),
    pwm("set_enables<true>();", ""),
    pwm("port->PIO_OER.write(mask);", ""),
    pwm("kPwmInverted ? steps : kPeriod - steps", "kPwmInverted ? kPeriod - steps : steps"),
    pwm("wiring::kFrontForwardChannel, front > 0", "wiring::kFrontReverseChannel, front > 0"),
    stopping("kOn != wiring::kEnableInverted", "kOn == wiring::kEnableInverted"),
    stopping("if constexpr (kEnablesB != 0U) set_level(PIOB, kEnablesB, kHigh);", ""),
    stopping("if constexpr (kEnablesD != 0U) set_level(PIOD, kEnablesD, kHigh);", ""),
    cutting("ID_PWM - 32));\n  PWM->PWM_OSS.write(kOverride);\n}", "ID_PWM - 32));\n}"),
    cutting("  disable_drivers();\n  PMC->", "  PMC->"),
    stop("PWM->PWM_FPE1.write(kStopInput);", ""),
    stop("kStopInput = bit(2)", "kStopInput = bit(1)"),
    Mutation(
        "motors.cpp",
        "kStopInput * 0x01010101U",
        "kStopInput * 0x00010101U",
        safety.test_every_half_bridge_has_the_stop_enabled_in_its_own_channel_too,
    ),
    Mutation(
        "motors.cpp",
        "PWM_FMR_FMOD(kStopInput) | ",
        "",
        safety.test_hardware_stop_trips_and_must_be_released_and_cleared,
    ),
    Mutation(
        "wiring.hpp",
        "kStopIsHigh = true",
        "kStopIsHigh = false",
        safety.test_a_stop_input_that_is_not_wired_keeps_the_motors_off,
    ),
)

UART = (
    greeting("UART_BRGR_CD(kDivider)", "UART_BRGR_CD(kDivider + 1)"),
    greeting("UART_MR_PAR_NO", "0"),
    greeting("UART_CR_RXEN | UART_CR_TXEN", "UART_CR_TXEN"),
    greeting("UART_CR_RXEN | UART_CR_TXEN", "UART_CR_RXEN"),
    greeting("UART_PTCR_RXTEN | UART_PTCR_TXTEN", "UART_PTCR_RXTEN"),
    greeting("UART_PTCR_RXTEN | UART_PTCR_TXTEN", "UART_PTCR_TXTEN"),
    greeting("bit(ID_UART)", "bit(ID_UART + 1)"),
    greeting("to_peripheral_a(PIOA,", "to_peripheral_b(PIOA,"),
    greeting("UART->UART_RPR.write(address_of(receive_ring));", ""),
    hearing(
        "received = offered - bytes_to_move(UART->UART_RCR, UART->UART_RNCR);",
        "received += (UART->UART_RPR.read() - address_of(receive_ring) - received) % kReceiveBytes;",
    ),
    stream("UART->UART_RCR.write(kReceiveHalf);", "UART->UART_RCR.write(kReceiveHalf - 1);"),
    stream(
        "UART_RNPR.write(address_of(receive_ring + kReceiveHalf))",
        "UART_RNPR.write(address_of(receive_ring))",
    ),
    Mutation(
        "uart.cpp",
        " - bytes_to_move(UART->UART_TCR, UART->UART_TNCR)",
        "",
        claims.test_answers_that_wait_for_the_line_overwrite_nothing_that_is_being_sent,
    ),
    stream("next_counter.write(count);", "next_counter.write(count - 1);"),
    stream("next_pointer.write(address_of(bytes));", "pointer.write(address_of(bytes));"),
)

FLASH = (
    saving("EEFC_FCR_FCMD(0x03)", "EEFC_FCR_FCMD(0x01)"),
    saving("kFirstPage + page)))", "page)))"),
    saving("kBank = 0x000C0000", "kBank = 0x00080000"),
    saving("EEFC_FCR_FKEY(0x5A)", "EEFC_FCR_FKEY(0x5B)"),
    saving("EFC1->EEFC_FMR.write(kProgrammingWaitStates);", ""),
    saving("EFC1->EEFC_FMR.write(reading_mode);", "EFC1->EEFC_FMR.write(0);"),
    saving("EFC1->EEFC_FCR.write(kKey", "EFC0->EEFC_FCR.write(kKey"),
)

WATCHDOG = (
    hanging("watchdog.cpp", "WDT_MR_WDRSTEN | ", ""),
    hanging("startup.cpp", "watchdog::start();", ""),
    hanging("watchdog.cpp", "kTimeout = 26", "kTimeout = 104"),
    Mutation(
        "watchdog.cpp",
        "kInterval = 16",
        "kInterval = 40",
        safety.test_the_watchdog_leaves_a_normal_flight_alone_with_three_times_to_spare,
    ),
    Mutation(
        "watchdog.cpp",
        "WDT_MR_WDD(kTimeout)",
        "WDT_MR_WDD(kTimeout / 2)",
        claims.test_ticks_come_once_a_millisecond,
    ),
    Mutation(
        "watchdog.cpp", "WDT_CR_KEY(0xA5)", "WDT_CR_KEY(0x5A)", claims.test_ticks_come_once_a_millisecond
    ),
)

FAULTS = (
    fault("RSTC_CR_KEY(0xA5)", "RSTC_CR_KEY(0x5A)"),
    fault("RSTC_CR_PROCRST | ", ""),
    fault(" | RSTC_CR_PERRST", ""),
    fault("GPBR->SYS_GPBR[kRecord].write(kMagic", "GPBR->SYS_GPBR[kCfsr].write(kMagic"),
    Mutation(
        "faults.cpp",
        "RSTC_SR_RSTTYP.of(RSTC->RSTC_SR.read())",
        "RSTC->RSTC_SR.read()",
        claims.test_opening_the_port_is_distinguished_from_power_up,
    ),
    Mutation(
        "main.cpp",
        "if (!stack::intact()) faults::give_up();",
        "",
        safety.test_a_stack_that_went_too_deep_is_a_fault,
    ),
    Mutation(
        "cortex_m3.hpp",
        "8U * (number % 4U) + 4U",
        "8U * (number % 4U)",
        claims.test_no_travel_edge_is_lost_at_200000_a_second,
    ),
)

# An input is heard whichever peripheral its pin is given to (datasheet on PIO, "I/O lines"), so
# only outputs can be wrong there.
WIRES = (
    wire(
        "kFrontForward{PIOC, 21}",
        "kFrontForward{PIOC, 20}",
        claims.test_duties_are_the_voltages_within_one_step,
        6.0,
        3.0,
    ),
    wire(
        "kBackReverseEnable{PIOD, 3}",
        "kBackReverseEnable{PIOD, 2}",
        safety.test_bridges_are_off_from_power_up_until_armed,
    ),
    wire(
        "kTransmit{PIOA, 9}",
        "kTransmit{PIOA, 10}",
        claims.test_first_answer_comes_within_50_ms_of_power_up,
        file="pins.hpp",
    ),
    wire(
        "bit(ID_PIOC) | bit(ID_PIOD)",
        "bit(ID_PIOC)",
        claims.test_encoders_count_alike_and_a_before_b_is_up,
        file="pins.hpp",
    ),
    wire("kTc0Axis = kElevation", "kTc0Axis = kPitch", claims.test_encoders_count_alike_and_a_before_b_is_up),
)

MUTATIONS = (*CLOCK, *TICK, *ENCODERS, *MOTORS, *UART, *FLASH, *WATCHDOG, *FAULTS, *WIRES)
