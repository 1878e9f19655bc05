"""Power lost at any moment of `params save`: after the next start there is the old set or the new one."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from heli_host.board.heli import Heli
from heli_host.declaration import (
    MessageId,
    Param,
    ParamSetMessage,
    ParamsSaveMessage,
    ParamsSource,
)
from heli_host.link.frames import encode_frame
from heli_host.link.session import Session

from firmware.due.report import Image
from tests.firmware.desk import Board
from tests.running.long import samples

pytestmark = pytest.mark.emulated


WRITE_PAGE = "_ZN4heli3due5flash10write_pageEjPKhj"
PAGE = 256
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
