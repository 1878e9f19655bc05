"""The linked firmware keeps its bounds, and the report that says so sees what it should."""

from __future__ import annotations

import dataclasses
import shutil
import subprocess
from pathlib import Path

import pytest

from firmware.due import report
from firmware.due.report import Function, Image
from tests.firmware.built import ROOT
from tests.firmware.cost import Costs, measure_costs

pytestmark = pytest.mark.emulated

FLASH_END = 0x00100000
PARAMETER_PAGES = 2 * 512


def test_every_bound_holds(image: Image) -> None:
    assert report.findings(image) == []


def test_program_leaves_the_parameter_pages_alone(image: Image) -> None:
    assert image.flash_bytes <= 512 * 1024 - PARAMETER_PAGES
    assert all(address < FLASH_END - PARAMETER_PAGES for address in image.vectors[1:])


def test_reset_begins_at_the_top_of_the_stack_in_the_reset_handler(image: Image) -> None:
    assert image.vectors[0] == image.symbols["__stack_top"]
    assert image.vectors[0] % 8 == 0
    assert image.vectors[1] == image.symbols["reset_handler"] | 1


def test_every_vector_leads_somewhere(image: Image) -> None:
    assert len(image.vectors) == 16 + 45
    expected = {1: "reset_handler", 16 + 14: "encoder_interrupt", 16 + 30: "tick_interrupt"}
    for number in range(1, len(image.vectors)):
        handler = expected.get(number, "fault_entry")
        assert image.vectors[number] == image.symbols[handler] | 1, f"vector {number}"


def test_stack_lies_below_all_data(image: Image) -> None:
    assert image.symbols["__stack_bottom"] == 0x20070000
    assert image.symbols["__stack_top"] <= image.symbols["__data_start"]


def test_no_function_in_double_precision_is_linked(image: Image) -> None:
    assert not [name for name in image.functions if name.startswith("__aeabi_d")]


def test_call_graph_follows_virtual_calls(image: Image) -> None:
    below_tick = image.reachable("tick_interrupt")
    assert any("DueBoard" in name and "write_motors" in name for name in below_tick)
    assert any("Cascade" in name and "update" in name for name in below_tick)


def test_the_tick_cannot_reach_what_the_idle_loop_asks_of_board_and_law(image: Image) -> None:
    below_tick = image.reachable("tick_interrupt", idle_loop=False)
    assert not [name for name in below_tick if "derive" in name or "write_page" in name]
    below_idle_loop = image.reachable("reset_handler")
    assert any("Cascade" in name and "derive" in name for name in below_idle_loop)
    assert any("DueBoard" in name and "write_page" in name for name in below_idle_loop)


def test_a_pointer_from_anywhere_may_lead_to_every_virtual_function(image: Image) -> None:
    blind = firmware_with_function(
        image, Function("blind", frozenset(), frozenset({None}), stack_bytes=0), "tick_interrupt"
    )
    below_tick = blind.reachable("tick_interrupt", idle_loop=False)
    virtual = {name for names in image.virtual.values() for name in names}
    # Except those that take what only the idle loop has.
    assert {name for name in virtual - below_tick if "IdleLoop" not in name} == set()
    assert any("Cascade" in name and "derive" in name for name in virtual - below_tick)


def test_divisions_of_the_idle_loop_are_seen(image: Image) -> None:
    assert "__aeabi_fdiv" in image.reachable("reset_handler")


def firmware_with_function(image: Image, function: Function, caller: str) -> Image:
    """The same firmware with one more function, called by `caller`."""
    functions = dict(image.functions)
    functions[function.name] = function
    functions[caller] = dataclasses.replace(
        functions[caller], calls=functions[caller].calls | {function.name}
    )
    symbols = {**image.symbols, function.name: FLASH_END - 1}
    return dataclasses.replace(image, functions=functions, symbols=symbols)


@pytest.mark.parametrize("name", ["__aeabi_ddiv", "__aeabi_dmul", "__aeabi_uldivmod", "__aeabi_idiv", "expf"])
def test_slow_arithmetic_in_the_tick_is_found(image: Image, name: str) -> None:
    slow = firmware_with_function(
        image, Function(name, frozenset(), slots=frozenset(), stack_bytes=0), "tick_interrupt"
    )
    assert any(name in line for line in report.findings(slow))


@pytest.mark.parametrize("name", ["malloc", "_sbrk", "_Znwj", "_ZdlPv"])
def test_a_heap_is_found(image: Image, name: str) -> None:
    heap = firmware_with_function(
        image, Function(name, frozenset(), slots=frozenset(), stack_bytes=0), "reset_handler"
    )
    assert any(name in line for line in report.findings(heap))


def test_a_deep_stack_is_found(image: Image) -> None:
    deep = firmware_with_function(
        image, Function("deep", frozenset(), slots=frozenset(), stack_bytes=3000), "tick_interrupt"
    )
    assert any("stack" in line for line in report.findings(deep))


def test_recursion_is_refused(image: Image) -> None:
    endless = Function("endless", frozenset({"tick_interrupt"}), slots=frozenset(), stack_bytes=8)
    with pytest.raises(report.ReportError, match="may call itself"):
        firmware_with_function(image, endless, "tick_interrupt").stack_needed_bytes()


def test_too_large_a_firmware_is_found(image: Image) -> None:
    flash_bytes, ram_bytes = report.FLASH_MAX_BYTES + 1, report.RAM_MAX_BYTES + 1
    large = dataclasses.replace(image, flash_bytes=flash_bytes, ram_bytes=ram_bytes)
    assert len(report.findings(large)) == 2


FLAGS = ROOT / "firmware" / "due" / "compile.flags"
PROGRAMS = ROOT / "sim" / "due" / "tests" / "programs"
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


@pytest.fixture(scope="module")
def costs(elf: Path) -> Costs:
    """Counted once for all claims."""
    return measure_costs(elf)


def test_a_tick_takes_at_most_7_percent_of_its_millisecond(costs: Costs) -> None:
    # They are 4,618 with GCC 12.2. GCC 8.3 needs a fifth more, and PlatformIO pins a version in between.
    assert 0 < costs.tick_instructions_mean < costs.tick_instructions_max <= 6000


def test_the_control_law_takes_a_third_of_that_and_less_than_three_loops_of_pid_v1(costs: Costs) -> None:
    assert 0 < costs.cascade_instructions_max <= 2000
    assert costs.cascade_instructions_max < costs.pid_v1_three_loops_instructions


def test_an_encoder_edge_takes_at_most_60_instructions(costs: Costs) -> None:
    assert 0 < costs.encoder_isr_instructions_max <= 60
