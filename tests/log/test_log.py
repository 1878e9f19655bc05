"""A log keeps what was flown, through a kill, a full disk and damage; what is read is never wrong."""

import io
import json
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from heli_host.data.log.reader import Log, read_flight, read_log
from heli_host.data.log.schema import TICK_LAYOUT, TICK_SCHEMA, TICK_TOPIC, parse_layout
from heli_host.data.log.writer import CHUNK_TICKS, LogWriter, TickClock
from heli_host.declaration import AXES, Channel
from heli_host.errors import HeliError, LogError, LogWriteError, TruncatedLog
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.data_stream import RecordBuilder
from mcap.reader import make_reader
from mcap.records import DataEnd, Footer, Metadata
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC

from tests.channels.groups import SETPOINTS
from tests.link import host_reference as reference
from tests.log.fuzz_log import fuzz_log, mutated
from tests.log.made import PARAMETERS, RAD_PER_COUNT, WALL_NS, make_samples, open_writer, write_made_log
from tests.running.long import samples

ROOT = Path(__file__).resolve().parents[2]


def test_a_tick_written_is_the_tick_read(tmp_path: Path) -> None:
    tick, raw = write_made_log(tmp_path / "a.mcap", 3500)
    log = read_log(tmp_path / "a.mcap")
    assert log.complete and log.notes == ()
    np.testing.assert_array_equal(log.ticks["tick"], tick)
    np.testing.assert_array_equal(log.raw, raw)


@pytest.mark.medium
@settings(max_examples=40, deadline=None)
@given(st.tuples(*(st.integers(*reference.limits(wire_type)) for wire_type in reference.TYPES)))
def test_every_channel_survives_at_its_extremes(
    tmp_path_factory: pytest.TempPathFactory, row: tuple[int, ...]
) -> None:
    path = tmp_path_factory.mktemp("extremes") / "a.mcap"
    raw = np.array([row], np.int32)
    writer = open_writer(path)
    writer.write_ticks(np.array([7], np.uint32), raw)
    writer.close()
    np.testing.assert_array_equal(read_log(path).raw, raw)


def test_the_flight_of_a_log_has_angles_from_the_exact_counts(tmp_path: Path) -> None:
    _, raw = write_made_log(tmp_path / "a.mcap", 3000)
    flight = read_flight(tmp_path / "a.mcap")
    np.testing.assert_array_equal(flight.elevation_rad, raw[:, Channel.ELEVATION_COUNT] * (2 * np.pi / 4096))
    np.testing.assert_array_equal(flight.back_V, raw[:, Channel.BACK] * 1e-3)
    assert flight.setpoints_rad is not None
    np.testing.assert_array_equal(flight.setpoints_rad, raw[:, SETPOINTS] * 1e-5)
    assert flight.t_s[0] == 0.0 and flight.step_s == pytest.approx(1e-3)
    assert flight.parameters == pytest.approx(PARAMETERS)
    assert flight.state is not None and flight.state_names[int(flight.state[1500])] == "closed_loop"
    assert [event.text for event in flight.events] == ["take-off", "sine", "landing"]
    assert 'title = "made"' in flight.plan


def test_the_same_ticks_give_the_same_bytes_however_they_arrive(tmp_path: Path) -> None:
    write_made_log(tmp_path / "a.mcap", 3010, batch=20)
    write_made_log(tmp_path / "b.mcap", 3010, batch=20)
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()
    tick, raw = make_samples(3010)
    for name, batch in (("c", 1), ("d", 977), ("e", 3010)):
        writer = open_writer(tmp_path / f"{name}.mcap")
        for start in range(0, len(tick), batch):
            writer.write_ticks(tick[start : start + batch], raw[start : start + batch])
        writer.close()
    assert (tmp_path / "c.mcap").read_bytes() == (tmp_path / "d.mcap").read_bytes()
    assert (tmp_path / "c.mcap").read_bytes() == (tmp_path / "e.mcap").read_bytes()


