"""Single functions of the firmware with any argument, and power lost while parameters are saved."""

import ctypes
import random
import re
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from heli_host.board.heli import Heli
from heli_host.declaration import Fault, MessageId, Param, ParamSetMessage, ParamsSaveMessage, ParamsSource
from heli_host.link.frames import encode_frame
from heli_host.link.session import Session
from hypothesis import given
from hypothesis import strategies as st

from firmware.due.report import Image
from tests.firmware.built import ROOT, compile_here
from tests.firmware.desk import GPBR, MAGIC, POLL, SCRATCH, Board, call, enter, halt_at, recorded, store
from tests.running.long import samples

pytestmark = pytest.mark.emulated

READ_PAGE = "_ZN4heli3due5flash9read_pageEjPhj"
WRITE_PAGE = "_ZN4heli3due5flash10write_pageEjPKhj"
BOARD_READ_PAGE = "_ZN4heli3due8DueBoard9read_pageEjPhj"
BOARD_WRITE_PAGE = "_ZN4heli3due8DueBoard10write_pageEjPKhj"
PAGE = 256
PAGES = 4
FIRST_PAGE = 1024 - PAGES
"""Page of the upper flash bank, which has 1024."""
PARAMETERS = 0x0010_0000 - PAGES * PAGE
EFC1_FMR, EFC1_FCR = 0x400E_0C00, 0x400E_0C04
SET_LOCK, CLEAR_LOCK, KEY = 0x08, 0x09, 0x5A << 24
READING, PROGRAMMING = 4, 6
"""Wait states at 84 MHz; the vendor's header asks for six to program (CHIP_FLASH_WRITE_WAIT_STATE)."""
FRAME_BYTES = 32


@pytest.fixture
def idle(board: Board) -> Board:
    """A board that stands at the start of a turn of its idle loop."""
    board.advance(20)
    halt_at(board, POLL)
    return board


def put(board: Board, data: bytes, address: int = SCRATCH) -> None:
    board.due.poke(address, data)


def pattern(count: int, seed: int = 1) -> bytes:
    return random.Random(seed).randbytes(count)


def parameter_pages(board: Board) -> list[bytes]:
    flash = board.due.flash()
    return [flash[len(flash) - (PAGES - k) * PAGE :][:PAGE] for k in range(PAGES)]


def wait_states(board: Board) -> int:
    return board.register(EFC1_FMR) >> 8 & 0xF


# -- memory ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("to", range(4))
@pytest.mark.parametrize("source", range(4))
def test_memcpy_copies_so_many_bytes_and_no_other(idle: Board, to: int, source: int) -> None:
    data = pattern(64)
    for count in (0, 1, 3, 4, 5, 8, 11, 32):
        put(idle, data)
        put(idle, b"\x55" * 64, SCRATCH + 0x100)
        place = SCRATCH + 0x110 + to
        assert call(idle, "memcpy", place, SCRATCH + 8 + source, count) == place
        around = b"\x55" * (0x10 + to) + data[8 + source :][:count]
        assert idle.due.peek(SCRATCH + 0x100, 64) == around.ljust(64, b"\x55")


@pytest.mark.parametrize("to", range(4))
def test_memset_fills_so_many_bytes_and_no_other(idle: Board, to: int) -> None:
    for count in (0, 1, 2, 3, 4, 5, 7, 8, 13, 32):
        put(idle, b"\x55" * 64)
        place = SCRATCH + 0x10 + to
        assert call(idle, "memset", place, 0x1234_56C7, count) == place
        assert idle.due.peek(SCRATCH, 64) == (b"\x55" * (0x10 + to) + b"\xc7" * count).ljust(64, b"\x55")


