"""``python -m due_emulator``, the GDB server, and what can be measured."""

import shutil
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest
from due_chip import Build
from due_emulator import Due, Image, ImageError, new_due, read_image, report_of
from due_emulator.gdb import GdbServer, packet

pytestmark = pytest.mark.emulated

SYSTICK = 15
"""Number of the exception."""
GUARD_S = 120.0
"""How long a failing test waits."""
GDB = shutil.which("gdb-multiarch") or shutil.which("arm-none-eabi-gdb")


@pytest.fixture(scope="module")
def program(build: Build) -> Path:
    return build("hello.c", "-O1")


@pytest.fixture
def image(program: Path) -> Image:
    return read_image(program)


def running(image: Image, us: float = 20_000) -> Due:
    due = new_due(image)
    due.usb_line_coding(250_000)
    due.power_on()
    due.run_us(us)
    return due


def command(*arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "due_emulator", *arguments],
        capture_output=True,
        text=True,
        check=False,
        timeout=GUARD_S,
    )


def test_uart_goes_to_stdout_and_the_exit_code_is_0(program: Path) -> None:
    result = command(str(program), "--seconds", "0.02")
    assert (result.returncode, result.stdout, result.stderr) == (0, "hello\n", "")


def test_the_report_names_fault_and_function(image: Image) -> None:
    due = running(image)
    due.stop_at_hardfault(True)
    due.poke(image.address("trouble"), struct.pack("<I", 1))
    due.run_us(5_000)
    assert due.halt == "hardfault"
    text = str(report_of(due))
    assert "fault: UNDEFINSTR" in text
    assert "in main()+" in text


@pytest.mark.parametrize(
    ("content", "message"),
    [(None, "No such file"), (b"\x7fELF....", "not a readable ELF file"), (b"", "contains nothing to load")],
)
def test_a_wrong_file_is_one_line_and_code_2(tmp_path: Path, content: bytes | None, message: str) -> None:
    path = tmp_path / "x.elf"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(ImageError, match=message):
        read_image(path)
    result = command(str(path))
    assert result.returncode == 2
    assert result.stderr.count("\n") == 1


def test_systick_comes_every_millisecond(image: Image) -> None:
    due = running(image)
    before = struct.unpack("<I", due.peek(image.address("ticks"), 4))[0]
    due.run_us(1_000_000)
    assert struct.unpack("<I", due.peek(image.address("ticks"), 4))[0] - before == 1000


def test_a_sleeping_program_costs_its_instructions_only(image: Image) -> None:
    due = running(image)
    instructions, asleep = due.instructions, due.sleep_cycles
    due.run_us(100_000)
    assert due.instructions - instructions < 100 * 200
    assert due.sleep_cycles - asleep > 0.99 * 8_400_000


def test_a_function_is_measured_without_the_interrupts_in_it(image: Image) -> None:
    due = running(image)
    due.add_probe(image.address("work"))
    due.clear_stats()
    due.run_us(50_000)
    work = due.probe(image.address("work"))
    assert work.count == 50
    assert work.max_instructions == work.last_instructions == work.instructions // 50
    # Its loop runs 20 times and takes 4 to 8 instructions each time, as the compiler decides.
    assert 20 * 4 <= work.max_instructions <= 20 * 8
    systick = due.exception_stats(SYSTICK)
    assert systick.count == 50
    assert systick.instructions == 50 * systick.max_instructions


class Debugger:
    """Packets by hand, as GDB sends them."""

    def __init__(self, image: Image) -> None:
        self.image = image
        self.due = running(image)
        self._answer: Callable[[str], str] = GdbServer(self.due, image).answer

    def ask(self, text: str) -> str:
        return self._answer(text)