@pytest.mark.medium
def test_the_mcap_library_reads_the_same_ticks_by_index_and_by_stream(tmp_path: Path) -> None:
    tick, raw = write_made_log(tmp_path / "a.mcap", 2500)
    with (tmp_path / "a.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None and summary.statistics is not None
        assert summary.statistics.message_count == 2500 + 4
        assert summary.statistics.chunk_count == 3
        messages = [message for _, _, message in reader.iter_messages(topics=[TICK_TOPIC])]
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
    payloads = np.array([np.frombuffer(message.data[4:], TICK_LAYOUT.dtype)[0] for message in messages])
    np.testing.assert_array_equal(payloads["tick"], tick)
    np.testing.assert_array_equal(payloads["travel_count"], raw[:, Channel.TRAVEL_COUNT])
    assert [message.sequence for message in messages] == tick.tolist()
    assert messages[-1].log_time - messages[0].log_time == 2499 * 1_000_000
    assert metadata["result"]["outcome"] == "completed"
    with (tmp_path / "a.mcap").open("rb") as file:
        records = list(StreamReader(file, validate_crcs=True).records)
    assert sum(type(record).__name__ == "Message" for record in records) == 2500 + 4


@pytest.mark.filterwarnings("ignore:.*is deprecated:DeprecationWarning")
def test_an_index_finds_the_ticks_of_a_time_span(tmp_path: Path) -> None:
    write_made_log(tmp_path / "a.mcap", 5000)
    with (tmp_path / "a.mcap").open("rb") as file:
        start_ns = WALL_NS + 2_500_000_000
        messages = make_reader(file).iter_messages(
            [TICK_TOPIC], start_time=start_ns, end_time=start_ns + 10_000_000
        )
        ticks = [message.sequence for _, _, message in messages]
    assert ticks == list(range(5000 + 2500, 5000 + 2510))


def test_a_ros_2_reader_that_knows_only_the_schema_reads_every_field(tmp_path: Path) -> None:
    decoder = pytest.importorskip("mcap_ros2.decoder", reason="skipped: no mcap-ros2-support")
    _, raw = write_made_log(tmp_path / "a.mcap", 1200)
    with (tmp_path / "a.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[decoder.DecoderFactory()])
        decoded = [message for *_, message in reader.iter_decoded_messages(topics=[TICK_TOPIC])]
    assert decoded[1000].pitch_count == raw[1000, Channel.PITCH_COUNT]
    assert decoded[1000].front_volt == np.float32(raw[1000, Channel.FRONT] * 1e-3)
    assert decoded[1000].flags == raw[1000, Channel.FLAGS]


def test_field_names_are_such_that_viewers_take_them() -> None:
    # Foxglove refuses a ros2msg schema with any other field name; CDR would pad unordered sizes.
    sizes = []
    for name in TICK_LAYOUT.dtype.names or ():
        assert re.fullmatch(r"[a-z](_?[a-z0-9]+)*", name)
        sizes.append(TICK_LAYOUT.dtype[name].itemsize)
    assert sizes == sorted(sizes, reverse=True)
    assert TICK_LAYOUT.dtype.itemsize == sum(sizes)


def test_a_later_version_may_add_fields(tmp_path: Path) -> None:
    layout = parse_layout("int8 early\n" + TICK_SCHEMA + "float64 late\n")
    assert layout.dtype.fields is not None and layout.dtype.fields["t_s"][1] == 8
    assert layout.dtype.fields["late"][1] % 8 == 0
    assert layout.names("STATE")[5] == "hold"


@pytest.mark.parametrize(
    "line", ["float64[3] x", "string name", "geometry/Point p", "float64 t_s\nfloat64 t_s"]
)
def test_a_schema_of_anything_but_numbers_is_refused(line: str) -> None:
    with pytest.raises(LogError):
        parse_layout(line)


@pytest.mark.medium
def test_cut_at_any_byte_a_log_gives_its_whole_chunks_and_never_a_wrong_tick(tmp_path: Path) -> None:
    tick, raw = write_made_log(tmp_path / "whole.mcap", 3300)
    data = (tmp_path / "whole.mcap").read_bytes()
    ends = _chunk_ends(tmp_path / "whole.mcap")
    path = tmp_path / "cut.mcap"
    for length in [*range(0, len(data), 397), *range(len(data) - 60, len(data))]:
        path.write_bytes(data[:length])
        try:
            log = read_log(path)
        except LogError as error:
            assert "\n" not in str(error)
            assert length < 6000, "the head was there to say what it is"
            continue
        complete_count = sum(length >= end for end in ends)
        assert len(log.ticks) == min(3300, complete_count * CHUNK_TICKS)
        np.testing.assert_array_equal(log.raw, raw[: len(log.ticks)])
        np.testing.assert_array_equal(log.ticks["tick"], tick[: len(log.ticks)])
        assert log.complete or log.notes


def _chunk_ends(path: Path) -> list[int]:
    with path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    return [index.chunk_start_offset + index.chunk_length for index in summary.chunk_indexes]


@pytest.mark.medium
@settings(max_examples=150, deadline=None)
@given(st.data())
def test_a_damaged_log_raises_nothing_but_log_errors(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    path = tmp_path_factory.getbasetemp() / "damaged.mcap"
    complete = path.with_name("sound.mcap")
    if not complete.exists():
        write_made_log(complete, 2200)
    _, raw = make_samples(2200)
    content = bytearray(complete.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        position = data.draw(st.integers(0, len(content) - 1))
        content[position] ^= data.draw(st.integers(1, 255))
    path.write_bytes(content)
    try:
        log = read_log(path)
        log.flight()
    except HeliError as error:
        assert "\n" not in str(error)
        return
    known = {tuple(row) for row in raw.tolist()}
    assert all(tuple(row) in known for row in log.raw.tolist())


@pytest.mark.parametrize("content", [b"", b"\x89MCAP0\r", b"t_s,front_V\n1,2\n", b"\x89MCAP0\r\n"])
def test_what_is_no_log_is_refused_in_one_line(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "a.mcap").write_bytes(content)
    with pytest.raises(LogError, match=r"a\.mcap"):
        read_log(tmp_path / "a.mcap")


def test_an_mcap_of_another_program_is_refused(tmp_path: Path) -> None:
    from mcap.writer import Writer

    other = Writer(str(tmp_path / "other.mcap"))
    other.start()
    schema = other.register_schema("Pose", "jsonschema", b"{}")
    channel = other.register_channel("/pose", "json", schema)
    other.add_message(channel, 1, b"{}", 1)
    other.finish()  # type: ignore[no-untyped-call]
    with pytest.raises(LogError, match="another program"):
        read_log(tmp_path / "other.mcap")


def test_an_empty_log_says_that_nothing_was_heard(tmp_path: Path) -> None:
    open_writer(tmp_path / "a.mcap").close()
    with pytest.raises(TruncatedLog, match="no ticks"):
        read_log(tmp_path / "a.mcap").flight()


def test_a_missing_log_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(LogError, match="cannot read"):
        read_log(tmp_path / "missing.mcap")


_WRITE_FOR_EVER = """
import sys, time
from pathlib import Path
from tests.channels.groups import SETPOINTS
from tests.link import host_reference as reference
from tests.log.made import make_samples, open_writer
tick, raw = make_samples(100_000)
writer = open_writer(Path(sys.argv[1]))
for start in range(0, len(tick), 20):
    writer.write_ticks(tick[start:start + 20], raw[start:start + 20])
    if start % 1000 == 0:
        print(writer.counters.ticks_logged, flush=True)
        time.sleep(0.002)
"""


@pytest.mark.medium
@pytest.mark.skipif(os.name != "posix", reason="skipped: kill -9 is POSIX")
def test_a_log_opens_to_its_last_flush_after_kill_9(tmp_path: Path) -> None:
    path = tmp_path / "killed.mcap"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), str(ROOT / "host")])}
    process = subprocess.Popen(
        [sys.executable, "-c", _WRITE_FOR_EVER, str(path)], stdout=subprocess.PIPE, env=environment, text=True
    )
    assert process.stdout is not None
    ticks_logged = 0
    while ticks_logged < 7000:
        ticks_logged = int(process.stdout.readline())
    process.send_signal(signal.SIGKILL)
    process.wait(timeout=30)
    log = read_log(path)
    _, raw = make_samples(100_000)
    assert not log.complete and "not closed" in log.notes[0]
    assert len(log.ticks) >= ticks_logged - CHUNK_TICKS
    np.testing.assert_array_equal(log.raw, raw[: len(log.ticks)])
    assert log.parameters["hover_V"] == PARAMETERS["hover_V"]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="skipped: no /dev/full")
