"""Tables: every measured flight reads, others are refused with the place; and the views of a notebook."""

import gzip
import re
import subprocess
import sys
from base64 import b64decode
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from heli_host.data.flight import REQUIRED_COLUMNS, Flight, rate
from heli_host.data.log.reader import read_flight
from heli_host.data.log.table import notes_path, write_csv
from heli_host.errors import FlightDataError, HeliError, LogWriteError
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.log.made import write_made_log
from tests.running.long import samples

SHARED = Path(__file__).resolve().parents[3] / "shared" / "data"
SHARED_FILES = sorted(SHARED.glob("**/*.csv.gz"))
HEADER = ",".join(REQUIRED_COLUMNS)


def rows(n: int = 20, step_s: float = 0.002) -> list[str]:
    return [f"{k * step_s:.3f},1.5,1.6,{0.001 * k:.6f},{-0.002 * k:.6f},{0.003 * k:.6f}" for k in range(n)]


def write(path: Path, *lines: str) -> Path:
    path.write_text("\n".join(lines) + "\n")
    return path


def declared_rates_Hz(folder: Path) -> set[float]:
    """Rates from the README of a collection, and from that of another with the same format."""
    readme = next(at for at in (folder / "README.md", folder.parent / "README.md") if at.exists())
    text = readme.read_text()
    shared = [readme.parent / other / "README.md" for other in re.findall(r"`(\.\./\w+)`", text)]
    return {
        float(rate)
        for readme_text in (text, *map(Path.read_text, shared))
        for rate in re.findall(r"(\d+) Hz", readme_text)
    }


@pytest.mark.medium
@pytest.mark.skipif(not SHARED_FILES, reason="skipped: no shared data")
@pytest.mark.parametrize("path", SHARED_FILES, ids=lambda path: f"{path.parent.name}/{path.name}")
def test_every_shared_flight_reads(path: Path) -> None:
    flight = read_flight(path)
    rates_Hz = declared_rates_Hz(path.parent)
    assert rates_Hz and min(abs(flight.step_s * rate_Hz - 1.0) for rate_Hz in rates_Hz) < 1e-3
    assert len(flight) > 5000
    assert flight.meta and not flight.gaps.size
    assert 10.0 < flight.duration_s < 120.0


def test_columns_come_by_name_and_notes_into_meta(tmp_path: Path) -> None:
    path = write(
        tmp_path / "a.csv",
        "# rig: left one",
        "# free words",
        "battery_V," + HEADER,
        *(f"11.9,{row}" for row in rows(5)),
        "# noticed: something",
        *(f"11.8,{row}" for row in rows(20)[5:]),
    )
    flight = read_flight(path)
    assert flight.meta == {"rig": "left one", "noticed": "something", "notes": "free words"}
    assert flight.extra["battery_V"][0] == 11.9 and flight.extra["battery_V"][-1] == 11.8
    np.testing.assert_allclose(flight.travel_rad, 0.003 * np.arange(20))
    assert flight.state is None and flight.setpoints_rad is None


