"""The error for a board that did not answer the handshake, with a cause derived from the received bytes."""

from __future__ import annotations

from heli_host.errors import HandshakeTimeout, LinkError, WrongDevice
from heli_host.link.frames import FrameParser


def no_welcome(parser: FrameParser, url: str, timeout_s: float) -> LinkError:
    """Return the error for a handshake that timed out."""
    if parser.frames_ok:
        return HandshakeTimeout(
            f"a board on {url} sends data, but did not answer within {timeout_s:g} s",
            "press the board's reset button; if the error stays, flash the firmware of this release",
        )
    if parser.bytes_received == 0:
        return HandshakeTimeout(
            f"no data came from {url} within {timeout_s:g} s",
            "check power and cable, that it is the programming port, and that the firmware is flashed",
        )
    everything = parser.excerpt + parser.pending
    excerpt = everything[-16:]
    received_text = f"{parser.bytes_received} bytes (the last: {excerpt.hex(' ')})"
    # A boot loader, a console, or a simulated board with another host sends readable text.
    last_line = everything.strip(b"\r\n\0").rpartition(b"\n")[2].decode("ascii", errors="replace")
    if last_line.isascii() and last_line.isprintable() and last_line:
        received_text += f", in words {last_line!r},"
    return WrongDevice(
        f"{received_text} came from {url}, but no frame of this link",
        "choose another port (heli-host ports lists them), or flash the firmware of this release",
        parser.bytes_received,
        excerpt,
    )