def test_a_full_disk_at_the_start_is_one_line() -> None:
    with pytest.raises(LogWriteError, match="free some disk space"):
        open_writer(Path("/dev/full"))


@pytest.mark.skipif(os.name != "posix", reason="skipped: file size limits are POSIX")
def test_a_disk_that_fills_up_leaves_a_readable_log(tmp_path: Path) -> None:
    import resource

    path = tmp_path / "full.mcap"
    tick, raw = make_samples(5000)
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    writer = open_writer(path)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (120_000, before[1]))
        with pytest.raises(LogWriteError, match="readable up to here") as raised:
            for start in range(0, len(tick), 20):
                writer.write_ticks(tick[start : start + 20], raw[start : start + 20])
        with pytest.raises(LogWriteError):
            writer.write_ticks(tick[:20], raw[:20])
        with pytest.raises(LogWriteError):
            writer.close()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert "\n" not in str(raised.value)
    log = read_log(path)
    assert len(log.ticks) >= CHUNK_TICKS and len(log.ticks) % CHUNK_TICKS == 0
    np.testing.assert_array_equal(log.raw, raw[: len(log.ticks)])


def test_a_log_in_a_place_that_cannot_be_written_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(LogWriteError, match="--log"):
        open_writer(tmp_path / "file" / "a.mcap")


