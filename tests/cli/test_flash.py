"""``heli-host flash``: the real path, a stand-in for ``bossac``, and a simulated board behind a real port."""

import os
import shutil
import struct
import termios
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import heli_host
import pytest
import serial
from heli_host.board.flashing import (
    ERASE_S,
    ERASING_BAUD,
    FLASH_START,
    RAM_START,
    VECTORS,
    erase_chip,
    find_bossac,
    read_image,
    restart_chip,
    write_image,
)
from heli_host.board.parameters import read_parameter_set
from heli_host.declaration import BAUD, LINK_HASH, PARAMS_HASH, ParamsSource, State
from heli_host.errors import FlashError, ImageError, UploaderError
from heli_host.ui.cli.verbs import board as flash_verb
from heli_host.ui.cli.verbs.board import ANSWER_TIMEOUT_S
from heli_sim.sil.transport import SilProcess
from hypothesis import example, given
from hypothesis import strategies as st
from serial.tools import list_ports

from tests.cli.terminal import Ended, Terminal, refusal
from tests.cli.uploader import Uploader
from tests.sil.harness import PATIENT

ASKED, LINK, FILE = 2, 3, 5
ENTRY = FLASH_START + 4 * VECTORS + 1
pytestmark = pytest.mark.skipif(not hasattr(os, "openpty"), reason="no pseudo-terminals on this system")


def image_bytes(stack: int = RAM_START + 0xC00, entry: int = ENTRY, link_hash: int = LINK_HASH) -> bytes:
    """The least that is an image of ours."""
    vectors = struct.pack(f"<{VECTORS}I", stack, *[entry] * (VECTORS - 1))
    return vectors + struct.pack("<3I", 0xE7FEE7FE, link_hash, 0)


@pytest.fixture
def image(tmp_path: Path) -> Path:
    path = tmp_path / "firmware.bin"
    path.write_bytes(image_bytes())
    return path


@pytest.fixture
def board() -> Iterator[SilProcess]:
    with SilProcess(speed=None) as process:
        yield process


@pytest.fixture
def silent_port() -> Iterator[str]:
    """A port behind which nobody answers."""
    ours, theirs = os.openpty()
    yield os.ttyname(theirs)
    os.close(ours)
    os.close(theirs)


