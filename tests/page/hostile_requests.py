"""Every request that a page's server knows, and values that no honest client sends, from a seed."""

import math
import random
import socket
from typing import Any, Final

from heli_host.ui.page.serve import Address

from tests.page.page_server import PATIENCE_S

ARGUMENTS: Final = {
    "take_off": ("elevation_deg",),
    "fly": ("plans",),
    "land": (),
    "clear_fault": (),
    "zero": (),
    "setpoint": ("elevation_deg", "travel_deg"),
    "hold": (),
    "set": ("name", "value"),
    "undo": (),
    "save": (),
    "law": ("name",),
    "set_law": ("name", "value"),
    "record": ("on",),
    "mark": ("text",),
    "signal": ("name", "value"),
    "ask": (),
    "grant": (),
    "keep": (),
    "share": ("on",),
}
"""Arguments of the requests, by name."""
FAR: Final = (1e308, -1e308, 2**63, -(10**30), 5e-324)
ODD: Final[tuple[Any, ...]] = (
    *(*FAR, math.nan, math.inf, -math.inf, 10**400, -(10**309), "\ud800", "\0", "", "x" * 5000, None, True),
    *([], [[]], {}, {"a": {"b": math.nan}}, ["short"] * 400, "kp", "travel_kp", "up", -0.0, 1.5),
)


def hostile_request(chance: random.Random, harmless: bool = False) -> dict[str, Any]:
    """Return a request with odd arguments."""
    ends = ("land", "take_off", "fly", "law", "grant", "ask") if harmless else ()
    name = chance.choice([request for request in (*ARGUMENTS, "stop it", "") if request not in ends])
    arguments = {argument: chance.choice(ODD) for argument in ARGUMENTS.get(name, ("x",))}
    more = {chance.choice(("do it", "id2", "\0")): chance.choice(ODD)} if chance.random() < 0.2 else {}
    return {**arguments, **more, "do": name}


def status_of_request(
    address: Address, path: str, headers: list[tuple[str, str]], method: str = "GET"
) -> int:
    """Status that the server answers with; 0 where it closes the connection without one."""
    lines = [f"{method} {path} HTTP/1.1", *(f"{name}: {value}" for name, value in headers), "", ""]
    with socket.create_connection((address.host, address.port), timeout=PATIENCE_S) as connection:
        connection.sendall("\r\n".join(lines).encode("latin-1", "replace"))
        connection.shutdown(socket.SHUT_WR)
        received = connection.recv(100)
    return int(received.split()[1]) if received else 0


UPGRADE: Final = [
    ("Connection", "Upgrade"),
    ("Upgrade", "websocket"),
    ("Sec-WebSocket-Version", "13"),
    ("Sec-WebSocket-Key", "dGhlIHNhbXBsZSBub25jZQ=="),
]
_PATHS: Final = (
    "",
    "stop",
    "ws",
    "main.js",
    "vendor/three.js",
    "../cockpit.py",
    "%00",
    "a" * 9000,
    "%2e%2e/%2e%2e/a",
)
_HOSTS: Final = (
    "[",
    "]",
    "[::1",
    "[::1]:x",
    "127.0.0.1",
    "localhost:99999999999",
    "",
    "evil.example",
    "\xff",
    "a" * 300,
)


def hostile_http(chance: random.Random, address: Address) -> str:
    """Send a request that no browser sends; return what is wrong with its answer, or an empty text."""
    good = f"127.0.0.1:{address.port}"
    token = chance.choice(
        ("", "?token=", "?token=%ff", "?token=[", f"?token={address.token[:-1]}x", address.token)
    )
    is_known = token == address.token
    token = f"?token={token}" if is_known else token
    path = chance.choice(_PATHS)
    headers = [("Host", chance.choice((good, *_HOSTS)))]
    if chance.random() < 0.6:
        headers.append(
            ("Origin", chance.choice(("null", "http://[", f"http://{good}", "http://evil.example")))
        )
    upgrade = chance.random() < 0.3
    method = "GET" if upgrade else chance.choice(("GET", "HEAD", "PUT", "OPTIONS", "DELETE", "POST"))
    if path == "stop" and is_known and headers == [("Host", good)]:
        # The stop itself is for everybody who has the token.
        return ""
    status = status_of_request(address, f"/{path}{token}", headers + (UPGRADE if upgrade else []), method)
    request = f"{method} /{path[:40]} {headers}"
    if status >= 500:
        return f"{request} is answered with {status}"
    if path in ("", "stop", "ws") and not is_known and not (status == 0 or 400 <= status < 500):
        return f"{request} is answered with {status} without the token"
    return ""
