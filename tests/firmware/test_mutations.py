"""One wrong register in any driver is noticed: each mutation must break the claim beside it."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from heli_host.errors import HeliError
from heli_host.link.declaration import Fault

from firmware.due.report import read_image
from tests.firmware import test_board as claims
from tests.firmware.conftest import ROOT
from tests.firmware.desk import Board

due = pytest.importorskip("heli_sim.due._due", reason="the emulated Due is not built: make setup")
pytest.importorskip("elftools", reason="pyelftools is missing: make setup")


@dataclass(frozen=True)
class Mutation:
    """A mistake in a driver.

    Parameters
    ----------
    file : str
        In firmware/due.
    right : str
        What stands there, once.
    wrong : str
        What a slip would make of it.
    claim : callable
        A test of test_board that must fail then.
    arguments : tuple
        What it takes besides a board, or besides ELF and image.
    """

    file: str
    right: str
    wrong: str
    claim: Callable[..., None]
    arguments: tuple[Any, ...] = ()


def pwm(right: str, wrong: str) -> Mutation:
    return Mutation(
        "motors.cpp", right, wrong, claims.test_duties_are_the_voltages_within_one_step, (6.0, 3.0)
    )


def encoders(right: str, wrong: str) -> Mutation:
    return Mutation("encoders.cpp", right, wrong, claims.test_encoders_count_alike_and_a_before_b_is_up)


MUTATIONS = [
    # Clock: too few wait states, the wrong frequency, no crystal.
    Mutation("clock.cpp", "EEFC_FMR_FWS(4)", "EEFC_FMR_FWS(3)", claims.test_ticks_come_once_a_millisecond),
    Mutation(
        "clock.cpp",
        "EFC1->EEFC_FMR.write(kFlashWaitStates);",
        "",
        claims.test_both_flash_banks_have_the_wait_states_of_84_MHz,
    ),
    Mutation(
        "clock.cpp",
        "MULA(kPllMultiplier - 1)",
        "MULA(kPllMultiplier)",
        claims.test_ticks_come_once_a_millisecond,
    ),
    Mutation(
        "clock.cpp",
        "PMC_MCKR_PRES_CLK_2 | PMC_MCKR_CSS_PLLA_CLK",
        "PMC_MCKR_CSS_PLLA_CLK",
        claims.test_ticks_come_once_a_millisecond,
    ),
    Mutation("clock.cpp", " | CKGR_MOR_MOSCSEL", "", claims.test_ticks_come_once_a_millisecond),
    # Tick.
    Mutation(
        "tick_timer.cpp",
        "TC_RC.write(kPeriod)",
        "TC_RC.write(kPeriod - 42)",
        claims.test_ticks_come_once_a_millisecond,
    ),
    Mutation("tick_timer.cpp", " | TC_CMR_WAVSEL_UP_RC", "", claims.test_ticks_come_once_a_millisecond),
    Mutation(
        "tick_timer.cpp",
        "static_cast<void>(ticker().TC_SR.read());",
        "",
        claims.test_ticks_come_once_a_millisecond,
    ),
    Mutation(
        "tick_timer.cpp",
        "running().TC_CCR.write(TC_CCR_CLKEN | TC_CCR_SWTRG);",
        "",
        claims.test_a_tick_that_is_late_is_counted_and_reported,
    ),
    # Encoders.
    encoders("TC_CMR_TCCLKS_XC0", "TC_CMR_TCCLKS(0)"),
    encoders(" | TC_BMR_EDGPHA", ""),
    encoders(" | TC_BMR_POSEN", ""),
    encoders("bit(ID_TC6 - 32)", "bit(ID_TC6 - 31)"),
    encoders("PIOD->PIO_IER.write(kTravelMask)", "PIOD->PIO_IER.write(1)"),
    encoders("static_cast<void>(PIOD->PIO_ISR.read());", ""),
    encoders("start_decoder(TC2)", "start_decoder(TC1)"),
    Mutation(
        "encoders.cpp",
        "TC_QISR_QERR) != 0U",
        "TC_QISR_QERR) == 0U",
        claims.test_illegal_transitions_are_counted_on_every_encoder,
    ),
    Mutation(
        "priorities.hpp",
        "kEncoderPriority = 0",
        "kEncoderPriority = 9",
        claims.test_no_travel_edge_is_lost_at_200000_a_second,
    ),
    # PWM.
    pwm("PWM_CMR_CALG | ", ""),
    pwm(" | PWM_CMR_CPOL", ""),
    pwm("kGroup = kChannelMask | 1U", "kGroup = kChannelMask"),
    pwm("PWM_CPRD.write(kPeriod)", "PWM_CPRD.write(kPeriod - 100)"),
    pwm("PWM->PWM_SCUC.write(PWM_SCUC_UPDULOCK);", ""),
    pwm("PWM->PWM_OSC.write(kOverride);", ""),
    pwm("PWM->PWM_ENA.write(kGroup);", ""),
    pwm("to_peripheral_b(PIOC, kPwmPins)", "to_peripheral_a(PIOC, kPwmPins)"),
    pwm("PIOD->PIO_SODR.write(kEnablesD);", ""),
    pwm(
        "PWM_CDTYUPD.write(kPeriod - static_cast<std::uint32_t>(duty))",
        "PWM_CDTYUPD.write(static_cast<std::uint32_t>(duty))",
    ),
    Mutation(
        "motors.cpp",
        "PWM->PWM_FPE1.write(kStopInput);",
        "",
        claims.test_hardware_stop_cuts_the_duty_with_the_processor_halted,
    ),
    Mutation(
        "motors.cpp",
        "kStopInput = bit(2)",
        "kStopInput = bit(1)",
        claims.test_hardware_stop_cuts_the_duty_with_the_processor_halted,
    ),
    Mutation(
        "motors.cpp",
        " | PWM_FMR_FMOD(kStopInput)",
        "",
        claims.test_hardware_stop_trips_and_must_be_released_and_cleared,
    ),
    Mutation(
        "motors.cpp",
        "kStopIsHigh = true",
        "kStopIsHigh = false",
        claims.test_a_stop_input_that_is_not_wired_keeps_the_motors_off,
    ),
    Mutation(
        "motors.cpp",
        "PIOA->PIO_CODR.write(kEnablesA);",
        "PIOA->PIO_SODR.write(kEnablesA);",
        claims.test_a_flight_goes_where_it_is_sent_and_ends_on_the_table,
    ),
    # UART and its PDC.
    Mutation(
        "uart.cpp",
        "UART_BRGR_CD(kDivider)",
        "UART_BRGR_CD(kDivider + 1)",
        claims.test_first_answer_comes_within_50_ms_of_power_up,
    ),
    Mutation("uart.cpp", "UART_MR_PAR_NO", "0", claims.test_the_serial_line_is_8n1_at_exactly_250_kbaud),
    Mutation(
        "uart.cpp",
        "UART_PTCR_RXTEN | UART_PTCR_TXTEN",
        "UART_PTCR_RXTEN",
        claims.test_first_answer_comes_within_50_ms_of_power_up,
    ),
    Mutation(
        "uart.cpp",
        "UART_PTCR_RXTEN | UART_PTCR_TXTEN",
        "UART_PTCR_TXTEN",
        claims.test_first_answer_comes_within_50_ms_of_power_up,
    ),
    Mutation(
        "uart.cpp",
        "next_counter.write(count);",
        "next_counter.write(count - 1);",
        claims.test_no_byte_is_lost_of_20000_in_a_row_under_full_telemetry,
    ),
    Mutation(
        "uart.cpp",
        "next_pointer.write(address_of(bytes));",
        "pointer.write(address_of(bytes));",
        claims.test_no_byte_is_lost_of_20000_in_a_row_under_full_telemetry,
    ),
    # Flash.
    Mutation(
        "flash.cpp",
        "EEFC_FCR_FCMD(0x03)",
        "EEFC_FCR_FCMD(0x01)",
        claims.test_saved_parameters_outlive_a_reset_and_the_pages_take_turns,
    ),
    Mutation(
        "flash.cpp",
        "EFC1->EEFC_FMR.write(kProgrammingWaitStates);",
        "",
        claims.test_ticks_go_on_while_the_flash_is_written,
    ),
    Mutation(
        "flash.cpp",
        "kFirstPage + page)))",
        "page)))",
        claims.test_saved_parameters_outlive_a_reset_and_the_pages_take_turns,
    ),
    Mutation(
        "flash.cpp",
        "EEFC_FCR_FKEY(0x5A)",
        "EEFC_FCR_FKEY(0x5B)",
        claims.test_ticks_go_on_while_the_flash_is_written,
    ),
    # Watchdog, reset controller, backup registers.
    Mutation("watchdog.cpp", "WDT_MR_WDRSTEN | ", "", claims.test_a_stuck_interrupt_is_reset),
    Mutation(
        "watchdog.cpp",
        "kTimeout = 26",
        "kTimeout = 104",
        claims.test_what_hangs_is_reset_and_the_host_is_told,
        (claims.POLL, 20_000),
    ),
    Mutation(
        "watchdog.cpp",
        "WDT_MR_WDD(kTimeout)",
        "WDT_MR_WDD(kTimeout / 2)",
        claims.test_a_flight_goes_where_it_is_sent_and_ends_on_the_table,
    ),
    Mutation(
        "watchdog.cpp", "WDT_CR_KEY(0xA5)", "WDT_CR_KEY(0x5A)", claims.test_ticks_come_once_a_millisecond
    ),
    Mutation(
        "faults.cpp",
        "RSTC_CR_KEY(0xA5)",
        "RSTC_CR_KEY(0x5A)",
        claims.test_a_fault_switches_off_at_once_and_the_host_is_told,
        (claims.POLL, claims.UNDEFINED, Fault.HARD_FAULT),
    ),
    Mutation(
        "faults.cpp",
        "GPBR->SYS_GPBR[kRecord].write(kMagic",
        "GPBR->SYS_GPBR[kCfsr].write(kMagic",
        claims.test_a_fault_switches_off_at_once_and_the_host_is_told,
        (claims.POLL, claims.UNDEFINED, Fault.HARD_FAULT),
    ),
]


@dataclass(frozen=True)
class Workshop:
    """A copy of the firmware, compiled, in which one file at a time is spoilt."""

    folder: Path

    def make(self) -> Path:
        done = subprocess.run(
            [
                "make",
                "-s",
                "-C",
                self.folder / "due",
                f"BUILD={self.folder / 'build'}",
                self.folder / "build/heli.elf",
            ],
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        return self.folder / "build" / "heli.elf"

    def spoilt(self, mutation: Mutation) -> Path:
        path = self.folder / "due" / mutation.file
        text = path.read_text()
        assert text.count(mutation.right) == 1, (
            f"{mutation.file} has {text.count(mutation.right)} of: {mutation.right}"
        )
        path.write_text(text.replace(mutation.right, mutation.wrong))
        try:
            return self.make()
        finally:
            path.write_text(text)


@pytest.fixture(scope="module")
def workshop(elf: Path, tmp_path_factory: pytest.TempPathFactory) -> Workshop:
    folder = tmp_path_factory.mktemp("mutants")
    for part in ("core", "due"):
        shutil.copytree(ROOT / "firmware" / part, folder / part)
    # Names that a mutation leaves unused are not the mistake that is looked for.
    flags = folder / "due" / "compile.flags"
    flags.write_text(flags.read_text().replace("-Werror", "-w"))
    workshop = Workshop(folder)
    workshop.make()
    return workshop


@pytest.mark.parametrize("mutation", MUTATIONS, ids=lambda m: f"{m.file}:{m.right.strip()[:40]}")
def test_a_wrong_register_is_noticed(workshop: Workshop, mutation: Mutation) -> None:
    elf = workshop.spoilt(mutation)
    image = read_image(elf)
    takes_elf = "elf" in mutation.claim.__code__.co_varnames[: mutation.claim.__code__.co_argcount]
    with pytest.raises((AssertionError, HeliError, due.Stop, pytest.fail.Exception)):
        if takes_elf:
            mutation.claim(elf, image, *mutation.arguments)
        else:
            mutation.claim(Board(elf, image), *mutation.arguments)
