"""A student can step the firmware."""

from __future__ import annotations

import re
import shutil
import socket
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.emulated

due = pytest.importorskip("due_emulator._due", reason="the emulated Due is not built: make setup")
pytest.importorskip("elftools", reason="pyelftools is missing: make setup")

GDB = shutil.which("gdb-multiarch") or shutil.which("arm-none-eabi-gdb")


def test_a_breakpoint_in_the_tick_is_reached_and_stepped_on_from(elf: Path) -> None:
    from due_emulator import new_due, read_image
    from due_emulator.gdb import GdbServer

    image = read_image(elf)
    board = new_due(image)
    board.power_on()
    ask = GdbServer(board, image).answer
    address = image.address("tick_interrupt") & ~1
    assert ask(f"Z0,{address:x},2") == "OK"
    for _ in range(3):
        assert ask("c") == "S05"
        assert board.reg(15) == address
        before = board.instructions
        for _ in range(20):
            assert ask("s") == "S05"
        # A breakpoint is no instruction, and nothing is skipped.
        assert board.instructions - before == 20
    assert ask(f"z0,{address:x},2") == "OK"


@pytest.mark.skipif(GDB is None, reason="no GDB for ARM is installed: apt-get install gdb-multiarch")
def test_a_real_gdb_stops_in_the_tick_and_names_its_lines(elf: Path) -> None:
    assert GDB is not None
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    server = subprocess.Popen(
        [sys.executable, "-m", "due_emulator", str(elf), "--gdb", str(port)],
        stdout=subprocess.PIPE,
        text=True,
    )
    assert server.stdout is not None
    assert "waiting" in server.stdout.readline()
    lines = [
        f"target remote :{port}",
        "break tick_interrupt",
        "continue",
        "stepi",
        "backtrace",
        "print heli::due::ticks",
        "x/1xw 0x40080010",
        "kill",
    ]
    script = [part for line in lines for part in ("-ex", line)]
    process = subprocess.run(
        [GDB, "-q", "-batch", *script, str(elf)], capture_output=True, text=True, check=False, timeout=120
    )
    server.wait(timeout=120)
    output = process.stdout + process.stderr
    assert "tick_interrupt" in process.stdout, output
    assert "main.cpp" in process.stdout, output
    # The timer's counter starts again with each tick: one register of the chip as the debugger reads it.
    counted = re.search(r"0x40080010:\t(0x[0-9a-f]{8})", process.stdout)
    assert counted is not None and int(counted[1], 16) < 42_000_000 // 1_000_000, output