@pytest.fixture(autouse=True)
def quick_and_alone(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """No wait for a chip that is not there, and no uploader of this machine."""
    monkeypatch.setattr(erase_chip, "__defaults__", (0.0,))
    monkeypatch.setattr(flash_verb, "ANSWER_TIMEOUT_S", 0.3)
    monkeypatch.setenv("PATH", str(tmp_path / "empty"))
    monkeypatch.setenv("HOME", str(tmp_path / "home"))


class Flash:
    """Runs ``heli-host flash IMAGE --port PORT --yes`` with an uploader of its own."""

    def __init__(self, terminal: Terminal, image: Path, port: str, folder: Path) -> None:
        self.terminal, self.image, self.port, self.folder = terminal, image, port, folder
        self.calls: list[list[str]] = []

    def __call__(self, *more: str, ending: str = "good", version: str = "1.7.0", yes: bool = True) -> Ended:
        uploader = Uploader(self.folder, ending, version)
        options = ("--port", self.port, "--bossac", uploader.program, *(("--yes",) if yes else ()), *more)
        ended = self.terminal("flash", self.image, *options)
        self.calls = uploader.calls
        return ended


@pytest.fixture
def flash(terminal: Terminal, image: Path, silent_port: str, tmp_path: Path) -> Flash:
    """Flash a board that does not answer."""
    return Flash(terminal, image, silent_port, tmp_path / "bin")


@pytest.fixture
def flash_board(
    terminal: Terminal, image: Path, board: SilProcess, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Flash:
    """Flash a simulated board, which answers before and afterwards."""
    monkeypatch.setattr(flash_verb, "ANSWER_TIMEOUT_S", ANSWER_TIMEOUT_S)
    return Flash(terminal, image, board.url, tmp_path / "bin")


def on_path(monkeypatch: pytest.MonkeyPatch, uploader: Uploader) -> None:
    monkeypatch.setenv("PATH", str(uploader.folder))


@pytest.mark.medium
def test_a_board_is_flashed_and_answers(
    terminal: Terminal, image: Path, flash_board: Flash, monkeypatch: pytest.MonkeyPatch
) -> None:
    uploader = Uploader(flash_board.folder)
    on_path(monkeypatch, uploader)
    result = terminal("flash", image, "--port", flash_board.port, "--yes")
    assert result.code == 0, result
    device = os.path.realpath(flash_board.port).removeprefix("/dev/")
    options = ["--force_usb_port=false", "--erase", "--write", "--verify", "--boot=1", "--reset"]
    assert uploader.calls == [[f"--port={device}", *options, str(image)]]
    assert "flashed: simulated board, firmware 0.1.0" in result.out
    assert "nothing to keep" in result.out


@pytest.fixture
def changed(terminal: Terminal, board: SilProcess) -> None:
    """The board has saved parameters that are not the defaults."""
    assert terminal("params", "set", "hover_V", "1.25", "--save", "--port", board.url).code == 0


@pytest.fixture
def other_link(monkeypatch: pytest.MonkeyPatch) -> None:
    """This host was built from another declaration of the link than the board."""
    monkeypatch.setattr("heli_host.link.engine.LINK_HASH", LINK_HASH ^ 1)


@pytest.mark.slow
def test_parameters_that_were_changed_are_kept_in_a_file_that_restores_them(
    changed: None, terminal: Terminal, flash_board: Flash, tmp_path: Path
) -> None:
    result, port = flash_board(), flash_board.port
    assert result.code == 0, result
    [kept] = tmp_path.glob("parameters-*.toml")
    assert f"params restore {kept.name} --save --port {port}" in result.out
    # The flash of the simulated board is not erased; a changed value shows that the file has the old one.
    assert terminal("params", "set", "hover_V", "1.75", "--port", port).code == 0
    assert terminal("params", "restore", kept, "--port", port).code == 0
    assert terminal("params", "get", "hover_V", "--port", port).out.strip() == "1.25"


@pytest.mark.slow
def test_parameters_of_a_board_with_another_link_version_are_kept(
    changed: None, other_link: None, flash_board: Flash, tmp_path: Path
) -> None:
    result = flash_board()
    [kept] = tmp_path.glob("parameters-*.toml")
    assert read_parameter_set(kept).values["hover_V"] == 1.25
    assert len(flash_board.calls) == 1
    # The simulated board is not really flashed, so that it still has the other link version.
    assert "has link version" in refusal(result, code=LINK)


@pytest.mark.slow
def test_a_board_with_another_link_version_and_no_saved_parameters_is_flashed(
    other_link: None, flash_board: Flash
) -> None:
    assert "nothing to keep" in flash_board().out
    assert len(flash_board.calls) == 1


@pytest.mark.slow
def test_saved_parameters_of_another_schema_are_erased_only_on_demand(
    changed: None, other_link: None, flash_board: Flash, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("heli_host.board.flashing.PARAMS_HASH", PARAMS_HASH ^ 1)
    line = refusal(flash_board(), code=LINK)
    assert f"{PARAMS_HASH:08x}" in line and "params dump" in line
    assert flash_board.calls == []
    assert "discarded: " in flash_board("--discard-parameters").out
    assert len(flash_board.calls) == 1


@pytest.mark.slow
def test_saved_parameters_in_another_order_are_erased_only_on_demand(
    changed: None, other_link: None, flash_board: Flash, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Every stored set counts as migrated.
    sources = SimpleNamespace(MIGRATED=ParamsSource.STORED)
    monkeypatch.setattr("heli_host.board.flashing.ParamsSource", sources)
    line = refusal(flash_board(), code=LINK)
    assert f"under this host's schema {PARAMS_HASH:08x}" in line
    assert flash_board.calls == []


@pytest.mark.medium
def test_nothing_is_erased_before_somebody_agreed(flash: Flash, monkeypatch: pytest.MonkeyPatch) -> None:
    assert "--yes" in refusal(flash(yes=False), code=ASKED)
    assert flash.calls == []
    ours, theirs = os.openpty()
    os.write(ours, b"n\n")
    with os.fdopen(theirs) as keyboard:
        monkeypatch.setattr("sys.stdin", keyboard)
        result = flash(yes=False)
    os.close(ours)
    assert "erases the whole flash" in result.out
    assert result.code == 130
    assert flash.calls == []


@pytest.mark.medium
def test_a_board_without_this_firmware_is_flashed_and_its_silence_is_an_error(flash: Flash) -> None:
    result = flash()
    assert "no parameters could be read" in result.out
    assert len(flash.calls) == 1
    line = refusal(result, code=LINK)
    assert "written and verified, but the board does not answer" in line and "RESET" in line


def test_the_rate_that_erases_is_left_again_before_the_next_program_opens_the_port(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ours, theirs = os.openpty()
    output_speed = 5  # its place in the list of tcgetattr
    rates: list[int] = []
    monkeypatch.setattr(time, "sleep", lambda _s: rates.append(termios.tcgetattr(theirs)[output_speed]))
    try:
        erase_chip(os.ttyname(theirs), wait_s=1.0)
        assert rates == [termios.B1200]
        assert termios.tcgetattr(theirs)[output_speed] != termios.B1200
    finally:
        os.close(ours)
        os.close(theirs)


def test_the_touch_erases_an_emulated_board_once_and_leaves_its_loader_running() -> None:
    pytest.importorskip("due_emulator._due")
    from due_chip import Chip

    def touched(rate_afterwards: int) -> Chip:
        chip = Chip()
        chip.due.usb_line_coding(ERASING_BAUD)
        chip.due.usb_control_lines(False)
        chip.due.run_us(round(ERASE_S * 1e6))
        chip.due.usb_line_coding(rate_afterwards)
        # The uploader opens the port, and waits half a second for the reset to pass.
        chip.due.usb_control_lines(True)
        chip.due.run_us(500_000)
        return chip

    chip = touched(BAUD)
    assert set(chip.due.flash()) == {0xFF}
    assert chip.due.in_rom
    assert chip.due.resets == 3  # power-up, the touch, the opening
    # Left at 1200 baud the board would still be in its second erasing.
    assert touched(ERASING_BAUD).due.resets == 2


def test_a_restart_pulses_DTR_at_a_rate_that_erases_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    lines: list[tuple[int, bool]] = []

    def note(port: serial.Serial, high: bool) -> None:
        lines.append((port.baudrate, high))

    monkeypatch.setattr(serial.Serial, "dtr", property(fset=note))
    ours, theirs = os.openpty()
    try:
        restart_chip(os.ttyname(theirs))
    finally:
        os.close(ours)
        os.close(theirs)
    assert lines == [(BAUD, False), (BAUD, True)]


@pytest.mark.medium
@pytest.mark.parametrize(
    ("ending", "says"),
    [
        ("no device", "ERASE button"),
        ("verify", "17 bytes differ"),
        ("options", "does not know the options"),
        ("io", "SAM-BA operation failed"),
        ("crash", "crashed"),
    ],
)
def test_each_way_in_which_the_uploader_fails_has_its_remedy(flash: Flash, ending: str, says: str) -> None:
    assert says in refusal(flash(ending=ending), code=LINK)
    assert len(flash.calls) == 1


@pytest.mark.medium
def test_an_uploader_that_hangs_is_ended(image: Path, tmp_path: Path) -> None:
    hanging = find_bossac(Uploader(tmp_path / "bin", "hang").program)
    with pytest.raises(FlashError, match="did not end within"):
        write_image(hanging, "/dev/ttyACM0", image, timeout_s=0.5)


@pytest.mark.medium
def test_a_version_that_is_reported_not_to_boot_is_named_before_and_after(flash: Flash) -> None:
    result = flash(version="1.9.1")
    assert "1.9.1 is reported" in result.out
    assert "1.7.0" in refusal(result, code=LINK)
    assert "--usb-port=0" in flash.calls[0] and "--reset" not in flash.calls[0]


@pytest.mark.medium
def test_a_busy_port_is_named_and_nothing_erased(flash: Flash) -> None:
    with serial.Serial(flash.port, exclusive=True):
        result = flash()
    assert "in use by another program" in refusal(result, code=LINK)
    assert flash.calls == []


@pytest.mark.medium
def test_a_missing_uploader_says_how_to_get_it(terminal: Terminal, image: Path, silent_port: str) -> None:
    line = refusal(terminal("flash", image, "--port", silent_port, "--yes"), code=ASKED)
    assert "not installed" in line and "tool-bossac" in line


@pytest.mark.medium
@pytest.mark.parametrize("port", ["socket://127.0.0.1:5000", "sil://"])
def test_only_a_port_of_this_computer_can_be_flashed(flash: Flash, port: str) -> None:
    flash.port = port
    assert "port of this computer" in refusal(flash(), code=ASKED)


@pytest.mark.medium
def test_flash_without_a_port_erases_nothing(
    terminal: Terminal, image: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(list_ports, "comports", list)
    result = terminal("flash", image, "--yes", "--bossac", Uploader(tmp_path / "bin").program)
    line = refusal(result, code=LINK)
    assert "no board is named, and no Due is plugged in; add --port PORT" in line and "--sil" not in line


@pytest.mark.medium
@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"\x7fELF" + image_bytes(), "ELF"),
        (b":020000040008F2\n" * 40, "Intel HEX"),
        (b"", "0 bytes"),
        (image_bytes()[:200], "200 bytes"),
        (image_bytes() + bytes(512 * 1024), "bytes"),
        (b"\xff" * 4096, "its stack is at 0xffffffff"),
        (image_bytes(stack=0x2008_9000), "its stack is at 0x20089000"),
        (image_bytes(entry=ENTRY - 1), "entry"),
        (image_bytes(entry=0x0010_0001), "entry"),
        (image_bytes(link_hash=LINK_HASH ^ 1), f"{LINK_HASH:08x}"),
    ],
    ids=["elf", "hex", "empty", "short", "long", "erased", "stack", "arm", "elsewhere", "hash"],
)
def test_a_file_that_is_no_firmware_of_ours_erases_nothing(flash: Flash, content: bytes, says: str) -> None:
    flash.image.write_bytes(content)
    assert says in refusal(flash(), code=ASKED)
    assert flash.calls == []


@pytest.mark.medium
@given(st.binary(max_size=2048))
@example(bytes(4 * VECTORS - 1))
@example(struct.pack("<I", RAM_START + 1024))
@example(struct.pack("<II", RAM_START + 1024, FLASH_START + 1))
@example(struct.pack("<II", RAM_START + 1024, FLASH_START + 1) + bytes(4 * (VECTORS - 2) - 1))
def test_no_bytes_crash_the_check_of_an_image(
    tmp_path_factory: pytest.TempPathFactory, content: bytes
) -> None:
    path = tmp_path_factory.mktemp("image") / "any.bin"
    path.write_bytes(content)
    with pytest.raises(ImageError):
        read_image(path)


@pytest.mark.medium
def test_an_uploader_that_is_trusted_comes_before_the_one_on_the_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    on_path(monkeypatch, Uploader(tmp_path / "bin", version="1.9.1"))
    assert find_bossac().version == "1.9.1"
    package = Uploader(tmp_path / "home/.platformio/packages/tool-bossac", version="1.7.0")
    assert find_bossac().path == str(package.program)


def test_a_program_that_is_no_bossac_is_refused(tmp_path: Path) -> None:
    program = tmp_path / "bossac"
    with pytest.raises(UploaderError, match="does not run"):
        find_bossac(program)
    program.write_text("#!/bin/sh\necho hello\n")
    program.chmod(0o755)
    with pytest.raises(UploaderError, match="is not bossac"):
        find_bossac(program)


def test_the_real_uploader_takes_these_options_as_far_as_the_missing_board(
    image: Path, silent_port: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", os.defpath)
    path = shutil.which("bossac", path=os.defpath + ":/usr/bin")
    if path is None:
        pytest.skip("bossac is not installed; on Debian: apt-get install bossa-cli")
    with pytest.raises(FlashError, match="loader does not answer"):
        write_image(find_bossac(Path(path)), silent_port, image)


@pytest.mark.slow
def test_a_board_that_flies_is_neither_flashed_nor_landed(flash_board: Flash) -> None:
    heli = heli_host.connect(flash_board.port)
    heli.params.restore(PATIENT)
    heli.take_off()
    # Ends the session but not the flight: the board holds level for a while.
    heli.session.close()
    result = flash_board()
    with heli_host.connect(flash_board.port, land_on_exit=False) as again:
        assert again.state in (State.CLOSED_LOOP, State.HOLD)
    assert "land first, or stop the motors" in refusal(result, code=LINK)
    assert flash_board.calls == []
