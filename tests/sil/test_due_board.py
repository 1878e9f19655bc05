"""The board behind SimBoard: edges in, duties and bytes out, a millisecond at a time."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest
from due_emulator import Image, read_image
from heli_sim.due._due_board import DueBoard

from tests.due.conftest import Build, build

__all__ = ["build"]

pytestmark = pytest.mark.emulated

STILL = (0, 0, 0)
SYSTICK = 15


@pytest.fixture(scope="module")
def image(build: Build) -> Image:
    return read_image(build("board.c", "-O2"))


def test_a_new_program_at_the_same_path_is_read_again(build: Build, tmp_path: Path) -> None:
    path = tmp_path / "program.elf"
    addresses = []
    for name in ("board.c", "hello.c", "board.c"):
        path.write_bytes(build(name, "-O1").read_bytes())
        addresses.append({symbol.name for symbol in read_image(path).symbols})
    assert addresses[0] == addresses[2] != addresses[1]


def booted(image: Image) -> DueBoard:
    board = DueBoard()
    for address, data in image.segments:
        board.due.load(address, data)
    for _ in range(20):
        board.run(STILL, [])
    return board


def words(board: DueBoard, image: Image, name: str, count: int) -> tuple[int, ...]:
    return struct.unpack(f"<{count}i", board.due.peek(image.address(name), 4 * count))


def test_a_millisecond_is_84000_cycles(image: Image) -> None:
    board = booted(image)
    before = board.due.cycles
    for _ in range(100):
        board.run(STILL, [])
    assert board.due.cycles - before == pytest.approx(100 * 84_000, abs=20)


def test_edges_reach_decoders_and_interrupt(image: Image) -> None:
    board = booted(image)
    position = [0, 0, 0]
    for step in range(200):
        direction = 1 if step % 50 < 40 else -1
        count = (position[0], position[1], position[2])
        edges = [(20.0 + 50.0 * i, axis, direction) for i in range(10) for axis in range(3)]
        board.run(count, edges)
        for axis in range(3):
            position[axis] += 10 * direction
    board.run((position[0], position[1], position[2]), [])
    assert words(board, image, "counts", 3) == tuple(position) == (1200,) * 3


def test_no_count_is_lost_at_200000_edges_a_second_on_the_interrupt(image: Image) -> None:
    board = booted(image)
    for tick in range(50):
        board.run((0, 0, 200 * tick), [(5.0 * i, 2, 1) for i in range(200)])
    board.run((0, 0, 10_000), [])
    assert words(board, image, "counts", 3)[2] == 10_000


def test_duties_are_those_of_the_registers(image: Image) -> None:
    board = booted(image)
    board.due.poke(image.address("duty"), struct.pack("<4I", 1050, 0, 0, 700))
    assert board.run(STILL, []) == (0.0, 0.0, False)
    board.due.poke(image.address("on"), struct.pack("<I", 1))
    front, back, enabled = board.run(STILL, [])
    assert (front, back, enabled) == (0.5, -1 / 3, True)


def test_bytes_pass_at_25_a_millisecond(image: Image) -> None:
    board = booted(image)
    board.receive(bytes(range(100)))
    sent_values = [board.take_sent() for _ in range(6) if board.run(STILL, []) is not None]
    assert b"".join(sent_values) == bytes(b ^ 0x20 for b in range(100))
    assert max(len(part) for part in sent_values) == 25


def test_the_reset_line_stops_the_motors_for_205_ms(image: Image) -> None:
    board = booted(image)
    board.due.poke(image.address("duty"), struct.pack("<4I", 1050, 0, 0, 700))
    board.due.poke(image.address("on"), struct.pack("<I", 1))
    assert board.run(STILL, [])[2]
    board.reset()
    # The pins are inputs; pull-downs hold the enables.
    assert not board.run(STILL, [])[2]
    for _ in range(203):
        board.run(STILL, [])
    assert board.due.held_in_reset
    for _ in range(3):
        board.run(STILL, [])
    assert not board.due.held_in_reset
    assert board.due.last_reset == "user"


def test_power_up_starts_the_program_again(image: Image) -> None:
    board = booted(image)
    board.power_cycle()
    for _ in range(20):
        board.run(STILL, [])
    assert board.due.last_reset == "general"
    assert words(board, image, "loops", 1)[0] > 0


def ticking(build: Build) -> tuple[DueBoard, Image]:
    """A program whose SysTick comes every millisecond."""
    image = read_image(build("hello.c", "-O1"))
    board = DueBoard()
    for address, data in image.segments:
        board.due.load(address, data)
    board.align(SYSTICK)
    return board, image


def test_milliseconds_begin_with_the_programs_own_tick_after_every_start(build: Build) -> None:
    board, _ = ticking(build)
    for _ in range(2):
        for _ in range(30):
            board.run(STILL, [])
        for _ in range(20):
            end, before = board.due.cycles, board.due.last_entry_cycle(SYSTICK)
            board.run(STILL, [])
            assert board.due.last_entry_cycle(SYSTICK) - before == pytest.approx(84_000, abs=20)
            # The quiet moment after the last edge, and the entry itself.
            assert board.due.last_entry_cycle(SYSTICK) - end == pytest.approx(5 * 84, abs=30)
        board.power_cycle()


def test_time_begins_with_the_first_tick(build: Build) -> None:
    board, _ = ticking(build)
    board.run(STILL, [])
    assert board.due.last_entry_cycle(SYSTICK) > 0
    assert board.due.exception_stats(SYSTICK)[0] == 1


def test_edges_of_a_millisecond_come_between_its_command_and_the_next_tick(build: Build) -> None:
    board, _ = ticking(build)
    for _ in range(5):
        board.run(STILL, [])
    board.run(STILL, [(0.0, 2, 1), (999.9, 2, 1)])
    assert board.due.encoder(2) == 2
    assert board.due.cycles < board.due.last_entry_cycle(SYSTICK) + 84_000


def test_an_arm_that_is_moved_gives_edges(image: Image) -> None:
    board = booted(image)
    for _ in range(10):
        board.run((1000, 0, -400), [])
    assert words(board, image, "counts", 3) == (1000, 0, -400)


def test_the_stop_switch_is_closed_until_it_is_pressed_or_its_wire_is_cut(image: Image) -> None:
    board = booted(image)
    assert not board.due.pin("PD6")
    board.set_stop(True)
    assert board.due.pin("PD6")
    board.set_stop(False)
    assert not board.due.pin("PD6")


def test_an_erased_board_starts_nothing(image: Image) -> None:
    board = booted(image)
    board.erase()
    for _ in range(300):
        board.run(STILL, [])
    assert board.due.in_rom
    assert set(board.due.flash()) == {0xFF}
