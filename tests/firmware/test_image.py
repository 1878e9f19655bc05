"""The linked firmware keeps its bounds; a board with other wiring flies with its own pins.toml."""

import dataclasses
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from firmware.due import report
from firmware.due.report import Function, Image
from firmware.generator.declared import DeclarationError
from firmware.generator.wiring import CHIP_PINS, generate_header, read_pins, rows
from tests.firmware.built import BUILD, ROOT, built_elf
from tests.firmware.cost import FLAGS, Costs, link_program, measure_costs

FLASH_END = 0x00100000
PARAMETER_PAGES = 2 * 512


@pytest.mark.emulated
def test_every_bound_holds(image: Image) -> None:
    assert report.findings(image) == []


@pytest.mark.emulated
def test_program_leaves_the_parameter_pages_alone(image: Image) -> None:
    assert image.flash_bytes <= 512 * 1024 - PARAMETER_PAGES
    assert all(address < FLASH_END - PARAMETER_PAGES for address in image.vectors[1:])


@pytest.mark.emulated
def test_reset_begins_at_the_top_of_the_stack_in_the_reset_handler(image: Image) -> None:
    assert image.vectors[0] == image.symbols["__stack_top"]
    assert image.vectors[0] % 8 == 0
    assert image.vectors[1] == image.symbols["reset_handler"] | 1


@pytest.mark.emulated
def test_every_vector_leads_somewhere(image: Image) -> None:
    assert len(image.vectors) == 16 + 45
    expected = {1: "reset_handler", 16 + 14: "encoder_interrupt", 16 + 30: "tick_interrupt"}
    for number in range(1, len(image.vectors)):
        handler = expected.get(number, "fault_entry")
        assert image.vectors[number] == image.symbols[handler] | 1, f"vector {number}"


@pytest.mark.emulated
def test_stack_lies_below_all_data(image: Image) -> None:
    assert image.symbols["__stack_bottom"] == 0x20070000
    assert image.symbols["__stack_top"] <= image.symbols["__data_start"]


@pytest.mark.emulated
def test_no_function_in_double_precision_is_linked(image: Image) -> None:
    assert not [name for name in image.functions if name.startswith("__aeabi_d")]


@pytest.mark.emulated
def test_call_graph_follows_virtual_calls(image: Image) -> None:
    below_tick = image.reachable("tick_interrupt")
    assert any("DueBoard" in name and "write_motors" in name for name in below_tick)
    assert any("Cascade" in name and "update" in name for name in below_tick)


@pytest.mark.emulated
def test_the_tick_cannot_reach_what_the_idle_loop_asks_of_board_and_law(image: Image) -> None:
    below_tick = image.reachable("tick_interrupt", idle_loop=False)
    assert not [name for name in below_tick if "derive" in name or "write_page" in name]
    below_idle_loop = image.reachable("reset_handler")
    assert any("Cascade" in name and "derive" in name for name in below_idle_loop)
    assert any("DueBoard" in name and "write_page" in name for name in below_idle_loop)


@pytest.mark.emulated
def test_a_pointer_from_anywhere_may_lead_to_every_virtual_function(image: Image) -> None:
    blind = firmware_with_function(
        image, Function("blind", frozenset(), frozenset({None}), stack_bytes=0), "tick_interrupt"
    )
    below_tick = blind.reachable("tick_interrupt", idle_loop=False)
    virtual = {name for names in image.virtual.values() for name in names}
    # Except those that take what only the idle loop has.
    assert {name for name in virtual - below_tick if "IdleLoop" not in name} == set()
    assert any("Cascade" in name and "derive" in name for name in virtual - below_tick)


@pytest.mark.emulated
def test_divisions_of_the_idle_loop_are_seen(image: Image) -> None:
    assert "__aeabi_fdiv" in image.reachable("reset_handler")


def with_leaf(image: Image, name: str, caller: str, stack_bytes: int = 0) -> Image:
    """The same firmware with one more function, which calls nothing and is called by `caller`."""
    leaf = Function(name, frozenset(), slots=frozenset(), stack_bytes=stack_bytes)
    return firmware_with_function(image, leaf, caller)


def firmware_with_function(image: Image, function: Function, caller: str) -> Image:
    """The same firmware with one more function, called by `caller`."""
    functions = dict(image.functions)
    functions[function.name] = function
    functions[caller] = dataclasses.replace(
        functions[caller], calls=functions[caller].calls | {function.name}
    )
    symbols = {**image.symbols, function.name: FLASH_END - 1}
    return dataclasses.replace(image, functions=functions, symbols=symbols)


@pytest.mark.emulated
@pytest.mark.parametrize("name", ["__aeabi_ddiv", "__aeabi_dmul", "__aeabi_uldivmod", "__aeabi_idiv", "expf"])
def test_slow_arithmetic_in_the_tick_is_found(image: Image, name: str) -> None:
    assert any(name in line for line in report.findings(with_leaf(image, name, "tick_interrupt")))


