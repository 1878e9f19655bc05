"""Small files that unpack to gigabytes: refused in one line, within a stated memory."""

import gzip
import io
import json
import struct
import subprocess
import sys
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import zstandard
from heli_host.data.tables import limits, read_table
from heli_host.errors import FlightDataError

pytestmark = pytest.mark.medium

LINUX = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="skipped: only Linux limits memory")

MAX_MiB = 400
"""Memory of the process that reads, of which 130 MiB are Python and its packages. Without limits, each of
these files takes more, or minutes."""
MAX_CPU_S = 60
CHILD = """
import json, resource, sys
from pathlib import Path
from heli_host.errors import HeliError
from heli_host.data.tables import read_table
resource.setrlimit(resource.RLIMIT_CPU, (int(sys.argv[1]),) * 2)
outcomes = {}
for path in map(Path, sys.argv[2:]):
    try:
        outcomes[path.name] = f"read {len(read_table(path))}"
    except HeliError as error:
        outcomes[path.name] = str(error)
    # The most that this program had; getrusage counts what the process had before it was this program.
    peak = next(row for row in open("/proc/self/status") if row.startswith("VmHWM"))
    outcomes[path.name] = outcomes[path.name], int(peak.split()[1]) / 1024
print(json.dumps(outcomes))
"""
ZERO_MiB = bytes(1 << 20)


