"""Runs the page's web server: one thread accepts connections and serves the stop, another serves clients."""

from __future__ import annotations

import contextlib
import socket
import sys
import threading
from collections.abc import Iterator
from dataclasses import dataclass

from heli_host.errors import PortError, listening_remedy
from heli_host.ui.page.gate import Gate
from heli_host.ui.page.guard import LOCAL_HOSTS, Guard, new_token
from heli_host.ui.page.notes import Notes
from heli_host.ui.page.server import PageServer
from heli_host.ui.page.service import Service
from heli_host.ui.page.source import Source
from heli_host.ui.page.stop_endpoint import StopEndpoint

_SWITCH_S = 0.001
"""Time after which a thread that computes lets another one run [s]. A stop needs about eight turns, from the
accepted connection to the port. With Python's 0.005 s and two busy threads, these take 80 ms."""
_RECEIVE_BUFFER_BYTES = 65536
_START_S = 10.0
_END_S = 3.0


@dataclass(frozen=True)
class Address:
    """Address of a running page server."""

    host: str  # Address that the server is bound to
    port: int  # TCP port
    token: str  # Secret that clients must send

    @property
    def page(self) -> str:
        """URL for a browser, with the token."""
        return f"http://{self._host_name}:{self.port}/?token={self.token}"

    @property
    def program(self) -> str:
        """URL for `heli_host.join`, with the token."""
        return f"page://{self._host_name}:{self.port}/?token={self.token}"

    @property
    def is_local(self) -> bool:
        """Whether only programs on this machine can reach the server."""
        return self.host in LOCAL_HOSTS

    @property
    def _host_name(self) -> str:
        name = self.host if self.host not in ("0.0.0.0", "::") else socket.gethostname()
        return f"[{name}]" if ":" in name else name


@contextlib.contextmanager
def serving(source: Source, host: str = "127.0.0.1", port: int = 0, token: str = "") -> Iterator[Address]:
    """Serve a page from a background thread until the ``with`` block ends.

    The end of the block closes the server only: the caller lands the helicopter or switches its motors off.

    `token`: Secret that clients must send; empty for a new random one.
    """
    guard, notes = Guard(token or new_token(), host), Notes()
    listening = _open_socket(host, port)
    server = PageServer(Service(source, guard, notes).application())
    gate = Gate(listening, StopEndpoint(source, guard, notes), server.take, notes)
    thread = threading.Thread(target=server.run, kwargs={"sockets": []}, name="heli-host page", daemon=True)
    before_s = sys.getswitchinterval()
    sys.setswitchinterval(_SWITCH_S)
    thread.start()
    started = threading.Event()
    try:
        for _ in range(round(_START_S / 0.01)):
            if server.started or not thread.is_alive():
                break
            started.wait(0.01)
        if not server.started:
            raise PortError(
                "the server of the dashboard did not start", "report this with the output of the server"
            )
        gate.start()
        yield Address(host, listening.getsockname()[1], guard.token)
    finally:
        gate.close()
        server.should_exit = True
        thread.join(_END_S)
        listening.close()
        sys.setswitchinterval(before_s)


def _open_socket(host: str, port: int) -> socket.socket:
    """Open the socket on which the page is served; a PortError names the fix if the port is taken."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listening = socket.socket(family, socket.SOCK_STREAM)
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    # Accepted connections inherit it: a client cannot make the system keep megabytes that nobody reads.
    listening.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER_BYTES)
    # A stop is only a few bytes, which the system must send immediately instead of collecting more.
    listening.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    try:
        listening.bind((host, port))
    except OSError as error:
        listening.close()
        reason = error.strerror or str(error)
        raise PortError(
            f"cannot serve on {host}:{port}: {reason}", listening_remedy(error, "--http-port")
        ) from error
    return listening
