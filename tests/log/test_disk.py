"""A disk that is full, slow or gone delays nobody and loses nothing in silence; no log is written over."""

import contextlib
import errno
import io
import threading
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from heli_host.data.log import disk
from heli_host.data.log.disk import BackgroundFile, DirectFile, check_free_space, check_new
from heli_host.data.log.reader import read_log
from heli_host.data.log.summary import summarise
from heli_host.data.log.writer import CHUNK_TICKS, LogWriter, last_record
from heli_host.errors import LogWriteError

from tests.log.made import RAD_PER_COUNT, WALL_NS, make_samples

BATCH = 500


class FakeClock:
    """A clock that the test sets."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        """Return the time."""
        return self.now_s


@pytest.fixture
def gate() -> Iterator[threading.Event]:
    """Open at the end of the test, whatever happened in it."""
    event = threading.Event()
    yield event
    event.set()


def on_disk(monkeypatch: pytest.MonkeyPatch, before_write: Callable[[int], None]) -> None:
    """Call something before every write, with the number of writes before it."""

    class Disk(io.FileIO):
        writes = 0

        def write(self, data: object) -> int:
            before_write(Disk.writes)
            Disk.writes += 1
            return super().write(data)  # type: ignore[arg-type]

    monkeypatch.setattr("heli_host.data.log.disk.io.FileIO", Disk)


def blocked_until(gate: threading.Event) -> Callable[[int], None]:
    def wait(_: int) -> None:
        gate.wait()

    return wait


def with_file(monkeypatch: pytest.MonkeyPatch, **options: object) -> None:
    monkeypatch.setattr("heli_host.data.log.writer.BackgroundFile", partial(BackgroundFile, **options))  # type: ignore[arg-type]


def open_log(path: Path, *, background: bool = True, overwrite: bool = False) -> LogWriter:
    return LogWriter(
        path,
        start_wall_ns=WALL_NS,
        metadata={"session": {"rig": "makki2024"}},
        rad_per_count=RAD_PER_COUNT,
        background=background,
        overwrite=overwrite,
    )


def write_all(writer: LogWriter, tick: np.ndarray, raw: np.ndarray) -> None:
    for start in range(0, len(tick), BATCH):
        writer.write_ticks(tick[start : start + BATCH], raw[start : start + BATCH])


def test_a_thread_writes_the_same_bytes(tmp_path: Path) -> None:
    tick, raw = make_samples(3300)
    for name, background in (("a.mcap", True), ("b.mcap", False)):
        writer = open_log(tmp_path / name, background=background)
        write_all(writer, tick, raw)
        writer.close({"result": {"outcome": "completed"}})
    assert (tmp_path / "a.mcap").read_bytes() == (tmp_path / "b.mcap").read_bytes()


@pytest.mark.medium
def test_thirty_seconds_that_do_not_compress_wait_for_a_blocked_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, gate: threading.Event
) -> None:
    on_disk(monkeypatch, blocked_until(gate))
    tick, raw = make_samples(30_000)
    raw = np.random.default_rng(1).integers(-(2**31), 2**31, raw.shape).astype(np.int32)
    writer = open_log(tmp_path / "a.mcap")
    write_all(writer, tick, raw)
    assert writer.counters.ticks_logged == 30_000 and writer.counters.ticks_dropped == 0
    assert (tmp_path / "a.mcap").stat().st_size == 0
    gate.set()
    writer.close()
    log = read_log(tmp_path / "a.mcap")
    assert log.complete and len(log.ticks) == 30_000


def test_more_than_may_wait_is_dropped_counted_and_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, gate: threading.Event
) -> None:
    on_disk(monkeypatch, blocked_until(gate))
    with_file(monkeypatch, queued_bytes=60_000)
    tick, raw = make_samples(9000)
    writer = open_log(tmp_path / "a.mcap")
    write_all(writer, tick[:7000], raw[:7000])
    writer.write_event(int(tick[6500]), "remark", "kept")
    dropped = writer.counters.ticks_dropped
    assert 0 < dropped < 7000
    gate.set()
    writer._file.drain()
    write_all(writer, tick[7000:], raw[7000:])
    writer.close()
    log = read_log(tmp_path / "a.mcap")
    assert log.ticks_lost == dropped == writer.counters.ticks_lost
    assert len(log.ticks) == 9000 - dropped == writer.counters.ticks_logged
    np.testing.assert_array_equal(log.raw, raw[np.isin(tick, log.ticks["tick"])])
    assert "kept" in [event["message"] for event in log.events]
    assert any(note.startswith(f"{dropped} ticks were not logged") for note in summarise(log).notes)


def test_the_time_that_the_disk_blocked_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    clock = FakeClock()

    def pass_time(writes: int) -> None:
        clock.now_s += {3: 2.5, 5: 0.4, 6: 41.0}.get(writes, 0.01)

    on_disk(monkeypatch, pass_time)
    with_file(monkeypatch, now_s=clock)
    writer = open_log(tmp_path / "a.mcap")
    write_all(writer, *make_samples(6000))
    writer.close()
    log = read_log(tmp_path / "a.mcap")
    reported = [event["message"] for event in log.events if event["name"] == "disk_blocked"]
    assert reported == ["the disk blocked for 2.5 s", "the disk blocked for 41.0 s"]
    assert set(reported) <= set(summarise(log).notes)


def test_the_disk_is_made_to_keep_the_log_every_second_or_two_and_its_name_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock, synced_s = FakeClock(), [0.0]
    folders: list[Path] = []

    def pass_time(_: int) -> None:
        clock.now_s += 0.7

    on_disk(monkeypatch, pass_time)
    with_file(monkeypatch, now_s=clock)
    monkeypatch.setattr(disk, "_sync", lambda _: synced_s.append(clock.now_s))
    monkeypatch.setattr(disk, "sync_folder", folders.append)
    writer = open_log(tmp_path / "new" / "a.mcap")
    write_all(writer, *make_samples(9000))
    writer.close()
    assert np.max(np.diff(synced_s)) <= 2.0 and synced_s[-1] == clock.now_s
    assert folders == [tmp_path / "new"]


def test_a_full_disk_is_reported_at_the_next_call_and_leaves_whole_chunks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fill_up(writes: int) -> None:
        if writes == 5:
            raise OSError(errno.ENOSPC, "No space left on device")

    on_disk(monkeypatch, fill_up)
    tick, raw = make_samples(5000)
    writer = open_log(tmp_path / "a.mcap")
    with pytest.raises(LogWriteError, match="No space left on device; free some disk space"):
        write_all(writer, tick, raw)
        writer.close()
    assert writer.write_error is not None
    with pytest.raises(LogWriteError):
        writer.write_ticks(tick, raw)
    log = read_log(tmp_path / "a.mcap")
    assert len(log.ticks) == 3 * CHUNK_TICKS and not log.complete


def test_a_disk_that_refuses_to_keep_what_it_took_is_a_failed_log(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(_: int) -> None:
        raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(disk, "_sync", refuse)
    writer = open_log(tmp_path / "a.mcap")
    with pytest.raises(LogWriteError, match="Input/output error"):
        writer.close()


def test_a_disk_that_never_comes_back_is_given_up_after_the_flight(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, gate: threading.Event
) -> None:
    clock = FakeClock()

    def pass_time() -> float:
        clock.now_s += 40.0
        return clock.now_s

    on_disk(monkeypatch, blocked_until(gate))
    with_file(monkeypatch, now_s=pass_time)
    writer = open_log(tmp_path / "a.mcap")
    write_all(writer, *make_samples(2000))
    with pytest.raises(LogWriteError, match="has accepted no data for 60 s"):
        writer.close()


@pytest.mark.parametrize("background", [True, False])
def test_a_log_that_is_there_is_not_touched(tmp_path: Path, background: bool) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(b"an older flight")
    with pytest.raises(LogWriteError, match="never replaces a log; give another name"):
        open_log(path, background=background)
    with pytest.raises(LogWriteError):
        check_new(path)
    assert path.read_bytes() == b"an older flight"


@pytest.mark.parametrize("name", ["a.csv", "a.csv.gz", "a.mcap.gz", "a", "a.xlsx"])
def test_a_log_under_the_name_of_a_table_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(LogWriteError, match=r"a log is an \.mcap file; .*heli-host export"):
        open_log(tmp_path / name, background=False)
    assert not (tmp_path / name).exists()


@contextlib.contextmanager
def files_up_to(size_bytes: int) -> Iterator[None]:
    """Let this process write no file above a size, as ``ulimit -f`` does."""
    resource = pytest.importorskip("resource", reason="skipped: this system has no limits of a process")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size_bytes, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize("background", [True, False])
def test_a_log_that_meets_a_limit_of_size_names_it(tmp_path: Path, background: bool) -> None:
    limit_bytes = 50_000
    tick, raw = make_samples(6000)
    writer = open_log(tmp_path / "a.mcap", background=background)
    with files_up_to(limit_bytes):
        with pytest.raises(LogWriteError, match=r"cannot write the log .*File too large; raise the limit"):
            write_all(writer, tick, raw)
            writer.close()
        with contextlib.suppress(LogWriteError):
            writer.close()
    log = read_log(tmp_path / "a.mcap")
    assert 0 < len(log.ticks) < 6000 and not log.complete
    np.testing.assert_array_equal(log.raw, raw[: len(log.ticks)])
    # A thread decides how large the writes are. One time in fifty, the last leaves no room for the reason.
    room_bytes = limit_bytes - (tmp_path / "a.mcap").stat().st_size
    if room_bytes >= len(last_record("File too large")) or "File too large" in summarise(log).outcome:
        assert summarise(log).outcome == "not closed: the log could not be written further (File too large)"


def test_a_reason_without_room_is_left_out_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(writes: int) -> None:
        if writes > 4:
            raise OSError(errno.ENOSPC, "No space left on device")

    on_disk(monkeypatch, full)
    writer = open_log(tmp_path / "a.mcap", background=False)
    with pytest.raises(LogWriteError, match="free some disk space"):
        write_all(writer, *make_samples(6000))
    assert summarise(read_log(tmp_path / "a.mcap")).outcome.startswith("not closed: the host ended, or could")


def test_a_limit_of_size_ends_a_flight_while_its_landing_fits(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(disk, "max_file_bytes", lambda: disk.RESERVED_BYTES + 100_000)
    writer = open_log(tmp_path / "a.mcap", background=False)
    tick, raw = make_samples(6000)
    write_all(writer, tick[:1000], raw[:1000])
    assert writer.space_error is None
    write_all(writer, tick[1000:], raw[1000:])
    assert "almost the size that a file may have here" in str(writer.space_error)
    writer.close()
    assert read_log(tmp_path / "a.mcap").complete


def test_a_flight_beyond_the_limit_of_size_does_not_begin(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(disk, "max_file_bytes", lambda: 20_000_000)
    check_free_space(tmp_path / "a.mcap", 60.0)
    with pytest.raises(LogWriteError, match=r"allows files of 20\.0 MB, .* can need 79\.2 MB; .*ulimit -f"):
        check_free_space(tmp_path / "a.mcap", 600.0)


@pytest.mark.parametrize("background", [True, False])
def test_a_log_is_written_over_only_on_request(tmp_path: Path, background: bool) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(b"an older flight, longer than nothing")
    with path.open("rb") as reader:
        open_log(path, background=background, overwrite=True).close()
        assert path.read_bytes().startswith(b"\x89MCAP")
        assert reader.read() == b"an older flight, longer than nothing"
    folder = tmp_path / "folder.mcap"
    folder.mkdir()
    with pytest.raises(LogWriteError):
        open_log(folder, background=background, overwrite=True)


@pytest.mark.skipif(not Path("/dev/null").exists(), reason="skipped: no /dev/null")
def test_a_device_may_take_a_log() -> None:
    file = DirectFile(Path("/dev/null"))
    file.append(b"x")
    file.sync()
    file.close()


def test_a_flight_needs_the_space_of_its_length(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(disk, "free_bytes", lambda _: 20_000_000)
    check_free_space(tmp_path / "a.mcap", 60.0)
    with pytest.raises(LogWriteError, match=r"has 20\.0 MB left, but the flight can need 79\.2 MB"):
        check_free_space(tmp_path / "a.mcap", 600.0)


def test_free_space_is_known_of_a_folder_that_is_still_to_be_made(tmp_path: Path) -> None:
    free_space_bytes = disk.free_bytes(tmp_path / "not" / "yet")
    assert free_space_bytes is not None and free_space_bytes > 0


def test_no_flight_needs_more_space_than_is_asked_for(tmp_path: Path) -> None:
    tick, raw = make_samples(5000)
    raw = np.random.default_rng(1).integers(-(2**31), 2**31, raw.shape).astype(np.int32)
    writer = open_log(tmp_path / "a.mcap", background=False)
    write_all(writer, tick, raw)
    writer.close()
    assert (tmp_path / "a.mcap").stat().st_size < 5.0 * disk.MAX_BYTES_PER_S