def test_a_column_of_words_is_left_out(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", HEADER + ",mood", *(row + ",good" for row in rows()))
    assert read_flight(path).extra == {}


@pytest.mark.medium
def test_a_flight_written_as_table_is_read_back(tmp_path: Path) -> None:
    write_made_log(tmp_path / "a.mcap", 3000)
    flight = read_flight(tmp_path / "a.mcap")
    for name in ("a.csv", "a.csv.gz"):
        write_csv(flight, tmp_path / name)
        again = read_flight(tmp_path / name)
        np.testing.assert_allclose(again.angles_rad, flight.angles_rad, atol=1e-9)
        np.testing.assert_allclose(again.voltages_V, flight.voltages_V, atol=1e-9)
        np.testing.assert_array_equal(again.state, flight.state)
        assert again.parameters == flight.parameters and again.plan == flight.plan
        assert again.state_names == flight.state_names and again.meta == flight.meta
        assert [event.text for event in again.events] == [event.text for event in flight.events]
    write_csv(flight, tmp_path / "b.csv.gz")
    assert (tmp_path / "a.csv.gz").read_bytes() == (tmp_path / "b.csv.gz").read_bytes()


@pytest.mark.medium
def test_pandas_reads_a_table_without_arguments_and_notes_are_next_to_it(tmp_path: Path) -> None:
    pandas = pytest.importorskip("pandas")
    write_made_log(tmp_path / "a.mcap", 300)
    flight = read_flight(tmp_path / "a.mcap")
    path = tmp_path / "a.csv"
    write_csv(flight, path)
    frame = pandas.read_csv(path)
    assert list(frame.columns) == list(flight.columns())
    assert all(kind.kind in "iuf" for kind in frame.dtypes)
    np.testing.assert_allclose(frame["travel_rad"], flight.travel_rad, atol=1e-9)
    assert "parameter.hover_V: " in notes_path(path).read_text()
    # Notes of an older table would describe another flight.
    write_csv(Flight(**{name: getattr(flight, name) for name in REQUIRED_COLUMNS}), path)
    assert not notes_path(path).exists() and read_flight(path).parameters == {}


@pytest.mark.medium
def test_a_table_with_its_notes_inside_reads_as_before(tmp_path: Path) -> None:
    write_made_log(tmp_path / "a.mcap", 300)
    flight = read_flight(tmp_path / "a.mcap")
    write_csv(flight, tmp_path / "a.csv", notes_inside=True)
    again = read_flight(tmp_path / "a.csv")
    assert not notes_path(tmp_path / "a.csv").exists()
    assert (again.parameters, again.plan, again.meta) == (flight.parameters, flight.plan, flight.meta)
    assert again.events == flight.events and (tmp_path / "a.csv").read_text().startswith("# ")


def test_notes_that_are_no_notes_are_refused_or_read_as_words(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", HEADER, *rows())
    notes_path(path).write_bytes(b"\xff\xfe free words\n\nrig: mine\n")
    assert read_flight(path).meta["rig"] == "mine"
    notes_path(path).unlink()
    notes_path(path).mkdir()
    with pytest.raises(FlightDataError, match=r"cannot read .*notes\.txt"):
        read_flight(path)


def test_a_table_into_a_missing_folder_is_one_line(tmp_path: Path) -> None:
    flight = read_flight(write(tmp_path / "a.csv", HEADER, *rows()))
    with pytest.raises(LogWriteError, match="choose another folder"):
        write_csv(flight, tmp_path / "missing" / "a.csv")


def replaced(line: int, column: int, value: str) -> list[str]:
    table = [row.split(",") for row in rows()]
    table[line][column] = value
    return [",".join(row) for row in table]


@pytest.mark.parametrize(
    ("lines", "message"),
    [
        ([], "the file is empty"),
        ([HEADER], "no rows below"),
        ([HEADER, *rows(4)], "t_s has only 4 rows"),
        ([HEADER.replace("pitch_rad", "pitch_deg"), *rows()], "convert pitch_deg to radians"),
        ([HEADER.replace("front_V", "frontV"), *rows()], "column front_V is missing; rename 'frontV'"),
        ([HEADER.replace(",", ";"), *rows()], "separate the columns by commas"),
        (rows(), "put a first line with the column names"),
        ([HEADER + ",t_s", *(row + ",1" for row in rows())], "column 't_s' exists twice"),
        ([HEADER, *replaced(line=7, column=3, value="nan")], "elevation_rad is nan in line 9"),
        (["# note", HEADER, "# note", *replaced(line=7, column=1, value="inf")], "front_V is inf in line 11"),
        ([HEADER, "", *replaced(line=7, column=1, value="inf")], "front_V is inf in line 10"),
        (
            [HEADER, *rows()[:3], "  ", *replaced(line=7, column=1, value="inf")[3:]],
            "front_V is inf in line 10",
        ),
        ([HEADER, *replaced(line=7, column=4, value="abc")], "pitch_rad is 'abc' in line 9, not a number"),
        ([HEADER, *replaced(line=7, column=4, value="")], "pitch_rad is '' in line 9, not a number"),
        ([HEADER, *rows()[:12], "0.024,1,1"], "line 14 has 3 columns, the header 6"),
        ([HEADER, *replaced(line=7, column=0, value="0.001")], "t_s does not increase in line 9"),
        ([HEADER, *rows()[:9], *rows()[12:]], "t_s jumps by 0.008 s in line 11"),
        ([HEADER, *rows(20, 2.0)], "looks like milliseconds"),
        (
            [HEADER, *replaced(line=7, column=3, value="-25.1")],
            "elevation_rad is -25.1 in line 9, which looks like degrees",
        ),
        (
            [HEADER, *replaced(line=7, column=2, value="1500")],
            "back_V is 1500 in line 9, which looks like millivolts",
        ),
    ],
)
def test_what_cannot_be_trusted_is_refused_with_its_place(
    tmp_path: Path, lines: list[str], message: str
) -> None:
    path = write(tmp_path / "a.csv", *lines)
    with pytest.raises(FlightDataError) as raised:
        read_flight(path)
    assert message in str(raised.value) and str(path) in str(raised.value)
    assert "\n" not in str(raised.value)


def steps_of(axis: int, step: float) -> list[str]:
    table = [row.split(",") for row in rows(100)]
    for number, row in enumerate(table):
        row[axis] = f"{round(3.0 * np.sin(0.1 * number) / step) * step:.6f}"
    return [",".join(row) for row in table]


@pytest.mark.parametrize(("axis", "name"), [(3, "elevation_rad"), (5, "travel_rad")])
def test_degrees_below_any_limit_are_known_by_their_steps(tmp_path: Path, axis: int, name: str) -> None:
    path = write(tmp_path / "a.csv", HEADER, *steps_of(axis, 360 / 4096))
    with pytest.raises(FlightDataError, match=rf"{name} .*looks like degrees; multiply the angles by pi/180"):
        read_flight(path)


def test_travel_may_turn_many_times_in_radians(tmp_path: Path) -> None:
    read_flight(write(tmp_path / "a.csv", HEADER, *steps_of(5, 2 * np.pi / 4096)))


def test_travel_may_turn_in_each_row_of_a_slow_log(tmp_path: Path) -> None:
    table = [row.split(",") for row in rows(100)]
    for number, row in enumerate(table):
        row[5] = f"{0.03 * number + 0.002 * np.sin(0.1 * number):.6f}"
    read_flight(write(tmp_path / "a.csv", HEADER, *map(",".join, table)))


def test_gaps_are_taken_on_request(tmp_path: Path) -> None:
    path = write(tmp_path / "a.csv", HEADER, *rows()[:9], *rows()[12:])
    assert read_flight(path, allow_gaps=True).gaps.tolist() == [8]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (lambda data: data[: len(data) // 2], "ends early"),
        (lambda data: b"plain text", "not a gzip file"),
        (lambda data: data[:40] + bytes(40) + data[80:], "damaged"),
    ],
)
def test_a_broken_archive_is_one_line(
    tmp_path: Path, content: Callable[[bytes], bytes], message: str
) -> None:
    packed = gzip.compress("\n".join([HEADER, *rows(500)]).encode())
    (tmp_path / "a.csv.gz").write_bytes(content(packed))
    with pytest.raises(FlightDataError, match=message):
        read_flight(tmp_path / "a.csv.gz")


def test_a_file_of_another_kind_or_none_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "a.xlsx").touch()
    with pytest.raises(FlightDataError, match=r"\.mcap, \.csv or \.csv\.gz"):
        read_flight(tmp_path / "a.xlsx")
    with pytest.raises(FlightDataError, match="check the path"):
        read_flight(tmp_path / "a.csv")


@pytest.mark.slow
@settings(max_examples=samples(200, 60), deadline=None)
@given(st.one_of(st.binary(max_size=300), st.text(max_size=300).map(str.encode)), st.booleans())
def test_bytes_of_any_kind_raise_nothing_but_flight_data_errors(
    tmp_path_factory: pytest.TempPathFactory, content: bytes, with_header: bool
) -> None:
    path = tmp_path_factory.getbasetemp() / "any.csv"
    path.write_bytes(HEADER.encode() + b"\n" + content if with_header else content)
    try:
        read_flight(path)
    except HeliError as error:
        assert isinstance(error, FlightDataError)
        assert "\n" not in str(error)


def test_a_part_keeps_its_time_axis_and_its_events(tmp_path: Path) -> None:
    write_made_log(tmp_path / "a.mcap", 3000)
    flight = read_flight(tmp_path / "a.mcap")
    part = flight.between(0.5, 2.0)
    assert len(part) == 1500 and part.t_s[0] == pytest.approx(0.5)
    assert [event.text for event in part.events] == ["sine"]
    with pytest.raises(FlightDataError, match="this flight spans"):
        flight.between(50.0, 60.0)


def test_columns_of_different_length_are_refused() -> None:
    ten, nine = np.zeros(10), np.zeros(9)
    with pytest.raises(FlightDataError, match="pitch_rad"):
        Flight(
            t_s=np.linspace(0.0, 0.9, 10),
            front_V=ten,
            back_V=ten,
            elevation_rad=ten,
            pitch_rad=nine,
            travel_rad=ten,
        )


@pytest.mark.medium
def test_studying_a_flight_imports_no_session_and_no_port(tmp_path: Path) -> None:
    write_made_log(tmp_path / "a.mcap", 2000)
    script = (
        "import sys\n"
        "from heli_host.data.log.reader import read_flight\n"
        "from heli_host.data.log.table import write_csv\n"
        f"write_csv(read_flight({str(tmp_path / 'a.mcap')!r}), {str(tmp_path / 'a.csv')!r})\n"
        "print(*sorted(sys.modules))\n"
    )
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    loaded = set(run.stdout.split())
    assert "heli_host.data.log.reader" in loaded
    assert not loaded & {
        "serial",
        "heli_host.link.session",
        "heli_host.link.transport",
        "heli_host.board.heli",
    }


COUNT_RAD = 2.0 * np.pi / 4096


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Flight:
    path = tmp_path_factory.mktemp("made") / "a.mcap"
    write_made_log(path, 3000)
    return read_flight(path)


def test_the_packages_show_their_names_and_load_nothing_for_it() -> None:
    script = (
        "import sys, heli_host, heli_lab\n"
        "shown = [name for name in dir(heli_host) if not name.startswith('_')]\n"
        "assert shown == sorted(heli_host.__all__) and 'connect' in shown, shown\n"
        "assert [name for name in dir(heli_lab) if not name.startswith('_')] == ['linearise']\n"
        "assert not {'serial', 'numpy', 'casadi', 'mcap', 'pandas'} & set(sys.modules)\n"
    )
    subprocess.run([sys.executable, "-c", script], check=True)


def test_a_flight_says_how_long_how_fast_which_rig_and_which_states(flight: Flight) -> None:
    assert repr(flight) == (
        "<Flight: 3.0 s, 3000 rows at 1000 Hz; rig makki2024; "
        "idle 6 %, armed 2 %, closed_loop 80 %, landing 12 %>"
    )
    empty = np.zeros(0)
    assert (
        repr(
            Flight(
                t_s=empty, front_V=empty, back_V=empty, elevation_rad=empty, pitch_rad=empty, travel_rad=empty
            )
        )
        == "<Flight: no rows>"
    )


@pytest.mark.parametrize("hertz", [0.5, 1.0, 2.0])
def test_a_rate_is_the_derivative_of_what_the_encoder_counts(hertz: float) -> None:
    t_s = np.linspace(0.0, 3.999, 4000)
    angle_rad = 0.3 * np.sin(2.0 * np.pi * hertz * t_s)
    true = 0.3 * 2.0 * np.pi * hertz * np.cos(2.0 * np.pi * hertz * t_s)
    rate_rad_s = rate(t_s, np.round(angle_rad / COUNT_RAD) * COUNT_RAD)
    inside = slice(60, -60)
    # Half of the parabolas' length loses 4 % at 2 Hz; the module states the noise, which adds to this.
    assert np.abs(rate_rad_s - true)[inside].max() < 0.05 * np.abs(true).max() + np.deg2rad(0.5)
    assert np.std(rate(t_s, angle_rad)[inside]) == pytest.approx(np.std(true[inside]), rel=0.05)


def test_no_rate_is_taken_across_a_gap() -> None:
    t_s = np.delete(np.linspace(0.0, 0.999, 1000), slice(400, 600))
    angle_rad = np.where(t_s < 0.5, 0.0, 1.0)
    np.testing.assert_allclose(rate(t_s, angle_rad), 0.0, atol=1e-12)
    assert np.isnan(rate(t_s[:3], angle_rad[:3])).all()


@pytest.mark.medium
def test_a_table_of_pandas_has_every_column_degrees_and_rates(flight: Flight) -> None:
    table = flight.dataframe()
    assert table.index.name == "t_s" and len(table) == len(flight)
    for name, column in flight.columns().items():
        if name != "t_s":
            np.testing.assert_array_equal(table[name], column)
    np.testing.assert_allclose(table["travel_deg"], np.rad2deg(flight.travel_rad))
    np.testing.assert_array_equal(table["pitch_rate_deg_s"], flight.pitch_rate_deg_s)


@pytest.mark.medium
def test_without_pandas_everything_else_works(flight: Flight, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ImportError):
        flight.dataframe()
    assert flight.elevation_rate_deg_s.shape == flight.t_s.shape


@pytest.mark.medium
def test_a_notebook_gets_the_text_and_a_small_figure(flight: Flight) -> None:
    shown = flight._repr_html_()
    assert "&lt;Flight: 3.0 s" in shown
    embedded = re.search(r'base64,([^"]+)"', shown)
    assert embedded is not None
    picture = b64decode(embedded[1])
    assert picture[:8] == b"\x89PNG\r\n\x1a\n" and len(picture) < 80_000
    assert int.from_bytes(picture[16:20]) == 640 and int.from_bytes(picture[20:24]) == 320


def test_an_export_has_the_counts(flight: Flight, tmp_path: Path) -> None:
    for axis in ("elevation", "pitch", "travel"):
        counts = flight.extra[f"{axis}_count"]
        np.testing.assert_array_equal(counts, np.rint(getattr(flight, f"{axis}_rad") / COUNT_RAD))
