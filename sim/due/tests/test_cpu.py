"""The interpreter against unicorn after every instruction, and exceptions against the architecture manual."""

import os
import random
import struct
from pathlib import Path

import pytest
from due_chip import Build
from due_emulator import Due, Stop, new_due, read_image
from thumb import ENCODINGS, FLASH, FLASH_SIZE, RAM, RAM_SIZE, Oracle, random_block

LONG = os.environ.get("HELI_LONG") == "1"
RANDOM_INSTRUCTIONS = 500_000 if LONG else 60_000
COMPILED_INSTRUCTIONS = 125_000 if LONG else 20_000
SEED = 20_240_611
_CODE_FIRST, _CODE_LAST = FLASH + 0x1_0000, FLASH + 0x7_0000
_INTERESTING = (0, 1, 0x7FFF_FFFF, 0x8000_0000, 0xFFFF_FFFF)


@pytest.mark.emulated
def test_random_instructions_agree() -> None:
    rng = random.Random(SEED)
    oracle = Oracle()
    oracle.write(FLASH, rng.randbytes(FLASH_SIZE))
    oracle.write(RAM, rng.randbytes(RAM_SIZE))
    address = _CODE_FIRST
    observed: set[str] = set()
    while oracle.compared < RANDOM_INSTRUCTIONS:
        block = random_block(rng)
        if address + len(block.code) > _CODE_LAST:
            address = _CODE_FIRST
            oracle.forget_code()
        oracle.write(address, block.code + b"\x00\xbf\x00\xbf")
        for _ in range(2):
            registers = [
                rng.choice(_INTERESTING)
                if rng.random() < 0.3
                else rng.getrandbits(rng.choice((4, 8, 16, 32)))
                for _ in range(15)
            ]
            registers[13] = RAM + 0xC000
            registers[block.base] = RAM + 0x8000 + 4 * rng.randrange(64)
            registers[block.index] = 4 * rng.randrange(64)
            oracle.set_registers(registers, rng.getrandbits(5) << 27)
            oracle.run(address, address + len(block.code))
        observed.update(block.names)
        address += len(block.code) + 64
    print(f"seed {SEED}: {oracle.compared} random instructions, {len(observed)} encodings, no difference")
    assert observed >= {encoding.name for encoding in ENCODINGS}
    assert oracle.memory_is_equal()


@pytest.mark.emulated
@pytest.mark.parametrize("options", [("-O0",), ("-Os",), ("-O2",), ("-O3", "-funroll-loops")])
def test_compiled_programs_agree(build: Build, options: tuple[str, ...]) -> None:
    image = read_image(Path(build("compute.c", *options)))
    oracle = Oracle()
    oracle.write(RAM, bytes(RAM_SIZE))
    for address, data in image.segments:
        oracle.write(address, data)
    oracle.set_registers([0] * 13 + [RAM + RAM_SIZE, 0xFFFF_FFFF], 0)
    oracle.run(image.address("reset"), image.address("finished"), COMPILED_INSTRUCTIONS)
    print(f"{' '.join(options)}: {oracle.compared} compiled instructions, no difference")
    assert oracle.compared >= COMPILED_INSTRUCTIONS
    assert oracle.memory_is_equal()


pytestmark = pytest.mark.emulated

SCENARIO, TRACE = 0x2007_1000, 0x2007_1100
TO_HANDLER, TO_THREAD, TO_PROCESS = 0xFFFF_FFF1, 0xFFFF_FFF9, 0xFFFF_FFFD
SVC, PENDSV, SYSTICK, HARD, BUS, USAGE, IRQ0 = 11, 14, 15, 3, 5, 6, 16
DONE = 0xD0E
FORCED, DEBUG = 1 << 30, 1 << 31
UNDEFINED, INVSTATE, INVPC, NOCP, UNALIGNED, DIVBYZERO = (1 << bit for bit in (16, 17, 18, 19, 24, 25))
STACK_TOP = 0x2008_8000

