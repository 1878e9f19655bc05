"""Flash: page programming, its time, its errata, and power lost half way (section 18)."""

import struct

import pytest
from due_chip import FLASH, Chip
from due_emulator import Stop

pytestmark = pytest.mark.emulated

PLANE1 = 0x000C_0000
# Commands: write page, erase and write page, set and get lock bits, get descriptor, set and get boot bits.
WP, EWP, SLB, GLB, GETD, SGPB, GGPB = 1, 3, 8, 10, 0, 11, 13
# Bits of EEFC_FSR: ready for a command, and a command that a lock refused.
FRDY, FLOCKE = 1 << 0, 1 << 2
SIX_WAIT_STATES = 6 << 8
OLD, NEW = b"\x0f" * 256, b"\xa5" * 256
PAGE = 1022
ADDRESS = PLANE1 + 256 * PAGE


def command(chip: Chip, code: int, argument: int = 0, efc: str = "EFC1") -> None:
    chip[f"{efc}.FCR"] = 0x5A << 24 | argument << 8 | code


def latch(chip: Chip, data: bytes) -> None:
    for offset in range(0, 256, 4):
        # The latches take stores from the bus, as a program makes them.
        chip.store(ADDRESS + offset, struct.unpack_from("<I", data, offset)[0])


def with_old_page() -> Chip:
    chip = Chip()
    chip.due.load(ADDRESS, OLD)
    chip["EFC1.FMR"] = SIX_WAIT_STATES
    latch(chip, NEW)
    return chip


def page(chip: Chip) -> bytes:
    start = ADDRESS - FLASH
    return chip.due.flash()[start : start + 256]


def test_erase_and_write_takes_4_6_ms_and_leaves_the_new_page() -> None:
    chip = with_old_page()
    command(chip, EWP, PAGE)
    assert chip["EFC1.FSR"] & FRDY == 0
    chip.due.run_us(4590)
    assert chip["EFC1.FSR"] & FRDY == 0
    chip.due.run_us(20)
    assert chip["EFC1.FSR"] == FRDY
    assert page(chip) == NEW


def test_writing_without_erasing_only_clears_bits() -> None:
    chip = with_old_page()
    command(chip, WP, PAGE)
    chip.due.run_us(2400)
    assert page(chip) == bytes(a & b for a, b in zip(OLD, NEW, strict=True))


@pytest.mark.parametrize("cut_us", range(0, 4700, 113))
def test_a_power_cut_leaves_old_erased_or_new_words(cut_us: int) -> None:
    chip = with_old_page()
    command(chip, EWP, PAGE)
    chip.due.run_us(cut_us)
    chip.due.power_off()
    words = {page(chip)[i : i + 4] for i in range(0, 256, 4)}
    # The first half erases the page word by word, the second writes it.
    possible_words = {OLD[:4], b"\xff" * 4} if cut_us < 2300 else {b"\xff" * 4, NEW[:4]}
    assert words <= possible_words
    if 200 < cut_us < 2100:
        assert len(words) == 2


def test_stores_to_the_latches_and_commands_are_counted() -> None:
    chip = with_old_page()
    assert chip.due.flash_stores == 64
    command(chip, EWP, PAGE)
    assert chip.due.flash_stores == 65


def test_fewer_than_six_wait_states_break_the_errata() -> None:
    chip = with_old_page()
    chip["EFC1.FMR"] = 4 << 8
    with pytest.raises(Stop, match="FWS = 4; the errata ask for 6"):
        command(chip, EWP, PAGE)


def test_a_plane_cannot_be_programmed_by_its_own_code() -> None:
    chip = Chip()
    chip["EFC0.FMR"] = SIX_WAIT_STATES
    with pytest.raises(Stop, match="programmed by code that runs from it"):
        command(chip, EWP, 900, efc="EFC0")


def test_a_busy_plane_cannot_be_read() -> None:
    chip = with_old_page()
    command(chip, EWP, PAGE)
    with pytest.raises(Stop, match="while its plane is being programmed"):
        chip.due.read_word(PLANE1)
    assert chip.due.read_word(FLASH) == 0x2008_8000


def test_a_locked_region_refuses() -> None:
    chip = with_old_page()
    command(chip, SLB, PAGE)
    command(chip, GLB)
    assert chip["EFC1.FRR"] == 1 << 15  # The last of 16 regions, which holds PAGE.
    command(chip, EWP, PAGE)
    assert chip["EFC1.FSR"] == FRDY | FLOCKE
    assert page(chip) == OLD


def test_descriptor_names_256_KiB_in_pages_of_256() -> None:
    chip = Chip()
    command(chip, GETD)
    assert [chip["EFC1.FRR"] for _ in range(6)][1:] == [256 * 1024, 256, 1, 256 * 1024, 16]


def test_boot_bit_can_be_read() -> None:
    chip = Chip()
    command(chip, GGPB, efc="EFC0")
    assert chip["EFC0.FRR"] & 2


@pytest.mark.parametrize(
    ("value", "message"), [(EWP, "key 0x5A"), (0x5A << 24 | 1024 << 8 | EWP, "outside of the plane")]
)
def test_a_wrong_command_is_refused(value: int, message: str) -> None:
    with pytest.raises(Stop, match=message):
        with_old_page()["EFC1.FCR"] = value
