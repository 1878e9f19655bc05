"""Files of others: read in any encoding; one line, bounded time and memory for each that is hostile."""

import codecs
import gzip
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import rich
import zstandard
from heli_host.board.parameters import read_parameter_set
from heli_host.data.files import decode_text, parse_toml, read_file, toml_string
from heli_host.data.log import scan, table
from heli_host.data.log.reader import read_flight, read_log
from heli_host.data.log.summary import summarise
from heli_host.data.log.table import read_csv
from heli_host.data.tables import read_profile
from heli_host.errors import FlightDataError, LogError, PlanError, printable
from heli_host.fly.plan import Plan, load_plan
from heli_host.link.transport import PortInfo
from heli_host.ui.cli.board import is_due, is_due_native
from heli_host.ui.cli.live import LiveLine, WorkBar
from heli_host.ui.cli.say import say, say_files
from heli_sim.model.effects.catalogue import _effects_in_file
from heli_sim.rig import load_rig, rig_text, write_rig
from mcap.data_stream import RecordBuilder
from mcap.records import Chunk

from tests.cli.terminal import Terminal, refusal
from tests.log.made import make_samples, open_writer

ASKED, FILE = 2, 5
NAMES = "t_s,front_V,back_V,elevation_rad,pitch_rad,travel_rad\n"
ROWS = "".join(f"{k * 1e-3:.3f},1,1,0,0,0\n" for k in range(100))
HOLD = 'title = "x"\n[[segment]]\nkind = "hold"\nduration_s = '
ESCAPES = "\x1b]0;owned\x07\x1b[2J\x9b31m\u202e"
ROOT = Path(__file__).resolve().parents[2]
ENCODINGS: dict[str, Callable[[str], bytes]] = {
    "UTF-8": lambda text: text.encode(),
    "UTF-8 with a mark": lambda text: codecs.BOM_UTF8 + text.encode(),
    "UTF-16": lambda text: text.encode("utf-16"),
    "UTF-16, big end first": lambda text: codecs.BOM_UTF16_BE + text.encode("utf-16-be"),
}
PLAN = 'title = "Über"\n[[segment]]\nkind = "hold"\nduration_s = 2\n'
PROFILE = """
[time]
column = "t"
unit = "s"
[elevation]
column = "e"
unit = "deg"
[pitch]
column = "p"
unit = "deg"
[travel]
column = "l"
unit = "deg"
[front]
column = "f"
[back]
column = "b"
"""
EFFECT = (ROOT / "sim" / "heli_sim" / "model" / "effects" / "air.py").read_text()


def raw(text: str) -> set[str]:
    """Return the characters that do something to a terminal."""
    return {character for character in text if not character.isprintable()} - {"\n"}


@pytest.mark.parametrize(
    "text", ["", 'a "quoted" C:\\new', "two\nlines\tand a tab", ESCAPES, "\x7f\U000e0001é"]
)
def test_a_written_string_is_read_back_and_controls_no_terminal(text: str) -> None:
    written = toml_string(text)
    assert parse_toml(f"text = {written}") == {"text": text}
    assert not raw(written) and "\n" not in written


def test_text_for_a_terminal_has_no_control_characters() -> None:
    assert printable("Grüße, 5° – ok") == "Grüße, 5° – ok"
    assert printable("\x1b[31m\x9b\u202e\udc80\r") == "\\x1b[31m\\x9b\\u202e\\udc80\\r"
    assert len(printable("a" * 10**6)) < 2100


@pytest.mark.medium
def test_what_a_log_says_reaches_the_terminal_as_text(terminal: Terminal, tmp_path: Path) -> None:
    writer = open_writer(tmp_path / "a.mcap")
    writer.write_ticks(*make_samples(200))
    writer.write_event(5100, f"name{ESCAPES}", f"text{ESCAPES}")
    writer.write_metadata("session", {f"key{ESCAPES}": f"value{ESCAPES}"})
    writer.write_metadata("plan", {f"plan{ESCAPES}": f"# a plan\n{ESCAPES}"})
    writer.write_metadata("parameters", {f"param{ESCAPES}": "1.0"})
    writer.close({"result": {"outcome": f"outcome{ESCAPES}"}})
    result = terminal("info", "a.mcap", "--events", "--params", "--plan")
    assert result.code == 0 and not raw(result.out) and "\\x1b]0;owned\\x07" in result.out
    notes = f"# event.x: 0.01 {ESCAPES}\n# rig: {ESCAPES}\n"
    (tmp_path / "a.csv").write_text(
        notes + NAMES.replace("\n", f",c{ESCAPES}\n") + ROWS.replace("\n", ",1\n")
    )
    result = terminal("info", "a.csv", "--events")
    assert result.code == 0 and not raw(result.out) and "\\x1b]0;owned\\x07" in result.out