def test_memcmp_orders_bytes_by_the_first_that_differs(idle: Board) -> None:
    for first, second, count, order in (
        (b"abcd", b"abcd", 4, 0),
        (b"abcd", b"abce", 3, 0),
        (b"abcd", b"abce", 4, -1),
        (b"abce", b"abcd", 4, 1),
        (b"\x80", b"\x7f", 1, 1),
        (b"azzz", b"baaa", 4, -1),
        (b"x", b"y", 0, 0),
    ):
        put(idle, first)
        put(idle, second, SCRATCH + 0x101)
        result = call(idle, "memcmp", SCRATCH, SCRATCH + 0x101, count)
        assert struct.unpack("<i", struct.pack("<I", result)) == (order,)


@pytest.mark.parametrize(("function", "second"), [("memcpy", SCRATCH), ("memset", 0)])
def test_aligned_memory_is_moved_by_words(idle: Board, function: str, second: int) -> None:
    def instructions(to: int) -> int:
        before = idle.due.instructions
        call(idle, function, to, second, 128)
        return idle.due.instructions - before

    # An unaligned copy goes byte by byte, an unaligned fill has at most six bytes outside of words.
    by_words = instructions(SCRATCH + 0x100)
    assert by_words < 128 * 2
    if function == "memcpy":
        assert instructions(SCRATCH + 0x101) > 2.5 * by_words


# -- flash -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("page", range(PAGES))
@pytest.mark.parametrize("count", [4, 44, PAGE])
def test_a_page_takes_what_is_written_and_is_erased_behind_it(idle: Board, page: int, count: int) -> None:
    data = pattern(PAGE)
    put(idle, data)
    before = parameter_pages(idle)
    code = idle.due.flash()[: -PAGES * PAGE]
    assert call(idle, WRITE_PAGE, page, SCRATCH, count) == 1
    assert not idle.due.flash_busy
    assert wait_states(idle) == READING
    before[page] = data[:count].ljust(PAGE, b"\xff")
    assert parameter_pages(idle) == before
    assert idle.due.flash()[: -PAGES * PAGE] == code


def test_a_page_is_programmed_with_the_wait_states_of_programming(idle: Board) -> None:
    back = enter(idle, WRITE_PAGE, 1, SCRATCH, PAGE)
    observed = set()
    idle.due.add_breakpoint(back)
    while idle.due.halt != "breakpoint":
        if idle.due.flash_busy:
            observed.add(wait_states(idle))
        idle.due.run_us(50.0)
    assert observed == {PROGRAMMING}
    assert wait_states(idle) == READING
    assert idle.due.reg(0) == 1


@pytest.mark.parametrize(("page", "count"), [(PAGES, 4), (PAGES + 1, 4), (2**32 - 1, 4), (0, PAGE + 4)])
def test_outside_of_the_parameter_pages_nothing_is_written(idle: Board, page: int, count: int) -> None:
    stores, flash = idle.due.flash_stores, idle.due.flash()
    assert call(idle, WRITE_PAGE, page, SCRATCH, count) == 0
    assert idle.due.flash_stores == stores
    assert idle.due.flash() == flash


def test_a_write_waits_for_the_flash_and_reports_its_error(idle: Board) -> None:
    # The command is lost on a locked region: 16 KiB around the parameter pages.
    store(idle, EFC1_FCR, KEY | FIRST_PAGE << 8 | SET_LOCK)
    before = parameter_pages(idle)
    assert call(idle, WRITE_PAGE, 0, SCRATCH, PAGE) == 0
    assert parameter_pages(idle) == before
    assert wait_states(idle) == READING
    store(idle, EFC1_FCR, KEY | FIRST_PAGE << 8 | CLEAR_LOCK)
    assert call(idle, WRITE_PAGE, 0, SCRATCH, PAGE) == 1


def test_a_write_during_which_a_command_was_refused_has_failed(idle: Board) -> None:
    idle.due.set_strict(False)
    back = enter(idle, WRITE_PAGE, 0, SCRATCH, PAGE)
    while not idle.due.flash_busy:
        idle.due.step()
    # A command without its key: EEFC_FSR.FCMDE, which the next look at the status clears.
    store(idle, EFC1_FCR, 0)
    assert_fails(idle, back)


