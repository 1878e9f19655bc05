"""The board's parameters: only declared values, and one whole set in the flash after any power cut."""

import math
import struct
import zlib

import pytest
from heli_host.declaration import PARAMS, PARAMS_HASH, ParamSpec, ParamsSource, Result
from heli_test_native import link as core_link
from hypothesis import given
from hypothesis import strategies as st

INDEX = {spec.name: spec.index for spec in PARAMS}
SUBNORMAL = struct.unpack("<f", b"\x01\0\0\0")[0]
specs = st.sampled_from(PARAMS)


def next_single(value: float) -> float:
    """The next number that a 32-bit float can hold."""
    bits = struct.unpack("<i", struct.pack("<f", value))[0]
    if value == 0.0:
        return float(SUBNORMAL)
    return float(struct.unpack("<f", struct.pack("<i", bits + (1 if value > 0 else -1)))[0])


def allowed(spec: ParamSpec, value: float) -> bool:
    return (
        math.isfinite(value)
        and spec.min <= value <= spec.max
        and not (spec.nonzero and value == 0.0)
        and not (spec.integer and value != math.floor(value))
    )


@pytest.mark.medium
@given(specs, st.floats(width=32), st.booleans())
def test_exactly_the_declared_values_are_taken(spec: ParamSpec, value: float, idle: bool) -> None:
    params = core_link.Params()
    before = params.values()
    result = params.set(spec.index, value, idle)
    if not allowed(spec, value):
        assert result == Result.OUT_OF_RANGE
    elif spec.idle_only and not idle:
        assert result == Result.UNSAFE_NOW
    else:
        assert result == Result.OK
        before[spec.index] = value
    assert params.values() == before


@pytest.mark.parametrize("spec", PARAMS, ids=lambda spec: spec.name)
def test_both_ends_of_every_range_are_taken_and_what_lies_beyond_is_not(spec: ParamSpec) -> None:
    params = core_link.Params()
    for end in (spec.min, spec.max):
        expected = Result.OUT_OF_RANGE if spec.nonzero and end == 0.0 else Result.OK
        assert params.set(spec.index, end, idle=True) == expected
    assert params.set(spec.index, next_single(spec.max), idle=True) == Result.OUT_OF_RANGE
    assert params.set(spec.index, -next_single(-spec.min), idle=True) == Result.OUT_OF_RANGE


@pytest.mark.parametrize("name", ["motor_front_sign", "motor_back_sign"])
def test_a_sign_is_either_minus_one_or_one_on_the_board(name: str) -> None:
    params = core_link.Params()
    for value in (0.5, -0.5, 0.0, next_single(-1.0), -next_single(1.0), SUBNORMAL):
        assert params.set(INDEX[name], value, idle=True) == Result.OUT_OF_RANGE
    for value in (-1.0, 1.0):
        assert params.set(INDEX[name], value, idle=True) == Result.OK


def test_there_is_no_parameter_beyond_the_table() -> None:
    params = core_link.Params()
    for index in (len(PARAMS), 255):
        assert params.set(index, 1.0, idle=True) == Result.NO_SUCH_PARAMETER


def test_defaults_are_the_declared_ones_and_agree_with_each_other() -> None:
    params = core_link.Params()
    params.set(INDEX["hover_V"], 3.0, idle=True)
    params.defaults()
    assert params.values() == pytest.approx([spec.default for spec in PARAMS], rel=1e-7)
    assert params.consistent()


def test_only_a_change_raises_the_revision() -> None:
    params = core_link.Params()
    before = params.revision
    params.set(INDEX["hover_V"], -1.0, idle=True)
    params.set(INDEX["supply_V"], 12.0, False)
    assert params.revision == before
    params.set(INDEX["hover_V"], 1.0, False)
    assert params.revision != before


