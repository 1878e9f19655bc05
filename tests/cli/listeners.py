"""Where a process and the processes that it started listen, by what the kernel says."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import suppress
from ipaddress import IPv4Address, IPv6Address, ip_address
from pathlib import Path
from typing import Final

_PROC: Final = Path("/proc")
_TABLES: Final = {"tcp": "0A", "tcp6": "0A", "udp": "07", "udp6": "07"}
"""Tables of the kernel, and the state in which a socket takes what anybody sends."""


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