SCENARIOS = {
    "svc_returns_behind_itself": (0, [0x5C, SVC, TO_THREAD, 0x5E, 1, 4]),
    "urgent_interrupt_preempts_a_handler": (
        1,
        [0x10, IRQ0, TO_THREAD, 0x11, IRQ0 + 1, TO_HANDLER, 0x1F, 0x1E, 0x7E],
    ),
    "less_urgent_ones_are_tail_chained_on_the_same_frame": (
        2,
        [
            *(0x10, IRQ0, TO_THREAD, 0x1E),
            *(0x11, IRQ0 + 1, TO_THREAD, 0x1F),
            *(0x12, IRQ0 + 2, TO_THREAD, STACK_TOP - 0x20),
            0x7E,
        ],
    ),
    "thread_on_the_process_stack": (3, [0x5C, SVC, TO_PROCESS, 0x2007_5000 - 0x20, 0x5E, 0x2007_5000]),
    "undefined_instruction_is_a_usage_fault": (4, [0x6F, USAGE, TO_THREAD, UNDEFINED, 0x7E]),
    "a_disabled_usage_fault_becomes_a_hard_fault": (5, [0xF0, HARD, TO_THREAD, FORCED, 0x7E]),
    "floating_point_is_a_fault": (6, [0x6F, USAGE, TO_THREAD, NOCP, 0x7E]),
    "dsp_is_a_fault": (7, [0x6F, USAGE, TO_THREAD, UNDEFINED, 0x7E]),
    "division_by_zero_gives_zero_or_a_fault": (8, [0, 0x6F, USAGE, TO_THREAD, DIVBYZERO, 0x7E]),
    "unaligned_ldm_is_a_fault": (9, [0x6F, USAGE, TO_THREAD, UNALIGNED, 0x7E]),
    "a_load_from_nowhere_is_a_precise_bus_fault": (
        10,
        [0xBF, BUS, TO_THREAD, 1 << 9 | 1 << 15, 0x9000_0000, 0x7E],
    ),
    "an_impossible_return_is_a_usage_fault": (11, [0x5C, SVC, TO_THREAD, 0x6F, USAGE, 0xFFFF_FFF4, INVPC]),
    "primask_holds_back": (12, [0xA1, 0x10, IRQ0, TO_THREAD, 0x1E, 0xA2]),
    "wfi_ends_on_a_masked_interrupt": (13, [0xA1, 0x57, SYSTICK, TO_THREAD, 0xA2]),
    "breakpoint_without_debugger_is_a_hard_fault": (14, [0xF0, HARD, TO_THREAD, DEBUG, 0x7E]),
    "frame_is_aligned_and_sp_comes_back": (16, [0x5C, SVC, TO_THREAD, 0, 1, 0x5E, 0]),
    "a_blocked_svc_is_a_hard_fault": (17, [0xF0, HARD, TO_THREAD, FORCED]),
    "an_it_block_goes_on_after_an_exception": (18, [0x5C, SVC, TO_THREAD, 0x5E, 5]),
    "an_exception_clears_the_exclusive_monitor": (19, [0, 0x5C, SVC, TO_THREAD, 0x5E, 1]),
    "wfe_and_its_event": (21, [0xA1, 0x57, SYSTICK, TO_THREAD, 0xA2]),
    "a_branch_to_an_even_address_is_a_fault": (22, [0x6F, USAGE, TO_THREAD, INVSTATE, 0, 0x7E]),
    "unprivileged_code_may_not_touch_the_nvic": (
        23,
        [1, 0xBF, BUS, TO_THREAD, 1 << 9 | 1 << 15, 0xE000_E200, 0x7E],
    ),
    "basepri_holds_back_what_is_not_more_urgent": (
        24,
        [0x11, IRQ0 + 1, TO_THREAD, 0x1F, 0xA1, 0x10, IRQ0, TO_THREAD, 0x1E, 0xA2],
    ),
    "pendsv_runs_after_the_handler_that_asked": (
        25,
        [0x5C, SVC, TO_THREAD, 0x5E, 0x9E, PENDSV, TO_THREAD, 0x7E],
    ),
    "bit_bands_reach_single_bits": (26, [1, 0x1081, 1]),
    "an_interrupt_that_pends_itself_runs_twice": (
        27,
        [0x13, IRQ0 + 3, TO_THREAD, 0x13, IRQ0 + 3, TO_THREAD, 0x7E],
    ),
    "one_priority_group_does_not_preempt_itself": (
        28,
        [0x10, IRQ0, TO_THREAD, 0x1E, 0x11, IRQ0 + 1, TO_THREAD, 0x1F, 0x7E],
    ),
}


@pytest.fixture(scope="module")
def program(build: Build) -> str:
    return str(build("exceptions.S"))


def run(program: str, scenario: int, us: float = 3000, parameter: int = 0) -> Due:
    due = new_due(read_image(program), strict=False)
    due.power_on()
    due.poke(SCENARIO, struct.pack("<II", scenario, parameter))
    due.poke(TRACE, bytes(256))
    due.run_us(us)
    return due


def trace(due: Due, count: int) -> list[int]:
    return list(struct.unpack(f"<{count}I", due.peek(TRACE, 4 * count)))


@pytest.mark.parametrize("claim", SCENARIOS)
def test_exception(program: str, claim: str) -> None:
    scenario, expected = SCENARIOS[claim]
    due = run(program, scenario)
    wanted = [*expected, DONE] if claim != "a_blocked_svc_is_a_hard_fault" else expected
    assert [hex(word) for word in trace(due, len(wanted))] == [hex(word) for word in wanted]


def test_a_fault_in_the_hard_fault_handler_locks_up(program: str) -> None:
    with pytest.raises(Stop, match="lockup: fault inside a handler of priority -1"):
        run(program, 15)


def test_sleep_on_exit_leaves_the_thread_asleep(program: str) -> None:
    due = run(program, 20)
    assert trace(due, 5) == [0x10, IRQ0, TO_THREAD, 0x1E, 0]
    asleep = due.sleep_cycles
    due.run_us(100)
    assert due.sleep_cycles - asleep == 400  # 4 MHz


def test_entry_and_tail_chaining_cost_their_cycles(program: str) -> None:
    due = run(program, 2)
    cost = due.exception_stats(IRQ0)
    assert cost.count == 1
    assert cost.instructions < cost.max_cycles < 3 * cost.instructions


def test_what_arrives_during_stacking_is_entered_first_on_the_same_frame(program: str) -> None:
    kinds = []
    for reload in range(1, 60):
        words = trace(run(program, 29, parameter=reload), 9)
        assert words[-1] == DONE
        systick = words.index(SYSTICK)
        if words.index(0xA1) > systick:
            kinds.append("before")
        elif words[systick + 1] == TO_HANDLER:
            kinds.append("nested")
        else:
            kinds.append("late" if words.index(0x10) > systick else "after")
    assert kinds == sorted(kinds, key=["before", "late", "nested", "after"].index)
    # Stacking takes 12 cycles; the instructions around it blur the edge.
    assert 12 <= kinds.count("late") <= 16
    assert "nested" in kinds