def test_gdb_reads_and_writes_registers_and_memory(image: Image) -> None:
    debugger = Debugger(image)
    assert len(debugger.ask("g")) == 17 * 8
    assert debugger.ask("P4=78563412") == "OK"
    assert debugger.ask("p4") == "78563412"
    address = image.address("trouble")
    assert debugger.ask(f"M{address:x},4:00000000") == "OK"
    assert debugger.ask(f"m{address:x},4") == "00000000"
    assert debugger.ask("m60000000,4") == "00000000"
    assert debugger.ask("zz") == "E01"
    assert debugger.ask("vMustReplyEmpty") == ""


def test_gdb_stops_at_a_breakpoint_and_steps_on(image: Image) -> None:
    debugger = Debugger(image)
    address = image.address("work")
    assert debugger.ask(f"Z0,{address:x},2") == "OK"
    for _ in range(2):
        assert debugger.ask("c") == "S05"
        assert debugger.due.reg(15) == address
    assert debugger.ask("s") == "S05"
    assert debugger.due.reg(15) in (address + 2, address + 4)
    assert debugger.ask(f"z0,{address:x},2") == "OK"
    before_us = debugger.due.now_us
    debugger.due.resume()
    debugger.due.run_us(5000)
    assert debugger.due.now_us - before_us == pytest.approx(5000, abs=1)


def test_a_breakpoint_that_was_taken_away_stops_again_when_it_is_back(image: Image) -> None:
    debugger = Debugger(image)
    address = image.address("work")
    for _ in range(3):
        debugger.ask(f"Z0,{address:x},2")
        assert debugger.ask("c") == "S05"
        assert debugger.due.reg(15) == address
        debugger.ask(f"z0,{address:x},2")
        debugger.ask("s")


def test_gdb_sees_a_fault_as_a_signal(image: Image) -> None:
    debugger = Debugger(image)
    debugger.due.stop_at_hardfault(True)
    debugger.ask(f"M{image.address('trouble'):x},4:01000000")
    assert debugger.ask("c") == "S0b"
    debugger = Debugger(image)
    debugger.ask(f"M{image.address('trouble'):x},4:02000000")
    assert debugger.ask("c") == "S0b"


def test_gdb_over_tcp(image: Image) -> None:
    server = GdbServer(running(image), image)
    listener = socket.socket()
    listener.bind(("127.0.0.1", 0))
    port = listener.getsockname()[1]
    listener.close()
    thread = threading.Thread(target=server.serve, args=(port,), daemon=True)
    thread.start()
    give_up_s = time.monotonic() + GUARD_S
    while True:
        try:
            client = socket.create_connection(("127.0.0.1", port), timeout=GUARD_S)
            break
        except ConnectionRefusedError:
            assert time.monotonic() < give_up_s, "nobody listens"
            time.sleep(0.01)
    with client:
        client.sendall(b"+" + packet("qSupported"))
        reply = client.recv(1000)
        while b"#" not in reply:
            reply += client.recv(1000)
        assert b"qXfer:features:read+" in reply
        client.sendall(packet("D"))
        thread.join(timeout=GUARD_S)
    assert not thread.is_alive()


@pytest.mark.skipif(
    not any(shutil.which(name) for name in ("gdb-multiarch", "arm-none-eabi-gdb")),
    reason="no GDB for ARM here",
)
def test_a_real_gdb_reaches_a_function(program: Path, tmp_path: Path) -> None:
    assert GDB is not None
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    server = subprocess.Popen(
        [sys.executable, "-m", "due_emulator", str(program), "--gdb", str(port)],
        stdout=subprocess.PIPE,
        text=True,
    )
    assert server.stdout is not None
    assert "waiting" in server.stdout.readline()
    script = [f"target remote :{port}", "break work", "continue", "print count", "info registers pc", "kill"]
    result = subprocess.run(
        [GDB, "-q", "-batch", *(part for line in script for part in ("-ex", line)), str(program)],
        capture_output=True, text=True, check=False, timeout=GUARD_S,
    )  # fmt: skip
    server.wait(timeout=GUARD_S)
    assert "$1 = 20" in result.stdout, result.stdout + result.stderr