def assert_fails(board: Board, back: int) -> None:
    """The function that runs returns to `back`, and returns false."""
    board.due.add_breakpoint(back)
    board.due.run_us(20_000.0)
    assert board.due.halt == "breakpoint"
    assert board.due.reg(0) == 0


def test_an_error_from_before_a_write_is_none_of_the_write(idle: Board) -> None:
    idle.due.set_strict(False)
    store(idle, EFC1_FCR, 0)
    assert call(idle, WRITE_PAGE, 0, SCRATCH, PAGE) == 1


def test_a_page_is_read_into_so_many_bytes_and_no_other(idle: Board) -> None:
    data = pattern(PAGES * PAGE, seed=2)
    idle.due.load(PARAMETERS, data)
    for page in range(PAGES):
        for count in (0, 4, 20, PAGE):
            put(idle, b"\x55" * 300, SCRATCH)
            call(idle, READ_PAGE, page, SCRATCH + 1, count)
            read = b"\x55" + data[page * PAGE :][:count]
            assert idle.due.peek(SCRATCH, 300) == read.ljust(300, b"\x55")


# -- a set of parameters: two pages of the chip --------------------------------------------------------


@pytest.mark.parametrize("pages", [0, 1])
@pytest.mark.parametrize("count", [4, PAGE - 4, PAGE, PAGE + 4, 2 * PAGE])
def test_a_set_is_written_over_both_of_its_pages(idle: Board, pages: int, count: int) -> None:
    data = pattern(2 * PAGE, seed=3)
    put(idle, data)
    before = parameter_pages(idle)
    assert call(idle, BOARD_WRITE_PAGE, 0, pages, SCRATCH, count) == 1
    complete = data[:count].ljust(2 * PAGE, b"\xff")
    before[2 * pages : 2 * pages + 2] = [complete[:PAGE], complete[PAGE:]]
    assert parameter_pages(idle) == before
    put(idle, bytes(2 * PAGE))
    call(idle, BOARD_READ_PAGE, 0, pages, SCRATCH, count)
    assert idle.due.peek(SCRATCH, 2 * PAGE) == data[:count].ljust(2 * PAGE, b"\0")


@pytest.mark.parametrize(("pages", "count"), [(0, 2 * PAGE + 4), (2, 4), (2, 2 * PAGE)])
def test_a_set_that_has_no_room_is_not_written(idle: Board, pages: int, count: int) -> None:
    stores, flash = idle.due.flash_stores, idle.due.flash()
    assert call(idle, BOARD_WRITE_PAGE, 0, pages, SCRATCH, count) == 0
    assert idle.due.flash_stores == stores
    assert idle.due.flash() == flash


@pytest.mark.parametrize("fails", [0, 1])
def test_a_set_of_which_a_page_fails_has_failed(idle: Board, fails: int) -> None:
    """The flash has one lock for both pages, so the lock is set or cleared between them."""
    lock, unlock = (KEY | FIRST_PAGE << 8 | command for command in (SET_LOCK, CLEAR_LOCK))
    store(idle, EFC1_FCR, unlock if fails else lock)
    back = enter(idle, BOARD_WRITE_PAGE, 0, 0, SCRATCH, 2 * PAGE)
    write = idle.image.symbols[WRITE_PAGE] & ~1
    idle.due.add_breakpoint(write)
    for page in range(2):
        idle.due.run_us(20_000.0)
        assert idle.due.halt == "breakpoint"
        if page:
            store(idle, EFC1_FCR, lock if fails else unlock)
        idle.due.resume()
        idle.due.step()
    idle.due.remove_breakpoint(write)
    assert_fails(idle, back)


def test_the_watchdog_is_restarted_while_sets_are_written(idle: Board) -> None:
    before = idle.due.watchdog_restarts
    for _ in range(8):
        call(idle, BOARD_WRITE_PAGE, 0, 0, SCRATCH, 2 * PAGE)
    # Eight sets take 80 ms, the shortest timeout of the watchdog; a restart comes every 16 ms.
    assert idle.due.watchdog_restarts - before >= 4
    assert idle.due.resets == 1