@pytest.mark.medium
def test_what_a_plan_says_reaches_the_terminal_as_text(terminal: Terminal, tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text(f'title = "\\u001b[2J"\n["\\u001b[31m"]\n{HOLD}1\n')
    line = refusal(terminal("fly", "a.toml", "--sil", "--speed", "max"), code=ASKED)
    assert not raw(line)
    (tmp_path / "b.toml").write_text('title = "\\u001b[2Jx"\n' + HOLD.partition("\n")[2] + "1\n")
    result = terminal("fly", "b.toml", "--sil", "--speed", "max", "--log", "b.mcap")
    assert result.code == 0 and not raw(result.out) and "flying: \\x1b[2Jx" in result.out


@pytest.mark.medium
def test_names_of_files_reach_the_terminal_as_text(terminal: Terminal, tmp_path: Path) -> None:
    log = tmp_path / f"a{ESCAPES}.mcap"
    writer = open_writer(log)
    writer.write_ticks(*make_samples(200))
    writer.close()
    write_rig(
        replace(load_rig("makki2024"), name=f"n{ESCAPES}", description=f"d{ESCAPES}"),
        tmp_path / f"r{ESCAPES}.toml",
    )
    for words in (
        ("export", log, "--csv"),
        ("plot", log, "--figure", f"b{ESCAPES}.png"),
        ("rig", "show", f"r{ESCAPES}.toml"),
        ("rig", "check", f"r{ESCAPES}.toml"),
        ("rig", "diff", f"r{ESCAPES}.toml", "makki2024", "--all"),
        ("params", "dump", f"p{ESCAPES}.toml", "--sil"),
    ):
        result = terminal(*words)
        assert result.code == 0, result
        assert not raw(result.out), words
        assert "\\x1b" in result.out, words


def test_each_file_is_reported_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    say("a\nb", "c")
    say_files([Path("d\x1b[2J"), None, Path("e\nf")])
    say_files([None])
    assert capsys.readouterr().out == "a\\nb\nc\nfiles: d\\x1b[2J, e\\nf\n"


@pytest.mark.medium
def test_live_lines_show_names_as_text(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    rich.get_console()  # as another part of the process may have done, where there was no terminal
    for name, value in (("FORCE_COLOR", "1"), ("TERM", "xterm"), ("COLUMNS", "200")):
        monkeypatch.setenv(name, value)
    for is_terminal in (False, True):
        with LiveLine(is_terminal) as live:
            live.say(f"note{ESCAPES}")
        with WorkBar(is_terminal) as bar:
            bar._shown_s = -1e9
            bar.show(f"[/stage]{ESCAPES}", 0.5)
            if bar._bar is not None:
                bar._bar.refresh()
        shown = capsys.readouterr().out
        assert "owned" in shown and "[/stage]" in shown
        assert not any(character in shown for character in ("\x07", "\x9b", "\u202e", "\x1b]0;", "\x1b[2J"))


@pytest.mark.parametrize(
    ("number", "says"),
    [
        ("9" * 400, "more than 64 bits"),
        ("9" * 5000, "more than 64 bits"),
        ("-" + "9" * 400, "more than 64 bits"),
        ("1e999", "inf; give a finite number"),
        ("nan", "nan; give a finite number"),
        ("1e300", r"1e\+300; give more than 0 and at most 3600"),
        ("[" * 100_000 + "]" * 100_000, "nested too deeply"),
        ("{a=" * 20_000 + "1" + "}" * 20_000, "nested too deeply"),
    ],
)
def test_a_plan_of_absurd_numbers_is_one_line(number: str, says: str) -> None:
    with pytest.raises(PlanError, match=says) as raised:
        Plan.parse(f"{HOLD}{number}\n", "plan.toml")
    assert "\n" not in str(raised.value) and len(str(raised.value)) < 500


def test_a_key_of_very_many_parts_takes_no_time() -> None:
    for key in (".".join("a" * 200_000), ' . "b"' * 200_000, "a" * 1_000_000):
        with pytest.raises(ValueError, match=r"nested too deeply|[Ee]xpected|Invalid"):
            parse_toml(f"x.{key} = 1" if key[0] == "a" and "." in key else f"{key} =")
    assert parse_toml('[a.b."c.d"]\nversion = "1.2.3.4"\nx = [1.5, 2.5, -3.5]\n')


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="skipped: no pipes with names on this system")
def test_a_pipe_is_refused_and_not_waited_for(tmp_path: Path) -> None:
    for name in ("a.mcap", "a.csv", "a.csv.gz"):
        os.mkfifo(tmp_path / name)
        with pytest.raises((FlightDataError, LogError), match="a pipe or a device"):
            read_flight(tmp_path / name)
    with pytest.raises(OSError, match="a pipe or a device"):
        read_file(Path("/dev/zero"), 100)


def test_a_file_of_a_terabyte_is_not_read(tmp_path: Path) -> None:
    for name in ("a.mcap", "a.csv", "a.csv.gz"):
        with (tmp_path / name).open("wb") as file:
            file.truncate(1 << 40)
        with pytest.raises((FlightDataError, LogError), match=r"more than .* MiB"):
            read_flight(tmp_path / name)


def test_a_table_that_unpacks_to_more_than_any_flight_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(table, "MAX_TABLE_BYTES", 1 << 20)
    path = tmp_path / "a.csv.gz"
    with gzip.open(path, "wb") as file:
        file.write((NAMES + ROWS).encode() + b"\n" * (1 << 21))
    assert path.stat().st_size < 1 << 14
    with pytest.raises(FlightDataError, match="unpacks to more than 1 MiB"):
        read_flight(path)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("," * 100_000 + "\n", "more than 1000 columns"),
        (NAMES + "," * 100_000 + "\n", "has 100001 columns, the header 6"),
        (NAMES + "\n" * 1001 + ROWS, "more than 1000 lines"),
        (NAMES + ROWS + "1e300,1,1,0,0,0\n", "t_s jumps by 1e"),
        (NAMES + ROWS.replace("0.050,", "1e300,"), "t_s does not increase"),
        (NAMES + f"0,{'9' * 400},1,0,0,0\n" * 50, "front_V is inf"),
        (
            NAMES + "".join(f"{k * 1e-3},1,1,0,0,{(-1) ** k * 1e308}\n" for k in range(50)),
            "looks like degrees",
        ),
    ],
)
def test_a_table_of_absurd_numbers_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, says: str
) -> None:
    monkeypatch.setattr(table, "MAX_LINES", 1000)
    (tmp_path / "a.csv").write_text(text)
    with pytest.raises(FlightDataError, match=says) as raised:
        read_flight(tmp_path / "a.csv")
    assert "\n" not in str(raised.value)