@pytest.mark.emulated
@pytest.mark.parametrize("name", ["malloc", "_sbrk", "_Znwj", "_ZdlPv"])
def test_a_heap_is_found(image: Image, name: str) -> None:
    assert any(name in line for line in report.findings(with_leaf(image, name, "reset_handler")))


@pytest.mark.emulated
def test_a_deep_stack_is_found(image: Image) -> None:
    deep = with_leaf(image, "deep", "tick_interrupt", stack_bytes=3000)
    assert any("stack" in line for line in report.findings(deep))


@pytest.mark.emulated
def test_recursion_is_refused(image: Image) -> None:
    endless = Function("endless", frozenset({"tick_interrupt"}), slots=frozenset(), stack_bytes=8)
    with pytest.raises(report.ReportError, match="may call itself"):
        firmware_with_function(image, endless, "tick_interrupt").stack_needed_bytes()


@pytest.mark.emulated
def test_too_large_a_firmware_is_found(image: Image) -> None:
    flash_bytes, ram_bytes = report.FLASH_MAX_BYTES + 1, report.RAM_MAX_BYTES + 1
    large = dataclasses.replace(image, flash_bytes=flash_bytes, ram_bytes=ram_bytes)
    assert len(report.findings(large)) == 2


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
    assembler = ["arm-none-eabi-as", "-mcpu=cortex-m3"]
    subprocess.run([*assembler, here / "calls.s", "-o", folder / "deceptive.o"], check=True)
    link_program(program, folder / "calls.o", folder / "deceptive.o")
    return report.read_image(program)


@pytest.mark.emulated
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


@pytest.mark.emulated
@pytest.mark.parametrize("caller", ["calls_first", "calls_second_in_a_tail", "calls_a_member"])
def test_an_interrupt_has_no_idle_loop_to_give_to_a_virtual_function(calls: Image, caller: str) -> None:
    slow = {SLOW_FIRST, SLOW_SECOND}
    assert calls.callees(caller) & slow
    assert calls.callees(caller, idle_loop=False) == calls.callees(caller) - slow


@pytest.mark.emulated
def test_an_interrupt_reaches_a_function_of_the_idle_loop_that_it_calls_by_name(calls: Image) -> None:
    assert SLOW_FIRST in calls.reachable("calls_slow_directly", idle_loop=False)


@pytest.fixture(scope="module")
def costs(elf: Path) -> Costs:
    """Counted once for all claims."""
    return measure_costs(elf)


@pytest.mark.emulated
def test_a_tick_takes_at_most_7_percent_of_its_millisecond(costs: Costs) -> None:
    # They are 4,618 with GCC 12.2. GCC 8.3 needs a fifth more, and PlatformIO pins a version in between.
    assert 0 < costs.tick_instructions_mean < costs.tick_instructions_max <= 6000


@pytest.mark.emulated
def test_the_control_law_takes_a_third_of_that_and_less_than_three_loops_of_pid_v1(costs: Costs) -> None:
    assert 0 < costs.cascade_instructions_max <= 2000
    assert costs.cascade_instructions_max < costs.pid_v1_three_loops_instructions


@pytest.mark.emulated
def test_an_encoder_edge_takes_at_most_60_instructions(costs: Costs) -> None:
    assert 0 < costs.encoder_isr_instructions_max <= 60


PINS = ROOT / "firmware" / "pins.toml"
FIGURE = ROOT / "docs" / "figures" / "wiring.py"
# Every entry differs from the paper's wiring; the enables are on ports A to D.
OTHER = """
[encoders]
TC0 = "travel"
TC2 = "elevation"
interrupt = "pitch"
[front]
forward_pwm = "D6"
reverse_pwm = "D7"
forward_enable = "D33"
reverse_enable = "D52"
[back]
forward_pwm = "D8"
reverse_pwm = "D9"
forward_enable = "D42"
reverse_enable = "D27"
[pwm]
frequency_Hz = 10000
inverted = true
[enable]
inverted = true
[stop]
stops_when = "low"
"""


