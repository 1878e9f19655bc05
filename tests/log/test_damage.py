"""Whatever happens to the bytes of a log, the reader returns what was written, and reports what is
missing."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from heli_host.data.log.reader import Log, read_log
from heli_host.declaration import AXES
from heli_host.errors import HeliError, LogError
from mcap.data_stream import RecordBuilder
from mcap.reader import make_reader
from mcap.records import DataEnd, Footer, Metadata
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC

from tests.log.made import open_writer, write_made_log
from tests.log.mutate import mutated
from tests.running.long import samples

TICKS = 2200


@dataclass(frozen=True)
class Written:
    """A log's bytes, as it was closed and as `kill -9` leaves it, and what is read from them undamaged."""

    path: Path
    closed: bytes
    metadata_end: int
    log: Log
    angles_rad: np.ndarray[tuple[int, ...], np.dtype[np.float64]]

    @property
    def unclosed(self) -> bytes:
        """Up to its last whole chunk but one."""
        return self.closed[: self.chunk_starts[-1]]

    @property
    def chunk_starts(self) -> list[int]:
        """Where the chunks stand."""
        summary = make_reader(io.BytesIO(self.closed)).get_summary()
        assert summary is not None
        return [index.chunk_start_offset for index in summary.chunk_indexes]


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Written:
    path = tmp_path_factory.mktemp("damage") / "a.mcap"
    write_made_log(path, TICKS)
    log = read_log(path)
    complete = Written(path, path.read_bytes(), 0, log, log.flight().angles_rad)
    return Written(path, complete.closed, complete.chunk_starts[0], log, complete.angles_rad)


def _read(written: Written, data: bytes) -> Log:
    path = written.path.with_name("damaged.mcap")
    path.write_bytes(data)
    return read_log(path)


def _is_true(log: Log, written: Written) -> bool:
    """Whether everything that was read was written; fails otherwise. False if something is missing."""
    true = written.log
    assert log.ticks.dtype == true.ticks.dtype
    rows = np.searchsorted(true.ticks["tick"], log.ticks["tick"])
    assert np.all(rows < TICKS)
    assert log.ticks.tobytes() == true.ticks[rows].tobytes()
    assert log.layout == true.layout
    for name, values in log.metadata.items():
        assert values.items() <= true.metadata[name].items()
    for event in log.events:
        assert event in true.events
    for counters in log.link:
        assert counters in true.link
    if len(rows):
        flight = log.flight()
        np.testing.assert_allclose(flight.angles_rad, written.angles_rad[rows], rtol=2.0**-22)
        assert flight.parameters.items() <= true.parameters.items()
        assert flight.state_names == true.flight().state_names
    read = (len(rows), len(log.events), len(log.link), log.metadata)
    return read == (TICKS, len(true.events), len(true.link), true.metadata)


def _never_silently_wrong(written: Written, data: bytes) -> None:
    try:
        log = _read(written, data)
        complete = _is_true(log, written)
    except HeliError as error:
        assert "\n" not in str(error)
        return
    assert complete or log.notes


@pytest.mark.medium
@pytest.mark.parametrize("block", range(10))
def test_no_mutation_of_a_closed_log_makes_a_number_silently_wrong(written: Written, block: int) -> None:
    # Half of them hit what stands before the ticks, which is a fifth of the file and says what they mean.
    for seed in range(block * 200, block * 200 + samples(200, 12)):
        last = written.metadata_end if seed % 2 else None
        _never_silently_wrong(written, mutated(written.closed, seed, last=last))


@pytest.mark.medium
@pytest.mark.parametrize("block", range(10))
def test_no_mutation_of_a_log_that_was_not_closed_makes_a_number_silently_wrong(
    written: Written, block: int
) -> None:
    for seed in range(2000 + block * 200, 2000 + block * 200 + samples(200, 12)):
        last = written.metadata_end if seed % 2 else None
        _never_silently_wrong(written, mutated(written.unclosed, seed, last=last))


def test_every_flipped_bit_of_the_encoder_parameters_is_reported(written: Written) -> None:
    for data in (written.closed, written.unclosed):
        at = data.index(b"travel_counts_per_rev") + len(b"travel_counts_per_rev") + 4
        for bit in range(8):
            changed = bytearray(data)
            changed[at] ^= 1 << bit
            log = _read(written, bytes(changed))
            assert "travel_counts_per_rev" not in log.parameters
            assert any("left out" in note for note in log.notes)
            assert not _is_true(log, written) and "plan" in log.metadata