@pytest.mark.parametrize(
    ("changes", "consistent"),
    [
        ({"supply_V": 9.0}, False),
        ({"motor_max_V": 12.5}, False),
        ({"setpoint_hold_s": 2.0}, False),
        ({"setpoint_land_s": 0.4}, False),
        ({"travel_counts_per_rev": SUBNORMAL}, False),
        ({"motor_max_V": 12.0}, True),
        ({"motor_front_sign": -1.0, "motor_back_sign": -1.0}, True),
        ({"elevation_counts_per_rev": -65536.0}, True),
        ({"motor_min_V": -10.0}, True),
        ({"elevation_rest_deg": 0.0}, True),
    ],
    ids=str,
)
def test_values_in_range_may_still_contradict_each_other(changes: dict[str, float], consistent: bool) -> None:
    params = core_link.Params()
    for name, value in changes.items():
        assert params.set(INDEX[name], value, idle=True) == Result.OK
    assert params.consistent() is consistent


DUTY_FULL = 2100
PAGE = 512
STEPS_OF_A_SAVE = 2 * PAGE  # erase and write, byte by byte
STEPS_OF_THE_FIRST = 2 * STEPS_OF_A_SAVE  # it writes both copies
HOVER = next(spec.index for spec in PARAMS if spec.name == "hover_V")
HOVER_DEFAULT = core_link.Params().get(HOVER)


def load(board: core_link.Board) -> tuple[int, float]:
    """Parameters of a board that starts with this flash: their source and a value."""
    params = core_link.Params()
    return core_link.Store(board).load(params), params.get(HOVER)


def save(board: core_link.Board, hover_V: float) -> bool:
    params = core_link.Params()
    params.set(HOVER, hover_V, idle=True)
    return bool(core_link.Store(board).save(params))


def pages(board: core_link.Board) -> list[bytes]:
    return [board.flash[:PAGE], board.flash[PAGE:]]


def saved_board(*hovers_V: float) -> core_link.Board:
    board = core_link.Board(DUTY_FULL, PAGE)
    for hover_V in hovers_V:
        assert save(board, hover_V)
    return board


def damage(board: core_link.Board, page: int, at: int, bits: int = 0x10) -> None:
    flash = bytearray(board.flash)
    flash[page * PAGE + at] ^= bits
    board.flash = bytes(flash)


def rewrite(board: core_link.Board, page: int, at: int, new: bytes) -> None:
    """Change a page and make its CRC right again."""
    flash = bytearray(board.flash)
    start = page * PAGE
    flash[start + at : start + at + len(new)] = new
    crc = zlib.crc32(flash[start : start + PAGE - 4])
    flash[start + PAGE - 4 : start + PAGE] = crc.to_bytes(4, "little")
    board.flash = bytes(flash)


def test_an_erased_board_has_the_declared_defaults() -> None:
    assert load(core_link.Board(DUTY_FULL, PAGE)) == (ParamsSource.DEFAULTS, HOVER_DEFAULT)


def test_what_was_saved_is_there_at_the_next_start() -> None:
    board = saved_board(3.0)
    assert load(board) == (ParamsSource.STORED, 3.0)


def test_saves_take_turns_and_the_newest_counts() -> None:
    board = core_link.Board(DUTY_FULL, PAGE)
    for generation in range(1, 8):
        before = pages(board)
        assert save(board, float(generation))
        changed = [page for page in (0, 1) if pages(board)[page] != before[page]]
        assert changed == ([0, 1] if generation == 1 else [(generation - 1) % 2])
        assert load(board) == (ParamsSource.STORED, float(generation))


