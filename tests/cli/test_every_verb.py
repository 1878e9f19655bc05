"""Every verb has readable help, names one board, writes JSON, serves this machine only and imports little."""

import json
import os
import re
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from ipaddress import IPv4Address, IPv6Address, ip_address
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
import pytest
import serial
import typer
from heli_host.data.flight import Flight
from heli_host.data.log.table import write_csv
from heli_host.errors import PortError
from heli_host.ui.cli.board import ARDUINO_VIDS, DUE_NATIVE_PID, DUE_PROGRAMMING_PID, check_target
from heli_host.ui.cli.entry import command_line
from heli_host.ui.cli.verb import installed_verbs, with_option_groups
from serial.tools import list_ports
from serial.tools.list_ports_common import ListPortInfo
from typer.testing import CliRunner

from tests.cli.terminal import PATIENCE_S, Terminal, command, listed_commands, process, refusal

pytestmark = pytest.mark.medium

COMMANDS: dict[str, Any] = dict(listed_commands(command_line()))
LEAVES = {name: verb for name, verb in COMMANDS.items() if not getattr(verb, "commands", None)}
LAW = str(Path(__file__).resolve().parents[2] / "docs/laws/lqr.py")
LONGEST = 80
OPENERS = """a an all also as at file flights folder for how if its more no not of one only other others so
the this to until what when where whether which with without say says tell tells told does is"""
"""First words that are no imperative verb, or one that table B of the style guide excludes."""
UNWANTED = re.compile(
    r"\b(tell|tells|told|foretell|foretold|foreseen|weather|draughty|windy|beside|stands in|lies in|anew"
    r"|as ever|of one's own|parted|dear|dearest|mend|mends|walk|room|tenant|seam|seat|likelier|surer|nats"
    r"|at once|the make|of a make|machines of|nobody|somebody|whoever)\b",
    re.IGNORECASE,
)
"""Words of table B in the style guide, as far as help could use them."""
ARGUMENTS = {
    "calibrate": ("--rig", "makki2024"),
    "dashboard": (),
    "fly": ("hover",),
    "law compare": (LAW,),
    "law fly": (LAW,),
    "motors": (),
    "params dump": ("dumped.toml",),
    "params get": ("hover_V",),
    "params list": (),
    "params restore": ("dump.toml",),
    "params save": (),
    "params set": ("hover_V", "1.5"),
    "record": (),
    "setpoint": ("--elevation-deg", "1"),
    "watch": (),
}
"""Verbs that open a board, and what else each needs."""
SIL = ("--sil", "--speed", "max")
WITHOUT = {
    "course", "export", "flash", "motors", "watch", "sil", "dashboard", "web", "benchmark make",
    "benchmark report", "benchmark run", "law export", "paper equations", "paper figures", "params dump",
    "params save", "rig export", "rig from-board", "rig new", "rig to-board",
}  # fmt: skip
"""Verbs whose result is a file, a served board, or only what is shown live."""
CAMPAIGN = """
work = "tests.campaign.works:count"
[cases]
number = [1, 2]
nap_s = 600.0
log = "began.txt"
"""
ENDED = {
    "benchmark", "calibrate", "class", "course", "diagnose", "doctor", "export", "flash", "identify",
    "import", "info", "law", "motors", "paper", "params", "plot", "pool", "ports", "predict", "rig",
    "setpoint", "tune", "twin", "watch", "web",
}  # fmt: skip
"""Verbs that serve nobody: they read and write files, or talk to a board as `fly` and `record` do."""
SHORT = 'title = "Short"\n[[segment]]\nkind = "hold"\nduration_s = 6\n'
# A flight without SciPy takes half of the time.
FLY = """
import sys
from heli_host.ui.cli import run
code = run(["fly", "short.toml", "--sil", "--speed", "max", "--board", "native", "--log", "flight.mcap"])
assert "heli_lab.watch.encoder_scale" in sys.modules
heavy = "matplotlib", "pandas", "scipy"
sys.exit(code or next((name for name in sys.modules if name.startswith(heavy)), 0))
"""
GREET = '''\
"""``heli-host greet``."""

from heli_host.ui.cli.verb import Verb


def greet(name: str) -> None:
    """Say good day."""
    print(f"good day, {name}")


VERB = Verb(greet, "Own")
'''