def test_a_state_of_no_number_is_a_note(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(f"# state.²: y\n# parameter.travel_counts_per_rev: nan\n{NAMES}{ROWS}")
    assert read_flight(tmp_path / "a.csv").meta["state.²"] == "y"


def _with_chunk(path: Path, chunk: Chunk) -> None:
    """Write a log of 200 ticks with another chunk behind it, as a stranger's program could."""
    writer = open_writer(path)
    writer.write_ticks(*make_samples(200))
    writer.flush()
    builder = RecordBuilder()
    chunk.write(builder)
    writer._file.append(bytes(builder.end()))  # type: ignore[no-untyped-call]
    writer._file.close()


def _chunk(body: bytes, claimed_bytes: int, *, with_size: bool = True) -> Chunk:
    packed = zstandard.ZstdCompressor(write_content_size=with_size).compress(body)
    return Chunk("zstd", packed, 0, 0, 0, claimed_bytes)


@pytest.mark.parametrize("claimed_bytes", [1 << 22, 100, 1 << 62])
def test_a_chunk_that_is_larger_than_it_says_is_not_unpacked(tmp_path: Path, claimed_bytes: int) -> None:
    _with_chunk(tmp_path / "a.mcap", _chunk(bytes(1 << 21), claimed_bytes))
    log = read_log(tmp_path / "a.mcap")
    assert len(log.ticks) == 200 and any("1 chunks are damaged" in note for note in log.notes)


def test_a_frame_that_claims_a_terabyte_is_not_given_it(tmp_path: Path) -> None:
    # A zstd frame of one empty block, whose header says how much to allocate.
    frame = bytes.fromhex("28b52ffde0") + (1 << 40).to_bytes(8, "little") + b"\x01\x00\x00"
    _with_chunk(tmp_path / "a.mcap", Chunk("zstd", frame, 0, 0, 0, 100))
    assert len(read_log(tmp_path / "a.mcap").ticks) == 200


def test_a_log_that_unpacks_to_more_than_any_flight_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(scan, "MAX_LOG_BYTES", 1 << 20)
    _with_chunk(tmp_path / "a.mcap", _chunk(bytes(1 << 21), 1 << 21))
    with pytest.raises(LogError, match="unpacks to more than 1 MiB"):
        read_log(tmp_path / "a.mcap")


@pytest.mark.parametrize(
    "body",
    [
        b'{"t_s": 0, "name": "a", "message": ' + b"[" * 30_000 + b"]" * 30_000 + b"}",
        b'{"t_s": ' + b"9" * 400 + b', "name": "a", "message": "b"}',
        b'{"t_s": 1e300, "name": "a", "message": "b"}',
        b'{"t_s": NaN, "name": "a", "message": "b"}',
        b'{"t_s": 0, "name": "a", "message": "' + b"b" * 100_000 + b'"}',
    ],
)
def test_an_impossible_event_costs_its_chunk_and_is_reported(tmp_path: Path, body: bytes) -> None:
    from heli_host.data.log.writer import EVENT_CHANNEL, JsonMessage

    writer = open_writer(tmp_path / "a.mcap")
    writer.write_ticks(*make_samples(200))
    writer.flush()
    writer._pending.append(JsonMessage(EVENT_CHANNEL, 0, body))
    writer.close()
    log = read_log(tmp_path / "a.mcap")
    assert len(log.ticks) == 200 and log.events == () and any("damaged" in note for note in log.notes)
    summarise(log)


def test_counters_that_are_no_numbers_are_left_out(tmp_path: Path) -> None:
    writer = open_writer(tmp_path / "a.mcap")
    writer.write_ticks(*make_samples(200))
    writer.write_link(5000, {"retries": 3.0, "frames_ok": 1e300})
    writer.close({"counters": {"frames_bad": "²", "reconnects": "9" * 5000, "x": "--", "y": "-7"}})
    link = summarise(read_log(tmp_path / "a.mcap")).link
    assert link == {"frames_ok": 0, "frames_bad": 0, "retries": 3, "reconnects": 0, "y": -7}


def test_encoders_without_a_size_leave_the_angles_that_were_logged(tmp_path: Path) -> None:
    writer = open_writer(tmp_path / "a.mcap")
    writer.write_ticks(*make_samples(200))
    writer.write_metadata("parameters", {"travel_counts_per_rev": "nan", "pitch_counts_per_rev": "inf"})
    writer.close()
    log = read_log(tmp_path / "a.mcap")
    assert not {"travel_counts_per_rev", "pitch_counts_per_rev"} & log.parameters.keys()
    assert read_flight(tmp_path / "a.mcap").travel_rad[100] == pytest.approx(log.ticks["travel_rad"][100])


@pytest.mark.medium
@pytest.mark.parametrize("encoding", ENCODINGS)
def test_every_text_of_a_user_is_read_in_every_encoding(encoding: str, tmp_path: Path) -> None:
    encode = ENCODINGS[encoding]

    def written(name: str, text: str) -> Path:
        (tmp_path / name).write_bytes(encode(text))
        return tmp_path / name

    assert decode_text(encode("hé")) == "hé"
    assert load_plan(str(written("plan.toml", PLAN))).title == "Über"
    assert load_rig(str(written("rig.toml", rig_text(load_rig("makki2024"))))).name == "makki2024"
    parameters = read_parameter_set(written("params.toml", "[parameters]\nhover_V = 2.0\n"))
    assert parameters.values == {"hover_V": 2.0}
    assert read_profile(written("profile.toml", PROFILE))
    rows = "".join(f"{k / 1000},1,1,0,0,{k / 10000}\n" for k in range(300))
    flight = read_csv(written("flight.csv", f"t_s,front_V,back_V,elevation_rad,pitch_rad,travel_rad\n{rows}"))
    np.testing.assert_allclose(flight.t_s[-1], 0.299)
    kinds = _effects_in_file(written("damping.py", EFFECT.replace("inflow_damping", "my_damping")))
    assert kinds[0].id == "my_damping"


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("logs")
    for name in ("a", "b"):
        words = ["record", "--sil", "--speed", "max", "--duration", "0.5", "-o", f"{name}.mcap", "--quiet"]
        command = [sys.executable, "-c", "from heli_host.ui.cli import main; main()", *words]
        subprocess.run(command, cwd=folder, check=True, capture_output=True)
    return folder


@pytest.mark.medium
@pytest.mark.parametrize("cut", [0, 3000])
def test_two_logs_in_one_file_are_refused_with_the_place_of_the_second(
    cut: int, logs: Path, tmp_path: Path
) -> None:
    first, second = (logs / "a.mcap").read_bytes(), (logs / "b.mcap").read_bytes()
    first = first[: len(first) - cut]
    (tmp_path / "joined.mcap").write_bytes(first + second)
    message = f"two logs that were joined; the second begins after {len(first)} bytes"
    with pytest.raises(LogError, match=message):
        read_log(tmp_path / "joined.mcap")
    assert read_log(logs / "a.mcap").ticks.size == 500


@pytest.mark.medium
def test_two_tables_in_one_file_are_refused(logs: Path, terminal: Terminal) -> None:
    assert terminal("export", logs / "a.mcap", "--csv", "-o", "a.csv").code == 0
    text = Path("a.csv").read_text()
    head, _, rows = text.partition("\n")
    Path("twice.csv").write_text(text + text)
    Path("rows.csv").write_text(f"{head}\n{rows}{rows}")
    with pytest.raises(FlightDataError, match=r"two tables that were joined: line 502 repeats the names"):
        read_csv(Path("twice.csv"))
    with pytest.raises(FlightDataError, match=r"two flights that were joined: t_s falls from 0.499 to 0 s"):
        read_csv(Path("rows.csv"))


@pytest.mark.medium
def test_an_export_has_the_ending_of_its_format(logs: Path, terminal: Terminal) -> None:
    log = logs / "a.mcap"
    for name in ("x.xlsx", "x.txt", "x", "x.mat"):
        ended = terminal("export", log, "--csv", "-o", name)
        assert ended.code == 2 and "give a name that ends in .csv" in ended.err
        assert not Path(name).exists()
    assert terminal("export", log, "--csv", "-o", "x.csv.gz").code == 0
    assert terminal("export", log, "--csv", "-o", "/dev/null").code == 0


@pytest.mark.slow
def test_a_table_is_drawn_as_a_log_is(logs: Path, terminal: Terminal) -> None:
    assert terminal("export", logs / "a.mcap", "--csv", "-o", "a.csv").code == 0
    assert terminal("plot", "a.csv").code == 0
    assert Path("figure.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.medium
def test_a_table_that_heli_host_does_not_read_again_is_said(
    logs: Path, terminal: Terminal, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("a.csv", "a.csv.gz"):
        ended = terminal("export", logs / "a.mcap", "--csv", "-o", name)
        assert "reads at most" not in ended.out
    monkeypatch.setattr(table, "MAX_TABLE_BYTES", 10_000)
    for name in ("a.csv", "a.csv.gz"):
        ended = terminal("export", logs / "a.mcap", "--csv", "-o", name)
        assert ended.code == 0 and "heli-host reads at most 0 MiB; give " in ended.out
    refused = terminal("info", "a.csv")
    assert "it has more than" in refused.err and "cut it into pieces" in refused.err
    assert "disk" not in refused.err


@pytest.mark.medium
@pytest.mark.parametrize("vendor", [0x2341, 0x2A03])
def test_a_due_of_either_vendor_is_a_due(vendor: int) -> None:
    ports = [PortInfo("/dev/ttyACM0", "/dev/ttyACM0", "Due", vendor, product) for product in (0x3D, 0x3E)]
    assert [is_due(port) for port in ports] == [True, False]
    assert [is_due_native(port) for port in ports] == [False, True]