@pytest.mark.parametrize("stored", [(), (3.0,), (3.0, 4.0), (3.0, 4.0, 5.0)], ids=len)
def test_a_power_cut_at_any_byte_of_a_save_loses_at_most_that_save(stored: tuple[float, ...]) -> None:
    for cut in range(STEPS_OF_A_SAVE if stored else STEPS_OF_THE_FIRST):
        board = saved_board(*stored)
        board.steps_left = cut
        returned = save(board, 7.0)
        board.steps_left = None
        source, hover_V = load(board)
        # Erased bytes at the end of the page may be just what was to be written: then the cut came too late.
        complete = hover_V == 7.0
        assert returned == complete
        if not complete:
            assert hover_V == (stored[-1] if stored else HOVER_DEFAULT)
        if stored or complete:
            assert source in (ParamsSource.STORED, ParamsSource.FALLBACK)
        else:
            assert source == ParamsSource.DEFAULTS
        # The board recovers: the next save works and the one after it too.
        assert save(board, 8.0)
        assert load(board) == (ParamsSource.STORED, 8.0)
        assert save(board, 9.0)
        assert load(board) == (ParamsSource.STORED, 9.0)


@pytest.mark.medium
@given(st.lists(st.integers(0, STEPS_OF_A_SAVE), min_size=1, max_size=12))
def test_any_number_of_power_cuts_in_a_row_never_loses_the_last_whole_set(cuts: list[int]) -> None:
    board = saved_board(3.0)
    last = 3.0
    for attempt, cut in enumerate(cuts):
        board.steps_left = cut
        value = 4.0 + attempt
        if save(board, value):
            last = value
        board.steps_left = None
        _, hover_V = load(board)
        assert hover_V == last


@pytest.mark.medium
@given(st.integers(0, 1), st.integers(0, PAGE - 1), st.integers(1, 255))
def test_one_damaged_byte_anywhere_is_found_and_the_other_copy_is_used(page: int, at: int, bits: int) -> None:
    board = saved_board(3.0, 4.0)
    damage(board, page, at, bits)
    assert load(board) == (ParamsSource.FALLBACK, 4.0 if page == 0 else 3.0)
    assert save(board, 5.0)
    assert load(board) == (ParamsSource.STORED, 5.0)


def test_two_damaged_copies_give_the_defaults_and_say_so() -> None:
    board = saved_board(3.0, 4.0)
    damage(board, page=0, at=100)
    damage(board, page=1, at=200)
    assert load(board) == (ParamsSource.CORRUPT, HOVER_DEFAULT)
    assert save(board, 5.0)
    assert load(board) == (ParamsSource.STORED, 5.0)


@pytest.mark.parametrize("page", [0, 1])
def test_the_very_first_save_already_survives_damage_to_either_copy(page: int) -> None:
    board = saved_board(3.0)
    damage(board, page=page, at=100)
    assert load(board) == (ParamsSource.FALLBACK, 3.0)


def entry(parameter: int) -> int:
    """Where a saved set has a parameter: its number, then its value."""
    return 12 + 6 * parameter


def other_schema(board: core_link.Board) -> None:
    """As if a firmware with other parameters had saved both copies."""
    for page in (0, 1):
        rewrite(board, page=page, at=4, new=(PARAMS_HASH ^ 1).to_bytes(4, "little"))


def origin(board: core_link.Board) -> tuple[int, int, list[int]]:
    """Values kept, values dropped, and parameters without a stored value, at the next start."""
    store = core_link.Store(board)
    store.load(core_link.Params())
    kept, dropped, bits = store.origin
    return kept, dropped, [spec.index for spec in PARAMS if bits >> spec.index & 1]


def test_a_set_of_another_schema_keeps_what_is_known() -> None:
    board = saved_board(3.0, 4.0)
    other_schema(board)
    assert load(board) == (ParamsSource.MIGRATED, 4.0)
    assert origin(board) == (len(PARAMS), 0, [])
    assert save(board, 5.0)
    assert load(board) == (ParamsSource.STORED, 5.0)


def test_a_parameter_that_moved_in_the_table_keeps_its_value() -> None:
    board = saved_board(3.0)
    other_schema(board)
    flash = board.flash
    hover_at, first_at = entry(HOVER), entry(0)
    # Exchange the entries of the two parameters, six bytes each, in both copies.
    for page in (0, 1):
        rewrite(board, page, hover_at, flash[first_at : first_at + 6])
        rewrite(board, page, first_at, flash[hover_at : hover_at + 6])
    assert load(board) == (ParamsSource.MIGRATED, 3.0)


