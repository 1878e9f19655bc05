"""The linked firmware keeps its bounds, and the report that says so sees what it should."""

from __future__ import annotations

import dataclasses

import pytest

from firmware.due import report
from firmware.due.report import Function, Image

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
