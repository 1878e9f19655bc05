"""The call graph that size, stack and time are judged by leaves out no call through a pointer."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from firmware.due import report
from firmware.due.report import Image
from tests.firmware.built import ROOT

pytestmark = pytest.mark.emulated

FLAGS = ROOT / "firmware" / "due" / "compile.flags"
PROGRAMS = ROOT / "tests" / "due" / "programs"
SLOW_FIRST, SLOW_SECOND = "_ZN4Slow5firstE8IdleLoop", "_ZN4Slow6secondE8IdleLoop"
FIRST = {"_ZN4Idle5firstEv", "_ZN4Tick5firstEv", SLOW_FIRST}
SECOND = {"_ZN4Idle6secondEv", "_ZN4Tick6secondEv", SLOW_SECOND}
LOOSE = {"loose_first", "loose_second"}


@pytest.fixture(scope="module")
def calls(tmp_path_factory: pytest.TempPathFactory) -> Image:
    """A program that calls through pointers in every way, never inlined."""
    if shutil.which("arm-none-eabi-g++") is None:
        pytest.skip("the cross-compiler is not installed: make setup")
    here = Path(__file__).parent
    folder = tmp_path_factory.mktemp("calls")
    program = folder / "calls.elf"
    flags = [f"@{FLAGS}", "-fno-inline", "-fno-ipa-cp", "-fno-ipa-icf", "-fno-devirtualize"]
    subprocess.run(
        ["arm-none-eabi-g++", *flags, "-c", here / "calls.cpp", "-o", folder / "calls.o"], check=True
    )
    assembler: list[str | Path] = [
        "arm-none-eabi-as",
        "-mcpu=cortex-m3",
        here / "calls.s",
        "-o",
        folder / "deceptive.o",
    ]
    subprocess.run(assembler, check=True)
    subprocess.run(
        [
            "arm-none-eabi-gcc", "-mcpu=cortex-m3", "-mthumb", "-nostartfiles", "-T", PROGRAMS / "due.ld",
            PROGRAMS / "start.S", folder / "calls.o", folder / "deceptive.o", "-lgcc", "-o", program,
        ],
        check=True,
    )  # fmt: skip
    return report.read_image(program)


@pytest.mark.parametrize(
    ("caller", "reached"),
    [
        ("calls_first", FIRST | LOOSE),
        ("calls_second_in_a_tail", SECOND | LOOSE),
        ("calls_the_table", SECOND | LOOSE),
        ("calls_either", FIRST | SECOND | LOOSE),
        ("calls_what_it_is_given", FIRST | SECOND | LOOSE),
        ("calls_a_member", FIRST | SECOND | LOOSE),
        ("meets_at_a_label", FIRST | SECOND | LOOSE),
        ("overwritten", FIRST | SECOND | LOOSE),
        ("after_a_call", FIRST | SECOND | LOOSE),
        ("behind_a_table", FIRST | SECOND | LOOSE),
    ],
)
def test_a_call_through_a_pointer_reaches_all_that_it_may_and_a_virtual_one_its_place_in_the_tables(
    calls: Image, caller: str, reached: set[str]
) -> None:
    assert reached <= calls.callees(caller)
    assert not calls.callees(caller) & (FIRST | SECOND | LOOSE) - reached


@pytest.mark.parametrize("caller", ["calls_first", "calls_second_in_a_tail", "calls_a_member"])
def test_an_interrupt_has_no_idle_loop_to_give_to_a_virtual_function(calls: Image, caller: str) -> None:
    slow = {SLOW_FIRST, SLOW_SECOND}
    assert calls.callees(caller) & slow
    assert calls.callees(caller, idle_loop=False) == calls.callees(caller) - slow


def test_an_interrupt_reaches_a_function_of_the_idle_loop_that_it_calls_by_name(calls: Image) -> None:
    assert SLOW_FIRST in calls.reachable("calls_slow_directly", idle_loop=False)