def parquet_of_equal_numbers(path: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    column = pa.array(np.zeros(1_000_000))
    pq.write_table(pa.table({f"c{k}": column for k in range(40)}), path)


def parquet_of_one_long_text(path: Path) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    text = pa.DictionaryArray.from_arrays(pa.array(np.zeros(50_000, np.int32)), pa.array(["x" * 100_000]))
    pq.write_table(pa.table({"t": np.arange(50_000.0), "text": text}), path, compression="zstd")


def mat_that_unpacks_to_more(path: Path) -> None:
    packer = zlib.compressobj(1)
    packed = b"".join(packer.compress(ZERO_MiB) for _ in range(300)) + packer.flush()
    head = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"
    path.write_bytes(head + struct.pack("<II", 15, len(packed)) + packed)


def mat_of_a_huge_cell_array(path: Path) -> None:
    flags, dims = struct.pack("<IIII", 6, 8, 1, 0), struct.pack("<IIii", 5, 8, 1 << 15, 1 << 15)
    body = flags + dims + struct.pack("<HH4s", 1, 1, b"x")
    head = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"
    path.write_bytes(head + struct.pack("<II", 14, len(body)) + body)


def mat_7_3_without_its_chunks(path: Path) -> None:
    import h5py

    with h5py.File(path, "w", userblock_size=512) as file:
        data = file.create_dataset("x", (1, 400_000_000), "f8", chunks=(1, 1_000_000))
        data.attrs["MATLAB_class"] = np.bytes_("double")
    with path.open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file".ljust(116) + bytes(8) + b"\x00\x02IM")


def xlsx(path: Path, sheet: str) -> None:
    import openpyxl

    plain = io.BytesIO()
    book = openpyxl.Workbook()
    book.save(plain)
    with zipfile.ZipFile(plain) as old, zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as new:
        for name in old.namelist():
            space = 'xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main"'
            body = f"<worksheet {space}>{sheet}</worksheet>".encode()
            new.writestr(name, body if name.endswith("sheet1.xml") else old.read(name))


def xlsx_of_many_cells(path: Path) -> None:
    xlsx(path, f"<sheetData>{('<row>' + '<c><v>1</v></c>' * 20 + '</row>') * 400_000}</sheetData>")


def xlsx_of_far_cells(path: Path) -> None:
    rows = "".join(f'<row r="{k}"><c r="XFD{k}"><v>1</v></c></row>' for k in range(1, 201))
    xlsx(path, f'<dimension ref="A1:XFD1048576"/><sheetData>{rows}</sheetData>')


def xlsx_of_a_row_beyond_all(path: Path) -> None:
    xlsx(path, '<sheetData><row r="999999999"><c r="A999999999"><v>1</v></c></row></sheetData>')


def mcap(path: Path, codec: bytes, data: bytes, claimed_bytes: int, mentions: int = 0) -> None:
    body = (
        struct.pack("<QQQII", 0, 0, claimed_bytes, 0, len(codec))
        + codec
        + struct.pack("<Q", len(data))
        + data
    )
    chunk = struct.pack("<BQ", 6, len(body)) + body
    head = b"\x89MCAP0\r\n" + struct.pack("<BQI4sI", 1, 12, 4, b"ros2", 0)
    index = struct.pack("<QQQQIQI", 0, 0, len(head), len(chunk), 0, 0, len(codec)) + codec
    index += struct.pack("<QQ", len(data), claimed_bytes)
    summary = (struct.pack("<BQ", 8, len(index)) + index) * mentions
    end = struct.pack("<BQI", 15, 4, 0)
    start = len(head + chunk + end) if mentions else 0
    footer = struct.pack("<BQQQI", 2, 20, start, 0, 0) + b"\x89MCAP0\r\n"
    path.write_bytes(head + chunk + end + summary + footer)


def mcap_of_a_chunk_of_a_gigabyte(path: Path) -> None:
    packer = zstandard.ZstdCompressor().compressobj()
    packed = b"".join(packer.compress(ZERO_MiB) for _ in range(1024)) + packer.flush()
    mcap(path, b"zstd", packed, 1 << 30)


def mcap_of_a_chunk_that_lies(path: Path) -> None:
    import lz4.frame

    packer = lz4.frame.LZ4FrameCompressor()
    packed = packer.begin() + b"".join(packer.compress(ZERO_MiB) for _ in range(400)) + packer.flush()
    mcap(path, b"lz4", packed, 100)


def mcap_that_names_a_chunk_often(path: Path) -> None:
    mcap(path, b"zstd", zstandard.compress(ZERO_MiB * 64), 1 << 26, mentions=10_000)


def bag_of_a_chunk_that_lies(path: Path) -> None:
    import lz4.frame

    packer = lz4.frame.LZ4FrameCompressor()
    packed = packer.begin() + b"".join(packer.compress(ZERO_MiB) for _ in range(400)) + packer.flush()

    def record(fields: dict[bytes, bytes], data: bytes) -> bytes:
        head = b"".join(
            struct.pack("<I", len(name + value) + 1) + name + b"=" + value for name, value in fields.items()
        )
        return struct.pack("<I", len(head)) + head + struct.pack("<I", len(data)) + data

    chunk = record({b"op": b"\x05", b"compression": b"lz4", b"size": struct.pack("<I", 100)}, packed)
    path.write_bytes(b"#ROSBAG V2.0\n" + chunk)


def text_of_very_many_lines(path: Path) -> None:
    with gzip.open(path, "wb", compresslevel=1) as file:
        file.write(b"t,x\n" + b"12\n" * 5_000_000)


BOMBS: dict[str, tuple[Callable[[Path], None], str]] = {
    "equal.parquet": (parquet_of_equal_numbers, "33 million numbers"),
    "text.parquet": (parquet_of_one_long_text, "256 MiB in column 'text'"),
    "zeros.mat": (mat_that_unpacks_to_more, "256 MiB"),
    "hdf.mat": (mat_7_3_without_its_chunks, "33 million numbers"),
    "cells.xlsx": (xlsx_of_many_cells, "6 million elements"),
    "far.xlsx": (xlsx_of_far_cells, "2 million cells"),
    "beyond.xlsx": (xlsx_of_a_row_beyond_all, "2 million cells"),
    "large.mcap": (mcap_of_a_chunk_of_a_gigabyte, "128 MiB in a chunk"),
    "lies.mcap": (mcap_of_a_chunk_that_lies, "128 MiB in a chunk"),
    "often.mcap": (mcap_that_names_a_chunk_often, "256 MiB"),
    "lies.bag": (bag_of_a_chunk_that_lies, "128 MiB in a chunk"),
    "lines.csv.gz": (text_of_very_many_lines, "4 million lines"),
}


@pytest.mark.slow
@LINUX
def test_small_files_that_unpack_to_gigabytes_are_refused_in_a_line(tmp_path: Path) -> None:
    paths = []
    for name, (make, _) in BOMBS.items():
        make(tmp_path / name)
        paths.append(tmp_path / name)
        assert paths[-1].stat().st_size < 2_000_000, name
    words = [sys.executable, "-c", CHILD, str(MAX_CPU_S), *map(str, paths)]
    outcomes = json.loads(subprocess.run(words, capture_output=True, text=True, check=True).stdout)
    for name, (_, most) in BOMBS.items():
        text, memory_MiB = outcomes[name]
        assert text.startswith(f"{tmp_path / name} unpacks to more than {most}; cut it into pieces"), text
        assert memory_MiB < MAX_MiB, outcomes


@LINUX
def test_a_file_that_lies_about_its_size_is_stopped_by_the_memory_it_may_take(tmp_path: Path) -> None:
    mat_of_a_huge_cell_array(tmp_path / "a.mat")
    with pytest.raises(FlightDataError, match=r"a\.mat needs more than 2 GiB of memory to read"):
        read_table(tmp_path / "a.mat")


def test_sizes_are_counted_up_to_a_limit_for_every_compression() -> None:
    import bz2

    import lz4.frame

    data = bytes(range(256)) * 6_000
    packed = {
        "": data,
        "none": data,
        "zlib": zlib.compress(data),
        "bz2": bz2.compress(data),
        "lz4": lz4.frame.compress(data),
        "zstd": zstandard.compress(data),
    }
    for codec, body in packed.items():
        assert limits.unpacked_bytes(codec, body, 1 << 30) == len(data), codec
        assert 1000 < limits.unpacked_bytes(codec, body, 1000) <= max(len(body), 1000 + (1 << 20)), codec


def test_a_table_at_the_limits_is_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import pandas

    monkeypatch.setattr(limits, "MAX_NUMBERS", 600)
    monkeypatch.setattr(limits, "MAX_ROWS", 200)
    frame = pandas.DataFrame({"t": np.arange(200) * 0.01, "x": np.ones(200), "y": np.zeros(200)})
    frame.to_parquet(tmp_path / "a.parquet")
    assert len(read_table(tmp_path / "a.parquet")) == 200
    frame.assign(z=1.0).to_parquet(tmp_path / "b.parquet")
    with pytest.raises(FlightDataError, match="unpacks to more than"):
        read_table(tmp_path / "b.parquet")
    pandas.concat([frame, frame[:1]]).to_parquet(tmp_path / "c.parquet")
    with pytest.raises(FlightDataError, match="unpacks to more than"):
        read_table(tmp_path / "c.parquet")


def test_a_sheet_with_gaps_dates_and_texts_is_read(tmp_path: Path) -> None:
    import openpyxl

    book = openpyxl.Workbook()
    sheet = book.active
    assert sheet is not None
    sheet.append([])
    sheet.append(["t", "x", "x", None, "note"])
    for k in range(50):
        sheet.append([0.01 * k, k, -k if k != 7 else None, 2 * k, "ok"])
    sheet.append([])
    book.save(tmp_path / "a.xlsx")
    table = read_table(tmp_path / "a.xlsx")
    assert list(table.columns) == ["t", "x", "x'", "column 4"] and len(table) == 50
    assert np.isnan(table.columns["x'"].values[7]) and table.columns["x'"].values[8] == -8.0