def test_a_stored_value_that_nobody_knows_is_dropped_and_a_new_parameter_has_its_default() -> None:
    board = saved_board(3.0)
    other_schema(board)
    unknown = next(number for number in range(0x10000) if number not in {spec.id for spec in PARAMS})
    for page in (0, 1):
        rewrite(board, page, entry(HOVER), unknown.to_bytes(2, "little"))
    assert load(board) == (ParamsSource.MIGRATED, HOVER_DEFAULT)
    assert origin(board) == (len(PARAMS) - 1, 1, [HOVER])


@pytest.mark.parametrize("value", [1e9, -1e9, float("nan"), float("inf")])
def test_a_stored_value_out_of_the_new_range_becomes_the_default_and_is_reported(value: float) -> None:
    board = saved_board(3.0)
    other_schema(board)
    for page in (0, 1):
        rewrite(board, page, entry(HOVER) + 2, struct.pack("<f", value))
    assert load(board) == (ParamsSource.MIGRATED, HOVER_DEFAULT)
    assert origin(board) == (len(PARAMS) - 1, 1, [HOVER])


@pytest.mark.parametrize("index", [HOVER, 0, len(PARAMS) - 1])
def test_a_stored_value_that_this_board_cannot_use_is_dropped_and_reported(index: int) -> None:
    board = saved_board(3.0)
    params, store = core_link.Params(), core_link.Store(board)
    assert store.load(params) == ParamsSource.STORED
    params.set(index, PARAMS[index].max, idle=True)
    store.drop(params, index)
    assert params.get(index) == pytest.approx(PARAMS[index].default)
    assert store.source == ParamsSource.MIGRATED
    assert store.origin == (len(PARAMS) - 1, 1, 1 << index)


def test_sets_of_the_first_format_are_not_used() -> None:
    # It has no numbers of parameters, only their places under a hash of the whole link.
    board = core_link.Board(DUTY_FULL, PAGE)
    head = struct.pack("<HBBII", 0x5048, 1, 73, 0xE2BF64AA, 1)
    page = (head + struct.pack("<73f", *[3.0] * 73)).ljust(PAGE - 4, b"\xff")
    page += zlib.crc32(page).to_bytes(4, "little")
    board.flash = page + page
    assert load(board) == (ParamsSource.CORRUPT, HOVER_DEFAULT)
    assert save(board, 5.0)
    assert load(board) == (ParamsSource.STORED, 5.0)


def test_a_copy_with_a_value_out_of_range_is_not_used_whatever_its_crc() -> None:
    board = saved_board(3.0)
    for page in (0, 1):
        rewrite(board, page, entry(HOVER) + 2, bytes.fromhex("0000c07f"))
    assert load(board) == (ParamsSource.CORRUPT, HOVER_DEFAULT)


def test_the_generation_may_wrap() -> None:
    board = saved_board(3.0, 4.0)
    rewrite(board, page=0, at=8, new=(0xFFFFFFFE).to_bytes(4, "little"))
    rewrite(board, page=1, at=8, new=(0xFFFFFFFF).to_bytes(4, "little"))
    assert load(board) == (ParamsSource.STORED, 4.0)
    for value in (5.0, 6.0, 7.0):
        assert save(board, value)
        assert load(board) == (ParamsSource.STORED, value)


def test_a_failed_save_says_so_and_the_next_start_finds_the_old_set() -> None:
    board = saved_board(3.0)
    board.steps_left = 300
    assert not save(board, 4.0)
    assert load(board) == (ParamsSource.FALLBACK, 3.0)


def test_a_save_makes_a_corrupt_board_fit_to_arm_without_a_restart() -> None:
    board = saved_board(3.0)
    for page in (0, 1):
        damage(board, page=page, at=100)
    params = core_link.Params()
    store = core_link.Store(board)
    assert store.load(params) == ParamsSource.CORRUPT
    assert store.save(params)
    assert store.source == ParamsSource.STORED