# -- what a fault leaves -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("side", "offset", "kept"),
    [
        ("bottom", 0, True),
        ("bottom", -4, False),
        ("top", -FRAME_BYTES, True),
        ("top", 4 - FRAME_BYTES, False),
    ],
)
def test_a_frame_is_read_only_if_all_of_it_is_on_the_stack(
    idle: Board, side: str, offset: int, kept: bool
) -> None:
    frame = idle.image.symbols[f"__stack_{side}"] + offset
    for k in range(FRAME_BYTES // 4):
        if frame + 4 * k >= idle.image.symbols["__stack_bottom"]:
            store(idle, frame + 4 * k, 0x1000 + k)
    for k in range(5):
        store(idle, GPBR + 4 * k, 0)
    resets = idle.due.resets
    enter(idle, "fault_handler", frame)
    while idle.due.resets == resets:
        fault = recorded(idle)
        idle.due.step()
    # The processor's frame is r0 to r3, r12, LR, PC, xPSR: its words 5 and 6, as they were numbered above.
    assert (fault.pc, fault.lr) == ((0x1006, 0x1005) if kept else (0, 0))
    # Called by the idle loop, and by no exception.
    assert fault.record == MAGIC | Fault.UNEXPECTED_INTERRUPT


def test_random_bits_leave_their_generator_off(idle: Board) -> None:
    values = {call(idle, "_ZN4heli3due6random4bitsEv") for _ in range(8)}
    assert len(values) == 8
    # 32 bits each: the odds that a bit is the same in all eight are 1 in 128, for 32 bits of 8 numbers below.
    assert max(values) >= 2**31 > min(values)
    idle.due.run_us(10.0)
    assert idle.register(0x400B_C01C) == 0, "the generator still makes numbers"


@pytest.fixture(scope="module")
def functions(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    """memory.cpp as a library; its names get a prefix, for the process has its own."""
    folder = tmp_path_factory.mktemp("support")
    memory = (ROOT / "firmware" / "due" / "memory.cpp").read_text()
    renamed = re.sub(r"\b(memcpy|memset|memcmp)\(", r"due_\1(", memory)
    (folder / "memory.cpp").write_text(renamed)
    library = folder / "support.so"
    flags = ["-std=c++17", "-O2", "-shared", "-fPIC", "-fno-tree-loop-distribute-patterns"]
    process = compile_here(*flags, folder / "memory.cpp", "-o", library)
    assert process.returncode == 0, process.stderr
    return ctypes.CDLL(str(library))


@given(data=st.binary(max_size=40), from_offset=st.integers(0, 3), to_offset=st.integers(0, 3))
def test_memcpy_copies_just_what_it_should(
    functions: ctypes.CDLL, data: bytes, from_offset: int, to_offset: int
) -> None:
    source = ctypes.create_string_buffer(b"s" * from_offset + data, 64)
    target = ctypes.create_string_buffer(b"t" * 64, 64)
    functions.due_memcpy(
        ctypes.byref(target, to_offset), ctypes.byref(source, from_offset), ctypes.c_size_t(len(data))
    )
    assert target.raw == b"t" * to_offset + data + b"t" * (64 - to_offset - len(data))


@given(count=st.integers(0, 40), offset=st.integers(0, 3), value=st.integers(0, 255))
def test_memset_sets_just_what_it_should(functions: ctypes.CDLL, count: int, offset: int, value: int) -> None:
    target = ctypes.create_string_buffer(b"t" * 64, 64)
    functions.due_memset(ctypes.byref(target, offset), value, ctypes.c_size_t(count))
    assert target.raw == b"t" * offset + bytes([value]) * count + b"t" * (64 - offset - count)


@given(left=st.binary(min_size=8, max_size=8), right=st.binary(min_size=8, max_size=8))
def test_memcmp_orders_as_bytes_do(functions: ctypes.CDLL, left: bytes, right: bytes) -> None:
    result = functions.due_memcmp(left, right, ctypes.c_size_t(8))
    assert (result > 0) - (result < 0) == (left > right) - (left < right)


# A set takes two of the chip's pages; there are two sets.
SET = 2 * PAGE
PAGES_ADDRESS = 0x0010_0000 - 2 * SET
# A page buffer takes 64 words, then comes the command, then 64 words are erased and 64 written.
WORDS = PAGE // 4
STORES = WORDS + 1
PROGRAMMING_US = 4600.0
STEP_US = PROGRAMMING_US / (2 * WORDS)
LEAP = samples(1, 3)
"""In `make test` every third cut of a page is tried."""
VALUES = (1.5, 2.5, 0.25)
GOOD = (ParamsSource.STORED, ParamsSource.FALLBACK)
ERASED = b"\xff" * 2 * SET


@dataclass(frozen=True)
class Cut:
    """A moment at which power is lost."""

    stores: int  # How many words have been stored to the page buffer, the command being the last
    programmed_us: float = 0.0  # How long the flash has been busy since then


CUTS = (
    *(Cut(stores) for stores in range(STORES)),
    *(Cut(STORES, STEP_US * (k + 0.5)) for k in range(2 * WORDS)),
    Cut(STORES, PROGRAMMING_US + 1.0),
)
# (whole pages of the chip before it, cut): the first half of a set, then the second.
IN_A_SET = (*((0, cut) for cut in CUTS[::LEAP]), *((1, cut) for cut in CUTS[-1::-LEAP][::-1]))


class Bench:
    """A board whose parameter pages can be put back to what they were."""

    def __init__(self, elf: Path, image: Image) -> None:
        self.board = Board(elf, image)
        self.write_page = image.symbols[WRITE_PAGE] & ~1

    def pages(self) -> bytes:
        return self.board.due.flash()[-2 * SET :]

    def start_with(self, pages: bytes) -> Session:
        """Power up with these parameter pages."""
        self.board.cut_power()
        self.board.due.load(PAGES_ADDRESS, pages)
        self.board.restore_power()
        session = Session(self.board, session_number=1)
        session.connect()
        return session

    def save(self, pages: bytes, value: float) -> bytes:
        """The pages after an undisturbed save on top of these."""
        session = self.start_with(pages)
        session.command(ParamSetMessage(0, Param.ELEVATION_KP, value))
        session.command(ParamsSaveMessage(0))
        return self.pages()

    def cut(self, pages: bytes, value: float, cut: Cut, whole_pages: int = 0) -> bytes:
        """The pages after a save that ends there, in the page after so many whole ones."""
        session = self.start_with(pages)
        session.command(ParamSetMessage(0, Param.ELEVATION_KP, value))
        due = self.board.due
        due.add_breakpoint(self.write_page)
        self.board.write(encode_frame(MessageId.PARAMS_SAVE, 0, ParamsSaveMessage(77).pack()))
        for page in range(whole_pages + 1):
            if page:
                due.resume()
            due.run_us(50_000.0)
            assert due.halt == "breakpoint"
        due.remove_breakpoint(self.write_page)
        due.resume()
        before = due.flash_stores
        while due.flash_stores < before + cut.stores:
            due.step()
        if cut.programmed_us:
            due.run_us(cut.programmed_us)
        self.board.cut_power()
        assert due.flash_stores == before + cut.stores
        return self.pages()


@pytest.fixture(scope="module")
def bench(elf: Path, image: Image) -> Bench:
    return Bench(elf, image)


@pytest.mark.parametrize("saves", [1, 2])
def test_there_is_always_the_old_set_or_the_new_one(bench: Bench, saves: int) -> None:
    # After one save the next goes to the other page, after two back to the first one.
    pages = ERASED
    for value in VALUES[:saves]:
        pages = bench.save(pages, value)
    old = bench.start_with(pages).read_params()
    new = (*old[: Param.ELEVATION_KP], VALUES[saves], *old[Param.ELEVATION_KP + 1 :])
    keeps = slice(SET * (saves - 1), SET * saves)
    torn = set()
    for number, (whole, cut) in enumerate(IN_A_SET):
        after = bench.cut(pages, VALUES[saves], cut, whole)
        assert after[keeps] == pages[keeps], f"{cut}: the page with the old set was touched"
        session = bench.start_with(after)
        assert session.welcome.params_source in GOOD, cut
        assert session.read_params() == (new if number == len(IN_A_SET) - 1 else old), cut
        torn.add(after)
    # Words that already hold what is written make no difference.
    assert len(torn) > 0.9 * WORDS / LEAP


def test_a_page_torn_bit_by_bit_is_never_taken_for_a_set(bench: Bench) -> None:
    rng = np.random.default_rng(3)
    pages = bench.save(bench.save(ERASED, VALUES[0]), VALUES[1])
    complete = bench.save(pages, VALUES[2])
    old = bench.start_with(pages).read_params()
    for _ in range(100):
        # Cells that erasing or writing has not reached keep what they had, in any pattern.
        reached = rng.random(SET * 8) < rng.random()
        origin = (pages[:SET], b"\xff" * SET)[rng.integers(2)]
        before, after = (
            np.unpackbits(np.frombuffer(data, dtype=np.uint8)) for data in (origin, complete[:SET])
        )
        page = np.packbits(np.where(reached, after, before)).tobytes()
        if page in (pages[:SET], complete[:SET]):
            continue
        session = bench.start_with(page + pages[SET:])
        assert session.welcome.params_source in GOOD
        assert session.read_params() == old


@pytest.mark.parametrize("cut", [CUTS[0], CUTS[STORES + 40], CUTS[-20]], ids=str)
def test_after_a_cut_the_next_save_works(bench: Bench, cut: Cut) -> None:
    pages = bench.save(bench.save(ERASED, VALUES[0]), VALUES[1])
    again = bench.save(bench.cut(pages, VALUES[2], cut), VALUES[2])
    session = bench.start_with(again)
    assert session.welcome.params_source == ParamsSource.STORED
    assert session.read_params()[Param.ELEVATION_KP] == VALUES[2]


def test_a_reset_while_the_flash_is_written_is_no_worse_than_a_power_cut(bench: Bench) -> None:
    pages = bench.save(bench.save(ERASED, VALUES[0]), VALUES[1])
    session = bench.start_with(pages)
    session.command(ParamSetMessage(0, Param.ELEVATION_KP, VALUES[2]))
    bench.board.write(encode_frame(MessageId.PARAMS_SAVE, 0, ParamsSaveMessage(77).pack()))
    while not bench.board.due.flash_busy:
        bench.board.due.run_us(100.0)
    bench.board.due.run_us(1000.0)
    bench.board.reset()
    session = Session(bench.board, session_number=2)
    assert session.connect().params_source == ParamsSource.FALLBACK
    assert session.read_params()[Param.ELEVATION_KP] == VALUES[1]


def test_a_cut_in_the_first_save_ever_leaves_the_declared_defaults(bench: Bench) -> None:
    defaults = bench.start_with(ERASED).read_params()
    for whole, cut in IN_A_SET[:-1]:
        session = bench.start_with(bench.cut(ERASED, VALUES[0], cut, whole))
        assert session.welcome.params_source == ParamsSource.DEFAULTS, cut
        assert session.read_params() == defaults, cut
    Heli(session).arm()


def test_a_cut_in_the_second_set_of_the_first_save_keeps_what_was_saved(bench: Bench) -> None:
    for whole, cut in IN_A_SET:
        session = bench.start_with(bench.cut(ERASED, VALUES[0], cut, 2 + whole))
        assert session.welcome.params_source in GOOD, cut
        assert session.read_params()[Param.ELEVATION_KP] == VALUES[0], cut