def edited(old: str, new: str) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        text = PINS.read_text()
        assert old in text
        path = folder / "my.toml"
        path.write_text(text.replace(old, new, 1))
        return path

    return write


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"D9" ', '"D3" ', "front.forward_pwm is 'D3'; only D9, D8, D7, D6 have a PWM output"),
        ('"D22"', '"D20"', "front.forward_enable is 'D20'; the board pulls it up"),
        ('"D22"', '"D26"', "an encoder or the stop needs it"),
        ('"D22"', '"A0"', "choose one of D14 to D53"),
        ('"D24"', '"D22"', "back.forward_enable and front.forward_enable are both D22"),
        ('"D7"', '"D9"', "back.forward_pwm and front.forward_pwm are both D9"),
        ('TC2 = "pitch"', 'TC2 = "travel"', "name each of elevation, pitch, travel once"),
        ("frequency_Hz = 20000", "frequency_Hz = 30000", "choose 2000 to 25000"),
        ("frequency_Hz = 20000", "frequency_Hz = true", "pwm.frequency_Hz is True; write a whole number"),
        ("inverted = false", "inverted = 0", "pwm.inverted is 0; write true or false"),
        ('stops_when = "high"', 'stops_when = "open"', "choose high or low"),
        ("[enable]", "[enables]", "unknown section [enables]"),
        ("[stop]\n", "[stop]\npin = 3\n", "[stop] has an unknown entry 'pin'"),
        ('interrupt = "travel"', "", "[encoders] lacks interrupt"),
        ("[encoders]", "[encoders", "cannot be read"),
    ],
)
def test_a_wiring_that_the_board_cannot_have_is_refused(
    old: str, new: str, message: str, tmp_path: Path
) -> None:
    with pytest.raises(DeclarationError) as caught:
        read_pins(edited(old, new)(tmp_path))
    assert message in str(caught.value)


def test_a_missing_file_is_one_line(tmp_path: Path) -> None:
    process = subprocess.run(
        [sys.executable, ROOT / "firmware/pio/build.py", "--pins", tmp_path / "none.toml"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert process.returncode == 2
    assert process.stderr.startswith(f"error: {tmp_path / 'none.toml'}: cannot be read")
    assert process.stderr.count("\n") == 1


@pytest.mark.medium
def test_the_figure_of_another_wiring_has_its_pins(tmp_path: Path) -> None:
    (tmp_path / "my.toml").write_text(OTHER)
    drawn = tmp_path / "wiring.svg"
    subprocess.run([sys.executable, FIGURE, drawn, tmp_path / "my.toml"], check=True, capture_output=True)
    text = drawn.read_text()
    assert all(pin in text for pin in ("D33", "PC1", "D52", "PB21", "stop: normally open"))
    assert "D22" not in text


def test_every_pin_of_the_due_has_its_own_pin_of_the_chip() -> None:
    assert len(CHIP_PINS) == len(set(CHIP_PINS.values())) == 54
    # The emulated board's own table is the witness: sim/due_board/wiring.cpp.
    wires = (ROOT / "sim" / "due_board" / "wiring.cpp").read_text()
    for _, pin, _, _ in rows(read_pins(PINS)):
        port, number = CHIP_PINS[pin][1], CHIP_PINS[pin][2:]
        assert pin in ("D0", "D1") or f"pin_of('{port}', {number})" in wires


def build(pins: Path, folder: Path) -> Path:
    """Firmware for another wiring; objects that do not depend on it are those of the tests' firmware."""
    built_elf()
    wiring = read_pins(pins)
    (folder / "include").mkdir()
    (folder / "include" / "wiring.hpp").write_text(generate_header(wiring))
    shutil.copytree(BUILD, folder / "build", ignore=shutil.ignore_patterns("lock", "heli.*"))
    for depends in (folder / "build").rglob("*.d"):
        if "wiring.hpp" in depends.read_text():
            depends.with_suffix(".o").unlink()
        depends.unlink()
    subprocess.run(
        ["make", "-s", "-C", ROOT / "firmware" / "due", f"BUILD={folder / 'build'}",
         f"WIRING={folder / 'include'}", folder / "build" / "heli.elf"],
        check=True, capture_output=True, text=True,
    )  # fmt: skip
    return folder / "build" / "heli.elf"


@pytest.mark.emulated
def test_another_wiring_flies_and_stops(tmp_path: Path) -> None:
    pytest.importorskip("due_emulator._due", reason="the emulated Due is not built: make setup")
    pytest.importorskip("elftools", reason="pyelftools is missing: make setup")
    from firmware.due.report import read_image
    from tests.firmware.desk import RewiredBoard

    (tmp_path / "my.toml").write_text(OTHER)
    elf = build(tmp_path / "my.toml", tmp_path)
    board = RewiredBoard(elf, read_image(elf))
    for _ in range(1000):
        assert board.off()
        assert board.pwm_high()
        board.due.run_us(20.0)
    heli = board.connect()
    assert board.off() and board.bridges_idle()
    heli.take_off(0.0)
    heli.setpoint(elevation_deg=5.0, travel_deg=20.0)
    heli.wait(12.0)
    assert board.on()
    assert board.due.pwm_period_cycles(4) == 84_000_000 // 10_000
    elevation_deg, pitch_deg, travel_deg = board.angles_deg()
    assert abs(elevation_deg - 5.0) < 3.0
    assert abs(travel_deg - 20.0) < 6.0
    assert abs(pitch_deg) < 10.0
    board.press_stop()
    # In hardware, before the program knows: within one PWM period.
    board.due.run_us(250.0)
    assert board.bridges_idle()
    board.advance(3)
    assert board.off()