def test_a_parameter_that_does_not_make_the_logged_angles_is_left_out(written: Written) -> None:
    old = _without_crcs(written.closed)
    log = _read(written, old)
    assert any("written before logs carried a CRC" in note for note in log.notes)
    assert _is_true(log, written)
    changed = _read(written, old.replace(b"4096.0", b"5096.0"))
    for axis in AXES:
        name = f"{axis}_counts_per_rev"
        if written.log.parameters[name] == 4096.0:
            assert name not in changed.parameters
            assert any(name in note for note in changed.notes)
    np.testing.assert_allclose(changed.flight().angles_rad, written.angles_rad, rtol=2.0**-22)


def test_the_data_crc_is_that_of_the_mcap_library_and_damage_is_reported(written: Written) -> None:
    records = list(StreamReader(io.BytesIO(written.closed), validate_crcs=True, emit_chunks=True).records)
    end = next(record for record in records if isinstance(record, DataEnd))
    assert end.data_section_crc != 0
    # A message index serves viewers only: nothing else than this CRC covers it.
    at = written.chunk_starts[1] - 5
    changed = bytearray(written.closed)
    changed[at] ^= 1
    log = _read(written, bytes(changed))
    assert _is_true(log, written) and any("not as it was written" in note for note in log.notes)


@pytest.mark.parametrize("indexed", [True, False])
def test_behind_a_broken_record_the_walk_goes_on_with_the_next_chunk(written: Written, indexed: bool) -> None:
    changed = bytearray(written.closed if indexed else written.closed[:-9])
    changed[written.chunk_starts[0] + 8] = 0xFF
    log = _read(written, bytes(changed))
    assert not _is_true(log, written)
    assert len(log.ticks) == TICKS - 1000 and log.complete
    assert any("bytes" in note and "left out" in note for note in log.notes)
    assert not any("not closed" in note for note in log.notes)
    if indexed:
        assert f"{TICKS} ticks were written, {TICKS - 1000} are readable" in log.notes
    assert log.metadata["result"]["outcome"] == "completed"


def test_a_damaged_end_costs_nothing_and_the_note_says_so(written: Written) -> None:
    for data in (written.closed[:-9], written.closed[:-1], written.closed + b"x"):
        log = _read(written, data)
        assert log.complete and _is_true(log, written)
        assert log.notes == ("the index at its end is damaged or missing; all data before it is whole",)


def test_damaged_schemas_are_read_from_the_index_or_refused(written: Written) -> None:
    # The name of a state: every number stays readable, and would mean another thing.
    text = b"uint8 STATE_HOLD=5"
    at = written.closed.index(text) + len(text) - 1
    for data, refused in ((written.closed, False), (written.unclosed, True)):
        changed = bytearray(data)
        changed[at] = ord("4")
        if refused:
            with pytest.raises(LogError, match="in the description of its columns"):
                _read(written, bytes(changed))
        else:
            log = _read(written, bytes(changed))
            assert _is_true(log, written)
            assert any("how the numbers are to be read" in note for note in log.notes)


def test_plans_of_any_name_and_text_keep_their_crc(tmp_path: Path) -> None:
    writer = open_writer(tmp_path / "a.mcap")
    plans = {"crc32": "a", "": "", "Grüße \u0000": "title = '\U0001f681'\n" * 50}
    writer.write_metadata("plan", plans)
    writer.close()
    log = read_log(tmp_path / "a.mcap")
    assert log.notes == () and plans.items() <= log.metadata["plan"].items()


def _without_crcs(data: bytes) -> bytes:
    """Return a log as versions before the CRC of metadata wrote it, without an index."""
    builder = RecordBuilder()
    for record in StreamReader(io.BytesIO(data), emit_chunks=True).records:
        if isinstance(record, DataEnd):
            DataEnd(data_section_crc=0).write(builder)
            Footer(summary_start=0, summary_offset_start=0, summary_crc=0).write(builder)
            break
        if isinstance(record, Metadata):
            record.metadata.pop("(crc32)")
            if record.name == "head":
                continue
        record.write(builder)
    magic = bytes(MCAP0_MAGIC)
    return magic + bytes(builder.end()) + magic  # type: ignore[no-untyped-call]


def test_counts_are_compared_with_angles_on_every_axis(written: Written) -> None:
    for axis in AXES:
        old = _without_crcs(written.closed)
        name = f"{axis}_counts_per_rev".encode()
        at = old.index(name) + len(name) + 4
        changed = bytearray(old)
        changed[at] ^= 1
        log = _read(written, bytes(changed))
        assert name.decode() not in log.parameters
        _is_true(log, written)