def test_lost_ticks_are_counted_and_time_goes_on_behind_them(tmp_path: Path) -> None:
    tick, raw = make_samples(3000)
    keep = np.r_[0:1000, 1040:1500, 1501:3000]
    writer = open_writer(tmp_path / "a.mcap")
    writer.write_ticks(tick[keep], raw[keep])
    writer.close()
    assert writer.counters.ticks_lost == 41
    log = read_log(tmp_path / "a.mcap")
    assert log.ticks_lost == 41
    np.testing.assert_allclose(log.ticks["t_s"], np.arange(3000)[keep] * 1e-3, atol=1e-12)
    with pytest.raises(HeliError, match="2 gaps"):
        read_flight(tmp_path / "a.mcap")
    assert read_flight(tmp_path / "a.mcap", allow_gaps=True).gaps.tolist() == [999, 1459]


def test_a_restarted_board_goes_on_in_the_same_log(tmp_path: Path) -> None:
    tick, raw = make_samples(2000, first_tick=90_000)
    writer = open_writer(tmp_path / "a.mcap")
    writer.write_ticks(tick, raw)
    writer.skip(2.5)
    writer.write_ticks(tick[:500] - np.uint32(89_990), raw[:500])
    writer.close()
    log = read_log(tmp_path / "a.mcap")
    assert log.ticks["t_s"][1999] == pytest.approx(1.999)
    assert log.ticks["t_s"][2000] == pytest.approx(1.999 + 2.5)
    assert log.ticks["t_s"][-1] == pytest.approx(1.999 + 2.5 + 0.499)
    assert log.ticks_lost == 0 and writer.counters.ticks_lost == 0


@pytest.mark.medium
@settings(max_examples=100, deadline=None)
@given(
    first=st.integers(0, 2**32 - 1),
    steps=st.lists(st.integers(1, 5000), min_size=1, max_size=60),
    cut=st.integers(1, 60),
)
def test_ticks_unwrap_over_32_bits(first: int, steps: list[int], cut: int) -> None:
    offsets = np.cumsum([0, *steps])
    tick = ((first + offsets) % 2**32).astype(np.uint32)
    clock = TickClock()
    times, lost = [], 0
    for start in range(0, len(tick), cut):
        time_us, more = clock.advance(tick[start : start + cut])
        times.append(time_us)
        lost += more
    np.testing.assert_array_equal(np.concatenate(times), offsets * 1000)
    assert lost == int(offsets[-1]) - len(steps)
    assert clock.time_us(int(tick[-1])) == offsets[-1] * 1000


def test_events_keep_their_device_time_and_the_viewers_log_level(tmp_path: Path) -> None:
    tick, raw = make_samples(1500)
    writer = open_writer(tmp_path / "a.mcap")
    writer.write_event(3, "boot", "long before the log began")
    writer.write_ticks(tick, raw)
    writer.write_event(int(tick[700]), "fault", "pitch_limit: why", 4)
    writer.close()
    log = read_log(tmp_path / "a.mcap")
    assert [(event["t_s"], event["name"], event["level"]) for event in log.events] == [
        (0.0, "boot", 2),
        (0.7, "fault", 4),
    ]
    with (tmp_path / "a.mcap").open("rb") as file:
        schema, _, message = list(make_reader(file).iter_messages(["/heli/event"]))[-1]
    body = json.loads(message.data)
    assert schema is not None and schema.name == "foxglove.Log"
    assert body["timestamp"]["sec"] * 10**9 + body["timestamp"]["nsec"] == WALL_NS + 700_000_000


@pytest.mark.slow
def test_a_ten_minute_log_is_read_whole(tmp_path: Path) -> None:
    tick, raw = make_samples(600_000)
    writer = LogWriter(tmp_path / "a.mcap", start_wall_ns=WALL_NS, metadata={}, rad_per_count=RAD_PER_COUNT)
    writer.write_ticks(tick, raw)
    writer.close()
    started_s = time.perf_counter()
    log = read_log(tmp_path / "a.mcap")
    took_s = time.perf_counter() - started_s
    assert len(log.ticks) == 600_000 and log.ticks_lost == 0
    print(f"600,000 ticks read in {took_s:.2f} s")


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


@pytest.mark.medium
def test_no_damage_to_a_log_raises_anything_but_an_error_of_one_line() -> None:
    broken = fuzz_log(2, samples(4000, 200))
    assert not broken, broken.most_common(5)