_PROC: Final = Path("/proc")
_TABLES: Final = {"tcp": "0A", "tcp6": "0A", "udp": "07", "udp6": "07"}
"""Tables of the kernel, and the state in which a socket takes what anybody sends."""


def options_of(verb: Any) -> list[str]:
    return [option for parameter in verb.params for option in parameter.opts]


def help_lines() -> list[tuple[str, str]]:
    lines = []
    for name, verb in COMMANDS.items():
        lines.append((name, (verb.help or "").partition("\n")[0]))
        for parameter in verb.params:
            text = getattr(parameter, "help", None)
            if text and parameter.name not in ("help", "install_completion", "show_completion"):
                lines.append((f"{name} {parameter.opts[0]}", text.partition("  [default:")[0]))
    return lines


def paragraphs(verb: Any) -> list[str]:
    return [" ".join(part.split()) for part in (verb.help or "").split("\n\n")]


@pytest.mark.parametrize(("where", "line"), help_lines(), ids=[where for where, _ in help_lines()])
def test_a_line_of_help_is_a_short_instruction_in_ordinary_words(where: str, line: str) -> None:
    assert len(line) <= LONGEST, len(line)
    assert ";" not in line
    assert line.endswith(".")
    assert line.split(maxsplit=1)[0].strip(".,").lower() not in OPENERS.split()
    assert line[0].isupper()
    assert not UNWANTED.search(line)


@pytest.mark.parametrize("name", COMMANDS)
def test_help_has_a_purpose_side_effects_and_an_example(name: str) -> None:
    verb = COMMANDS[name]
    parts = paragraphs(verb)
    assert not any(UNWANTED.search(part) for part in parts), UNWANTED.findall(" ".join(parts))
    assert not any(";" in part for part in parts)
    if getattr(verb, "commands", None):
        if name != "heli-host":
            assert (
                f"heli-host {name} COMMAND --help" in parts[-1]
                or f"heli-host {name} COMMAND --help" in parts[-2]
            )
        return
    assert len(parts) >= 3, "a first line, a paragraph on defaults and side effects, and an example"
    assert parts[-1].startswith("Example: `heli-host ")
    for part in parts[1:-1]:
        for sentence in re.split(r"(?<=[.:]) ", part):
            assert len(sentence.split()) <= 25, sentence


@pytest.mark.parametrize("name", COMMANDS)
def test_what_is_printed_has_every_word_of_the_help(name: str, terminal: Terminal) -> None:
    """The renderer drops what looks like a tag, such as a placeholder in angle brackets."""
    words = [] if name == "heli-host" else name.split()
    shown = re.sub(r"[\s│╭╮╰╯─]", "", terminal(*words, "--help").out)
    for part in paragraphs(COMMANDS[name]):
        assert re.sub(r"[\s`]", "", part) in shown


def due(device: str, product: int = DUE_PROGRAMMING_PID) -> ListPortInfo:
    port = ListPortInfo(device)
    port.vid, port.pid = ARDUINO_VIDS[0], product
    return port


