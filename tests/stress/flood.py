"""How long a stop of the dashboard takes while other clients send as fast as they can.

``python -m tests.stress flood --clients 60`` prints the longest time from sending a stop to its answer, which
follows after the server has sent the stop to the board: over a new connection (POST) and over an open socket.
"""

import contextlib
import json
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final
from urllib.parse import parse_qs, urlsplit

from websockets.frames import Frame, Opcode
from websockets.sync.client import ClientConnection, connect

from tests.page.hostile_requests import UPGRADE
from tests.page.page_server import page_process

MESSAGES: Final = {
    "idle": "",
    "signal": json.dumps({"do": "signal", "id": 1, "name": "x", "value": 1}),
    "junk": '{"do":' + "[" * 500,
    "set": json.dumps({"do": "set", "id": 2, "name": "travel_kp", "value": 0.7}),
    "mark": json.dumps({"do": "mark", "id": 3, "text": "y" * 150}),
    "ask": json.dumps({"do": "ask", "id": 1}),
}
"""Message that a client of each kind repeats. It never reads."""
PACED: Final = "paced"
"""Clients that stay just below the limit of messages, with ``signal``."""
CONNECT: Final = "connect"
"""Clients that open a connection, request the page and open the next."""
KINDS: Final = (*MESSAGES, PACED, CONNECT)
_PACED_PER_S: Final = 90.0
_REPEATED: Final = 20
_PATIENCE_S: Final = 30.0


@dataclass
class Stops:
    """Result of one flood: times of the stops [s], and the server's memory [MB] before and after."""

    kind: str
    post_s: list[float] = field(default_factory=list)
    open_s: list[float] = field(default_factory=list)
    memory_MB: tuple[float, float] = (0.0, 0.0)

    def row(self) -> str:
        """Return the result as a row of a table."""
        return (
            f"| {self.kind} | {len(self.post_s)} | {1e3 * max(self.post_s):.0f} ms "
            f"| {1e3 * max(self.open_s):.0f} ms | {self.memory_MB[0]:.0f} MB | {self.memory_MB[1]:.0f} MB |"
        )


def flood(port: int, token: str, clients: int, kind: str) -> None:
    """Be that many clients until the process is ended."""
    if kind == CONNECT:
        while True:
            with contextlib.suppress(OSError):
                _send_head(port, f"/?token={token}", []).close()
    message = MESSAGES["signal" if kind == PACED else kind]
    frame = Frame(Opcode.TEXT, message.encode()).serialize(mask=True, extensions=[])
    data = frame if kind == PACED else frame * _REPEATED if message else b""
    connected: dict[int, socket.socket] = {}
    while True:
        is_sent = False
        for number in range(clients):
            with contextlib.suppress(OSError):
                if number not in connected:
                    connected[number] = _send_head(port, f"/ws?role=program&token={token}", UPGRADE)
                    connected[number].setblocking(False)
                if data:
                    connected[number].send(data)
                    is_sent = True
                continue
            if data and number in connected and _is_closed(connected[number]):
                connected.pop(number).close()
        if kind == PACED or not is_sent:
            time.sleep(1.0 / _PACED_PER_S if kind == PACED else 0.005)


def measure_stops(address: str, process_id: int, clients: int, kind: str, duration_s: float) -> Stops:
    """Flood a server, stop again and again meanwhile, and return how long that took."""
    url = urlsplit(address)
    port, token = int(url.port or 0), parse_qs(url.query)["token"][0]
    result = Stops(kind)
    before_MB = resident_MB(process_id)
    command = [sys.executable, "-m", "tests.stress.flood", str(port), token, str(clients), kind]
    with connect(f"ws://127.0.0.1:{port}/stop?token={token}", compression=None, proxy=None) as opened:
        flooding = subprocess.Popen(command, cwd=Path(__file__).resolve().parents[2])
        try:
            end_s = time.monotonic() + duration_s
            while time.monotonic() < end_s:
                time.sleep(0.05)
                result.post_s.append(_seconds(lambda: _post_stop(port, token)))
                result.open_s.append(_seconds(lambda: _stop_over(opened)))
        finally:
            flooding.kill()
            flooding.wait()
    result.memory_MB = before_MB, resident_MB(process_id)
    return result


def resident_MB(process_id: int) -> float:
    """Return the resident memory of a process [MB]; 0 where the system has no /proc."""
    with contextlib.suppress(OSError):
        for line in Path(f"/proc/{process_id}/status").read_text().splitlines():
            if line.startswith("VmRSS:"):
                return int(line.split()[1]) / 1024.0
    return 0.0


def floods(clients: int, duration_s: float, kinds: tuple[str, ...], say: Callable[[str], None]) -> int:
    """Run all floods against one server that flies a simulated board; return 1 if a stop took too long."""
    say("| kind of clients | stops | longest by POST | longest by socket | memory before | memory after |")
    say("|---|---|---|---|---|---|")
    longest_s = 0.0
    with (
        tempfile.TemporaryDirectory() as folder,
        page_process("--sil", "--http-port", "0", folder=Path(folder)) as (process, address),
    ):
        assert process.stdout is not None
        threading.Thread(target=process.stdout.read, daemon=True).start()
        for kind in kinds:
            result = measure_stops(address, process.pid, clients, kind, duration_s)
            say(result.row())
            longest_s = max(longest_s, *result.post_s, *result.open_s)
    return int(longest_s > 0.1)


def _send_head(port: int, path: str, headers: list[tuple[str, str]]) -> socket.socket:
    lines = [f"GET {path} HTTP/1.1", f"Host: 127.0.0.1:{port}"]
    lines += [f"{name}: {value}" for name, value in headers]
    connection = socket.create_connection(("127.0.0.1", port), _PATIENCE_S)
    connection.sendall("\r\n".join([*lines, "", ""]).encode())
    return connection


def _is_closed(connection: socket.socket) -> bool:
    try:
        connection.send(b"")
    except OSError:
        return True
    return bool(connection.fileno() < 0)


def _post_stop(port: int, token: str) -> None:
    head = f"POST /stop?token={token} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nContent-Length: 0\r\n\r\n"
    with socket.create_connection(("127.0.0.1", port), _PATIENCE_S) as connection:
        connection.sendall(head.encode())
        received = b"".join(iter(lambda: connection.recv(4096), b""))
    assert received.endswith(b"stopped\n"), received


def _stop_over(opened: ClientConnection) -> None:
    opened.send("stop")
    assert opened.recv(_PATIENCE_S) == "stopped"


def _seconds(act: Callable[[], None]) -> float:
    begin_s = time.perf_counter()
    act()
    return time.perf_counter() - begin_s


if __name__ == "__main__":
    flood(int(sys.argv[1]), sys.argv[2], int(sys.argv[3]), sys.argv[4])
