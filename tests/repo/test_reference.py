"""Pages of the reference agree with the code: glossary, faults, hardware, and what is generated."""

import importlib.util
import os
import pty
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tomllib
from pathlib import Path
from types import ModuleType

import heli_host
import pytest
from heli_host.board.flashing import Bossac
from heli_host.ui.cli import run
from heli_sim.rig import load_rig, write_rig

from tests.cli.terminal import Process, command
from tests.repo.test_documents import ROOT, blocks, verbs
from tests.sil.harness import PATIENT

TEXT = (ROOT / "docs" / "reference" / "glossary.md").read_text()
PACKAGES = {"heli_host": "host", "heli_sim": "sim", "heli_lab": "sim", "heli_benchmark": "sim"}
CELLS = [
    [cell.strip() for cell in line.split("|")[1:-1]] for line in TEXT.splitlines() if line.startswith("| ")
]
ROWS = {cells[0]: (cells[3], cells[4]) for cells in CELLS if len(cells) == 5 and cells[0] != "term"}
REFERENCES = set(re.findall(r"^- \[([^]]+)\]", TEXT, re.MULTILINE))


@pytest.mark.parametrize("term", ROWS)
def test_term_leads_to_the_code_and_to_a_reference(term: str) -> None:
    where, references = ROWS[term]
    path, _, name = where.strip("`").partition(":")
    package = path.partition("/")[0]
    file = ROOT / PACKAGES[package] / path if package in PACKAGES else ROOT / path
    assert file.is_file(), f"{term}: there is no {path}"
    defined = rf"^(?:class|def) {name}\b|^{name}(?::| =)"
    assert not name or re.search(defined, file.read_text(), re.MULTILINE), f"{term}: {path} defines no {name}"
    assert set(re.findall(r"\[([^]]+)\]", references)) <= REFERENCES


DOCS = ROOT / "docs"
PARAMETERS = {param["name"] for param in tomllib.loads((ROOT / "firmware/link.toml").read_text())["param"]}


def section(page: str, heading: str) -> str:
    """The text of one section of a page."""
    text = (DOCS / page).read_text()
    return text.partition(f"\n## {heading}\n")[2].partition("\n## ")[0]


def test_troubleshooting_names_parameters_that_the_board_has() -> None:
    text = section("how-to/troubleshooting.md", "Signs, scales and supply")
    given = set(re.findall(r"`(\w+_(?:per_rev|sign|V|deg))`", text))
    assert given
    assert given <= PARAMETERS


PINS = ROOT / "firmware/pins.toml"
CHECKLIST = DOCS / "how-to/first-power-up.md"
# Programs of others whose options no test here can know.
OTHERS = {"cd", "cp", "git", "make", "sudo", "source", "stty", "pio", "bossac"}
# Verbs of the checklist that look at this computer, or need the board's own flash.
NOT_SIMULATED = {"doctor", "ports", "flash", "sil"}
# The rig of the bench steps: in the checklist the arm is tied, here it moves through tar.
TIED = "tied.toml"
FALL_s = 1.5
"""Time in which the arm, with the drivers off, has come to rest on the table."""
# A row of the table of rehearsals: input at the board, command, end of the flight.
REHEARSAL = re.compile(r"^\| `([a-z ]+)` \| `heli-host (.+)` \| `(.+)` \|$", re.MULTILINE)