@pytest.fixture
def no_port_opens(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[str]:
    """One Due is plugged in; every attempt to open a port is noted and fails the test."""
    (tmp_path / "dump.toml").write_text("[parameters]\nhover_V = 1.5\n")
    opened: list[str] = []

    def refuse(url: str, *arguments: object, **options: object) -> None:
        opened.append(url)
        raise AssertionError(f"{url} was opened")

    monkeypatch.setattr(list_ports, "comports", lambda: [due("/dev/ttyACM7")])
    monkeypatch.setattr(serial, "serial_for_url", refuse)
    monkeypatch.setattr("heli_host.connect", refuse)
    monkeypatch.delenv("HELI_PORT", raising=False)
    return opened


@pytest.mark.parametrize("verb", ARGUMENTS)
def test_a_verb_without_a_target_opens_nothing_and_lists_the_boards(
    verb: str, terminal: Terminal, no_port_opens: list[str]
) -> None:
    line = refusal(terminal(*verb.split(), *ARGUMENTS[verb]), code=3)
    assert line == (
        "error: no board is named; add --sil for the simulation, "
        "or --port /dev/ttyACM7 for the Due found there"
    )
    assert not no_port_opens


@pytest.mark.parametrize("verb", ARGUMENTS)
def test_a_verb_with_two_targets_opens_nothing(
    verb: str, terminal: Terminal, no_port_opens: list[str]
) -> None:
    line = refusal(terminal(*verb.split(), *ARGUMENTS[verb], "--sil", "--port", "/dev/ttyACM7"), code=2)
    assert "--port and --sil name two different boards" in line
    assert not no_port_opens


# The options of `law compare` are those of `law fly`, and it compiles two laws before it opens a board.
@pytest.mark.slow
@pytest.mark.parametrize("verb", [verb for verb in ARGUMENTS if verb != "law compare"])
def test_a_verb_takes_its_target_from_the_environment(
    verb: str, terminal: Terminal, no_port_opens: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HELI_PORT", "/dev/ttyACM8")
    terminal(*verb.split(), *ARGUMENTS[verb])
    assert no_port_opens == ["/dev/ttyACM8"]


def test_every_verb_that_takes_a_port_is_tested_here() -> None:
    with_port = {name: options_of(verb) for name, verb in LEAVES.items() if "--port" in options_of(verb)}
    # `class` flies in simulation first, and asks before each flight on the rig.
    assert set(with_port) == {*ARGUMENTS, "class", "flash"}
    assert {name for name, options in with_port.items() if "--sil" not in options} == {"class", "flash"}


def test_a_verb_for_a_real_board_offers_no_simulation(no_port_opens: list[str]) -> None:
    with pytest.raises(PortError, match="add --port /dev/ttyACM7 for the Due found there"):
        check_target(None, None)


@pytest.mark.parametrize(
    ("plugged_in", "remedy"),
    [
        ([], "and no Due is plugged in; add --sil for the simulation"),
        ([due("/dev/ttyACM1"), due("/dev/ttyACM2")], "--port /dev/ttyACM1 or --port /dev/ttyACM2"),
        ([due("/dev/ttyACM1", DUE_NATIVE_PID)], "move its cable to the programming port"),
    ],
    ids=["none", "two", "native port"],
)
def test_the_remedy_follows_from_what_is_plugged_in(
    plugged_in: list[ListPortInfo],
    remedy: str,
    terminal: Terminal,
    no_port_opens: list[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(list_ports, "comports", lambda: plugged_in)
    assert remedy in refusal(terminal("fly", "hover"), code=3)


@pytest.fixture
def flight(tmp_path: Path) -> Path:
    t_s = np.linspace(0.0, 0.99, 100, dtype=np.float64)
    write_csv(
        Flight(
            t_s=t_s,
            front_V=t_s,
            back_V=t_s,
            elevation_rad=t_s,
            pitch_rad=t_s,
            travel_rad=t_s,
            meta={"rig": "mine"},
        ),
        tmp_path / "a.csv",
    )
    return tmp_path / "a.csv"


def test_what_is_listed_is_json_where_asked(terminal: Terminal, flight: Path) -> None:
    summary = json.loads(terminal("info", flight, "--json", "-").out)
    assert (summary["rows"], summary["notes"]) == (100, {"rig": "mine"})
    assert isinstance(json.loads(terminal("ports", "--json", "-").out)["ports"], list)
    params = json.loads(terminal("params", "list", "hover", "--sil", "--json", "-").out)
    assert params["parameters"]["hover_V"]["unit"] == "V"
    rig = json.loads(terminal("rig", "show", "makki2024", "dead_zone", "--json", "-").out)
    assert set(rig["numbers"]) == {"dead_zone"}
    assert rig["numbers"]["dead_zone"]["tolerance"] > 0.0


def test_rigs_are_json_where_asked(terminal: Terminal) -> None:
    listed = json.loads(terminal("rig", "list", "--json", "-").out)["rigs"]
    assert "makki2024" in [rig["name"] for rig in listed]
    (checked,) = json.loads(terminal("rig", "check", "makki2024", "--json", "-").out)["rigs"]
    assert checked["is_valid"]
    compared = json.loads(terminal("rig", "diff", "makki2024", "quanser-course", "--json", "-").out)
    assert {"name", "left", "right", "tolerances"} <= compared["numbers"][0].keys()


def test_rig_that_cannot_be_is_json_and_an_error(terminal: Terminal) -> None:
    result = terminal("rig", "check", "nobodys", "--json", "-")
    assert result.code != 0
    (checked,) = json.loads(result.out)["rigs"]
    assert not checked["is_valid"]
    assert checked["error"] in result.err


def test_every_verb_can_be_quiet_and_has_short_help() -> None:
    assert len(LEAVES) > 25
    for name, verb in LEAVES.items():
        assert options_of(verb).count("--quiet") == 1, name
        assert verb.context_settings.get("help_option_names", ["-h"]) is not None, name


def test_quiet_leaves_results_and_takes_progress(terminal: Terminal) -> None:
    recorded = ("record", "--sil", "--speed", "max", "--duration", "6")
    loud = terminal(*recorded, "-o", "a.mcap")
    quiet = terminal(*recorded, "-o", "b.mcap", "-q")
    assert "log: b.mcap" in quiet.out
    assert "recording" in loud.out
    assert "recording" not in quiet.out
    # And not for the command after it.
    assert "recording" in terminal(*recorded, "-o", "c.mcap").out
    assert "files:" in terminal("plot", "a.mcap", "b.mcap").out
    assert "files:" not in terminal("--quiet", "plot", "a.mcap", "b.mcap").out


def test_shell_completes_verbs(tmp_path: Path) -> None:
    completion = {"_HELI_HOST_COMPLETE": "complete_bash", "COMP_WORDS": "heli-host pl", "COMP_CWORD": "1"}
    with process(tmp_path, prepare=lambda: os.environ.update(completion)) as running:
        out, _ = running.communicate(timeout=60)
    assert out.split() == ["plot"]


def test_doctor_ends_alike_in_both_forms(terminal: Terminal) -> None:
    result = terminal("doctor", "--json", "-")
    report = json.loads(result.out)
    assert report["ready"] == (result.code == 0)
    assert {finding["verdict"] for finding in report["findings"]} <= {"good", "note", "bad"}


def test_a_table_goes_to_standard_output(flight: Path) -> None:
    with process(flight.parent, "export", flight, "--csv", "-o", "-") as running:
        out, _ = running.communicate(timeout=60)
    # There is no second file for the notes.
    assert out == "# rig: mine\n" + flight.read_text()
    assert running.returncode == 0


def test_version_and_short_help(terminal: Terminal) -> None:
    result = terminal("--version")
    assert result.code == 0
    assert result.out.startswith("heli-host ")
    assert terminal("-h").code == 0
    assert "Example" in terminal("rig", "show", "-h").out
    assert "--install-completion" in terminal("--help").out


def test_every_verb_with_a_result_takes_a_json_file() -> None:
    assert {name for name, verb in LEAVES.items() if "--json" not in options_of(verb)} == WITHOUT
    for name, verb in LEAVES.items():
        options = [option for option in verb.params if "--json" in option.opts]
        assert all(option.metavar == "FILE" and not option.is_flag for option in options), name


@pytest.mark.parametrize(
    ("words", "key"),
    [
        (("params", "set", "hover_V", "1.5", "--sil"), "value"),
        (("record", *SIL, "--duration", "1", "-o", "a.mcap"), "ticks_logged"),
        (("setpoint", *SIL, "--take-off", "--elevation-deg", "2", "--duration", "1"), "elevation_deg"),
        (("fly", "short.toml", *SIL, "--log", "b.mcap"), "outcome"),
        pytest.param(
            *(("law", "fly", LAW, *SIL, "--duration", "2", "--log", "c.mcap"), "trial"),
            marks=pytest.mark.slow,
        ),
    ],
    ids=lambda value: value if isinstance(value, str) else " ".join(value[:2]),
)
def test_a_result_on_standard_output_is_json_alone(
    words: tuple[str, ...], key: str, terminal: Terminal
) -> None:
    Path("short.toml").write_text('[[segment]]\nkind = "hold"\nduration_s = 1\n')
    result = terminal(*words, "--json", "-")
    assert result.code == 0, result.err
    content: dict[str, Any] = json.loads(result.out)
    assert content["schema"] == 1
    assert key in content
    if words[:2] == ("law", "fly"):
        assert (content["outcome"], content["law"]) == ("completed", "lqr")
        assert content["trial"]["taken_over"] == ""


def test_a_result_in_a_file_leaves_the_text_where_it_was(terminal: Terminal) -> None:
    result = terminal("rig", "check", "makki2024", "--json", "new/rigs.json")
    assert "makki2024: " in result.out
    assert json.loads(Path("new/rigs.json").read_text())["rigs"][0]["can_fly"]


def test_the_old_names_of_record_and_dashboard_work_and_are_not_listed(terminal: Terminal) -> None:
    assert terminal("log", *SIL, "--duration", "0.2", "-o", "a.mcap").code == 0
    assert terminal("page", "--help").code == 0
    listed = terminal("--help").out
    assert "record" in listed and "dashboard" in listed
    assert not [line for line in listed.splitlines() if line.strip("│ ").startswith(("log ", "page "))]


def tree(pid: int) -> Iterator[int]:
    """A process and all that it started."""
    yield pid
    with suppress(FileNotFoundError, ProcessLookupError):
        for task in (_PROC / str(pid) / "task").iterdir():
            for child in (task / "children").read_text().split():
                yield from tree(int(child))


def listeners(pid: int) -> set[tuple[IPv4Address | IPv6Address, int]]:
    """Addresses and ports at which a process, or one that it started, takes what comes."""
    sockets = {name for process in tree(pid) for name in _sockets(process)}
    matches = set()
    for table, state in _TABLES.items():
        for line in (_PROC / "net" / table).read_text().splitlines()[1:]:
            fields = line.split()
            if fields[3] == state and f"socket:[{fields[9]}]" in sockets:
                matches.add(_address(fields[1]))
    return matches


def _sockets(pid: int) -> Iterator[str]:
    with suppress(FileNotFoundError, ProcessLookupError):
        for file in (_PROC / str(pid) / "fd").iterdir():
            with suppress(FileNotFoundError):
                yield str(file.readlink())


def _address(text: str) -> tuple[IPv4Address | IPv6Address, int]:
    address, _, port = text.partition(":")
    words = [address[place : place + 8] for place in range(0, len(address), 8)]
    # Each word of the address is in the machine's order, which is little-endian here.
    packed = b"".join(int(word, 16).to_bytes(4, "little") for word in words)
    return ip_address(socket.inet_ntop(socket.AF_INET if len(words) == 1 else socket.AF_INET6, packed)), int(
        port, 16
    )


@dataclass(frozen=True)
class Started:
    """A command that goes on until it is ended."""

    arguments: tuple[str, ...]  # Words behind ``heli-host``
    ready: str  # A file or a word of its output that shows that all of it runs
    count: int  # Places at which it listens


STARTED = {
    "dashboard": Started(("dashboard", "--sil", "--twin", "makki2024"), "programs join", 1),
    "sil over TCP": Started(("sil", "--tcp", ":0"), "socket://127.0.0.1", 1),
    "sil over RFC 2217": Started(("sil", "--rfc2217", "127.0.0.1:0"), "rfc2217://127.0.0.1", 1),
    "sil behind a terminal": Started(("sil", "--pty", "./due"), "Ctrl-C ends it", 0),
    "campaign": Started(("campaign", "campaign.toml", "--output", "out"), "began.txt", 2),
    "fly": Started(("fly", "hover", "--sil", "--twin", "makki2024", "--log", "f.mcap"), "f.mcap", 0),
    "record": Started(("record", "--sil", "--duration", "600", "--output", "g.mcap"), "g.mcap", 0),
}


@contextmanager
def running(folder: Path, started: Started) -> Iterator[subprocess.Popen[bytes]]:
    """Run a command until the block ends, from the moment on when all of it runs."""
    output = folder / "output.txt"
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parents[2])}
    with output.open("wb") as file:
        process = subprocess.Popen(
            command(*started.arguments),
            cwd=folder,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=file,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
    try:
        end_s = time.monotonic() + PATIENCE_S
        while started.ready not in output.read_text() and not (folder / started.ready).exists():
            assert process.poll() is None and time.monotonic() < end_s, output.read_text()
            time.sleep(0.02)
        assert process.poll() is None, output.read_text()
        yield process
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="skipped: reads Linux's tables of sockets")
@pytest.mark.parametrize("name", STARTED)
def test_no_verb_listens_beyond_loopback(tmp_path: Path, name: str) -> None:
    (tmp_path / "campaign.toml").write_text(CAMPAIGN)
    with running(tmp_path, STARTED[name]) as process:
        addresses = listeners(process.pid)
    assert len(addresses) == STARTED[name].count, addresses
    assert all(address.is_loopback for address, _ in addresses), addresses


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="skipped: reads Linux's tables of sockets")
def test_every_verb_is_run_here_or_serves_nobody() -> None:
    assert ENDED | {started.arguments[0] for started in STARTED.values()} == set(installed_verbs())


def test_a_flight_and_its_checks_import_no_library_of_analyses(tmp_path: Path) -> None:
    (tmp_path / "short.toml").write_text(SHORT)
    process = subprocess.run(
        [sys.executable, "-c", FLY], cwd=tmp_path, capture_output=True, text=True, check=False
    )
    assert process.returncode == 0, process.stderr


@dataclass(frozen=True)
class Light:
    """Options of a verb that shines."""

    colour: Annotated[str, typer.Option("--colour")] = "white"
    watts: Annotated[float, typer.Option("--power")] = 5.0
    lumens: float = 400.0


def printed(*words: str, without: tuple[str, ...] = ()) -> str:
    """Return what a verb with the group printed, or its error."""
    app = typer.Typer()

    @app.command()
    @with_option_groups(without=without)
    def shine(lamp: str, *, light: Light, minutes: Annotated[int, typer.Option("--for")] = 1) -> None:
        """Shine."""
        print(lamp, light, minutes)

    return CliRunner().invoke(app, words).output


def test_fields_are_options_of_the_verb_and_the_others_keep_their_defaults() -> None:
    assert printed("desk") == "desk Light(colour='white', watts=5.0, lumens=400.0) 1\n"
    given = printed("desk", "--power", "7", "--for", "3", "--colour", "red")
    assert given == "desk Light(colour='red', watts=7.0, lumens=400.0) 3\n"
    assert "No such option" in printed("desk", "--lumens", "3")


def test_a_verb_leaves_options_out() -> None:
    assert printed("desk", without=("colour",)) == "desk Light(colour='white', watts=5.0, lumens=400.0) 1\n"
    assert "No such option" in printed("desk", "--colour", "red", without=("colour",))


def test_a_law_flies_with_every_option_of_a_flight(terminal: Terminal) -> None:
    fly, law = (
        set(re.findall(r"^│\W*(--[a-z-]+)", terminal(*words, "--help").out, re.MULTILINE))
        for words in (("fly",), ("law", "fly"))
    )
    assert {"--foxglove", "--twin", "--seed", "--log"} <= fly
    assert fly - law == {"--again"}


def install(folder: Path, package: str, modules: dict[str, str]) -> None:
    """Write a package and the files of its installer into a folder."""
    (folder / package).mkdir()
    for name, text in {"__init__": "", **modules}.items():
        (folder / package / f"{name}.py").write_text(text)
    metadata_folder = folder / f"{package}-1.0.dist-info"
    metadata_folder.mkdir()
    (metadata_folder / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n")
    (metadata_folder / "entry_points.txt").write_text(f"[heli_host.verbs]\nown = {package}\n")


def run(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    program = "import sys; from heli_host.ui.cli import main; main()"
    environment = {**os.environ, "PYTHONPATH": str(folder), "NO_COLOR": "1", "COLUMNS": "100"}
    return subprocess.run(
        [sys.executable, "-c", program, *arguments],
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.slow
def test_a_package_of_ones_own_adds_a_verb(tmp_path: Path) -> None:
    install(tmp_path, "own_verbs", {"greet": GREET})
    done = run(tmp_path, "greet", "Ada")
    assert (done.returncode, done.stdout, done.stderr) == (0, "good day, Ada\n", "")


@pytest.mark.slow
def test_a_broken_package_is_one_line_and_takes_no_verb_with_it(tmp_path: Path) -> None:
    install(tmp_path, "own_verbs", {"greet": GREET})
    install(tmp_path, "broken_verbs", {"worse": "1 / 0"})
    done = run(tmp_path, "--help")
    assert done.returncode == 0
    listed = [words[1] for line in done.stdout.splitlines() if len(words := line.split()) > 1]
    assert {"greet", "fly", "doctor", "sil", "diagnose"} <= set(listed)
    (warning,) = done.stderr.splitlines()
    assert warning.startswith("warning: the verbs of broken_verbs do not load (ZeroDivisionError")


@pytest.mark.slow
def test_a_verb_that_exists_is_not_replaced(tmp_path: Path) -> None:
    install(tmp_path, "own_verbs", {"ports": GREET.replace("greet", "ports")})
    done = run(tmp_path, "ports", "Ada")
    assert "good day" not in done.stdout
    assert done.stderr.splitlines()[0] == "warning: own_verbs has another verb 'ports'; left out"