def wiring() -> ModuleType:
    """The program that draws the diagram."""
    spec = importlib.util.spec_from_file_location("wiring", DOCS / "figures/wiring.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["wiring"] = module
    spec.loader.exec_module(module)
    return module


def constants() -> dict[str, tuple[str, str]]:
    """Pins in the headers of the firmware: printed name and chip's name, by axis and line or by constant."""
    source = "".join((ROOT / "firmware/due" / name).read_text() for name in ("wiring.hpp", "pins.hpp"))
    pattern = re.compile(r"Pin k(\w+)\{PIO([A-D]), (\d+)\};\s*// (D\d+)")
    axes = dict(re.findall(r"k(\w+)Axis = k(\w+);", source))
    return {
        re.sub(r"^(Tc0|Tc2|Interrupt)(?=[AB]$)", lambda name: axes[name[1]], match[1]): (
            match[4],
            f"P{match[2]}{match[3]}",
        )
        for match in pattern.finditer(source)
    }


def table() -> dict[str, tuple[str, str]]:
    """Pins of the wiring table."""
    row = re.compile(r"^\| `(\w+)` \| (\w+) \| (\w+) \|", re.MULTILINE)
    return {match[1]: (match[2], match[3]) for match in row.finditer((DOCS / "how-to/wiring.md").read_text())}


def test_the_wiring_table_is_the_firmwares_pins() -> None:
    assert table() == constants()
    assert len(table()) == 17


def test_no_pin_is_used_twice_or_together_with_its_shorted_twin() -> None:
    printed = [due for due, _ in table().values()]
    chips = [chip for _, chip in table().values()]
    assert len(set(printed)) == len(printed)
    assert len(set(chips)) == len(chips)
    # D4 and D10 have a second pin of the chip; D10 and A6 are the decoders' index inputs.
    assert not {"PA28", "PA29", "PC29", "PA3"} & set(chips)


@pytest.mark.medium
def test_the_wiring_diagram_is_the_firmwares_pins(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["wiring.py", str(tmp_path / "wiring.svg")])
    wiring().main()

    def texts(path: Path) -> list[str]:
        return re.findall(r"<text[^>]*>([^<]*)</text>", path.read_text())

    drawn = texts(DOCS / "figures/wiring.svg")
    # Coordinates may differ between versions of matplotlib; what is written may not.
    assert drawn == texts(tmp_path / "wiring.svg")
    for due, chip in constants().values():
        assert any(due in re.findall(r"\w+", text) for text in drawn), (due, chip)


def test_the_stop_is_documented_as_the_firmware_reads_it() -> None:
    assert "kStopIsHigh = true" in (ROOT / "firmware/due/wiring.hpp").read_text()
    assert "normally closed" in (DOCS / "how-to/wiring.md").read_text()


@pytest.mark.parametrize(
    ("version", "option"), [("1.7.0", "--force_usb_port=false"), ("1.9.1", "--usb-port=0")]
)
def test_bossac_by_hand_is_what_flash_does(version: str, option: str) -> None:
    image = Path("build/pio/due/firmware.bin")
    ours = Bossac("bossac", version, (option,)).arguments("/dev/ttyACM0-of-no-machine", image)
    ours[1] = "--port=ttyACM0"
    commands = [command for block in blocks(DOCS / "how-to/flashing.md") for command in block.commands]
    assert ours in commands


def test_every_program_in_these_documents_is_known() -> None:
    for path in (ROOT / "README.md", DOCS / "how-to/wiring.md", DOCS / "how-to/flashing.md", CHECKLIST):
        for block in blocks(path):
            if block.language == "console":
                for command in block.commands:
                    assert Path(command[0]).name in OTHERS | {"heli-host"}, f"{path.name}: {command[0]}"


@pytest.mark.slow
def test_the_checklist_works_from_top_to_bottom_on_a_simulated_board(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    write_rig(load_rig("makki2024").replace(friction_elevation=50.0, friction_pitch=50.0), TIED)
    for block in blocks(CHECKLIST):
        if block.language == "python":
            exec(block.text, {})
            continue
        for program, *words in block.commands:
            if program == "heli-host" and words[0] not in NOT_SIMULATED:
                code = run(simulated(words))
                assert code == 0, f"heli-host {shlex.join(words)}: {capsys.readouterr().err}"


def simulated(words: list[str]) -> list[str]:
    """The same command for a simulated board, as fast as it goes."""
    if words[0] == "tune":
        # It takes long, and docs/how-to/tuning.md has it run; parameters are parameters.
        return ["params", "dump", words[words.index("--save-params") + 1], "--sil"]
    verb = verbs()[words[0]]
    verb = getattr(verb, "commands", {}).get(words[1], verb)
    options = {name for parameter in getattr(verb, "params", []) for name in parameter.opts}
    return [
        *words,
        *(("--rig", TIED) if words[0] == "motors" else ()),
        *(("--sil",) if "--sil" in options else ()),
        *(("--speed", "max") if "--speed" in options else ()),
    ]


@pytest.mark.slow
def test_what_is_to_be_rehearsed_ends_as_the_checklist_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    rows = REHEARSAL.findall(CHECKLIST.read_text())
    assert len(rows) == 5
    [served] = [words for block in blocks(CHECKLIST) for words in block.commands if words[1] == "sil"]
    keyboard, stdin = pty.openpty()
    with Process(
        command(*served[1:]), cwd=tmp_path, stdin=stdin, stdout=subprocess.PIPE, text=True
    ) as server:
        assert server.stdout is not None
        assert "Ctrl-C ends it" in server.stdout.readline()
        server.stdout.readline()
        with heli_host.connect(str(tmp_path / "due")) as heli:
            heli.params.restore(PATIENT)
        for typed, given, end in rows:
            if typed.startswith("plug"):
                # An encoder that is plugged in while the arm falls knows a part of the way only.
                with heli_host.connect(str(tmp_path / "due")) as heli:
                    heli.wait(FALL_s)
                for hand in ("turn elevation -25", "let elevation"):
                    os.write(keyboard, f"{hand}\n".encode())
                    server.stdout.readline()
                    with heli_host.connect(str(tmp_path / "due")) as heli:
                        heli.wait(FALL_s)
            os.write(keyboard, f"{typed}\n".encode())
            server.stdout.readline()
            run(shlex.split(given))
            assert end in "".join(capsys.readouterr()), given
        server.send_signal(signal.SIGINT)
        server.communicate(timeout=60)
    os.close(keyboard)
    os.close(stdin)


SOURCE = "firmware/link.toml"
GENERATED = (
    "firmware/core/link/declaration.hpp",
    "host/heli_host/declaration.py",
    "docs/reference/link.md",
    "docs/reference/faults.md",
    "docs/reference/parameters.md",
    "docs/matlab/heli_declaration.m",
    "sim/web/heli_web/page/declaration.js",
)


def check(root: Path) -> int:
    command = [sys.executable, str(ROOT / "firmware/generate.py"), "--check", "--root", str(root)]
    return subprocess.run(command, capture_output=True, check=False).returncode


@pytest.fixture
def copy_of_tree(tmp_path: Path) -> Path:
    for name in (*GENERATED, SOURCE):
        target = tmp_path / name
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, target)
    return tmp_path


@pytest.mark.medium
def test_generated_files_are_fresh() -> None:
    assert check(ROOT) == 0, "run: python firmware/generate.py"


@pytest.mark.medium
@pytest.mark.parametrize("name", GENERATED)
def test_an_edited_generated_file_is_noticed(copy_of_tree: Path, name: str) -> None:
    path = copy_of_tree / name
    path.write_text(path.read_text().replace("elevation", "altitude", 1))
    assert check(copy_of_tree) == 1


@pytest.mark.medium
def test_a_changed_declaration_is_noticed(copy_of_tree: Path) -> None:
    path = copy_of_tree / SOURCE
    path.write_text(path.read_text().replace("default = 1.4", "default = 1.5", 1))
    assert check(copy_of_tree) == 1


@pytest.mark.medium
def test_a_copy_is_as_fresh_as_the_tree(copy_of_tree: Path) -> None:
    assert check(copy_of_tree) == 0


@pytest.mark.medium
@pytest.mark.parametrize("name", GENERATED)
def test_a_missing_generated_file_is_written_again(copy_of_tree: Path, name: str) -> None:
    (copy_of_tree / name).unlink()
    assert check(copy_of_tree) == 1
    command = [sys.executable, str(ROOT / "firmware/generate.py"), "--root", str(copy_of_tree)]
    output = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert output == f"{name}: written\n"
    assert (copy_of_tree / name).read_text() == (ROOT / name).read_text()
