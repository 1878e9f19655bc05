"""The transport ``sil://``: a simulated board in this process, or in a separate one behind a port."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tempfile
import threading
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import IO, Self
from urllib.parse import parse_qsl, urlencode, urlsplit

from heli_host.errors import LinkLost
from heli_host.link.transport import SerialTransport
from typing_extensions import override

from heli_sim.errors import EndpointError
from heli_sim.rig import load_rig
from heli_sim.rig.board import parameters_of, set_from_rig_text
from heli_sim.sil.boards import choose, recipe_of
from heli_sim.sil.inprocess import InProcessTransport
from heli_sim.sil.options import parse_url
from heli_sim.sil.world import SilWorld, set_from_rig

_STOP_s = 60.0
"""Longest wait for the end of the child [s]. A child that is killed leaves its port behind and reports no
counters; on a busy machine it takes seconds to end in order."""


class SilProcess:
    """A simulated board behind a port, served by a child process; a context manager."""

    # The port is a pseudo-terminal, or where the system has none, TCP on this machine alone.
    # The child ends when this process does, however that ends: it watches its standard input. It is in a
    # session of its own, so that Ctrl-C reaches the host alone, which can then still land the rig. Without a
    # `speed`, it simulates as fast as possible; without a path `pty`, the port is in a temporary folder.

    def __init__(
        self,
        rig: str = "makki2024",
        speed: float | None = None,
        seed: int = 1,
        *,
        options: dict[str, str] | None = None,
        pty: str | Path | None = None,
        rfc2217: str | None = None,
        timeout_s: float = 30.0,
    ) -> None:
        # `rfc2217`: HOST:PORT at which the board is served instead of at the pseudo-terminal `pty`.
        self._folder = None if pty is not None else Path(tempfile.mkdtemp(prefix="heli-sil-"))
        path = Path(pty) if pty is not None else Path(str(self._folder)) / "due"
        values = {"rig": rig, "seed": str(seed), "speed": "max" if speed is None else repr(speed)}
        self.counters: dict[str, int] = {}
        """Counters of the link; there once the process was stopped."""
        self._process = subprocess.Popen(
            [
                *(sys.executable, "-m", "heli_sim.sil.server", "--watch-stdin"),
                *_port_option(path, rfc2217),
                *("--options", urlencode({**values, **(options or {})})),
            ],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        try:
            self.url = self._wait_for_port(timeout_s)
            """Path of the port, good for pyserial."""
        except BaseException:
            self.stop()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    @property
    def pid(self) -> int:
        """Process id of the child."""
        return self._process.pid

    def stop(self) -> None:
        """End the child process and remove the port. Further calls do nothing."""
        if self._process.poll() is None:
            try:
                output, _ = self._process.communicate(timeout=_STOP_s)
            except subprocess.TimeoutExpired:
                self._process.kill()
                output, _ = self._process.communicate()
            self.counters = _last_counters(output)
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)

    def _wait_for_port(self, timeout_s: float) -> str:
        """Wait until the child process reports the address of its board, and return it."""
        # A child that hangs is killed, which ends the readline below.
        alarm = threading.Timer(timeout_s, self._process.kill)
        alarm.start()
        try:
            line = _output_stream(self._process.stdout).readline()
        finally:
            alarm.cancel()
        if line:
            return str(json.loads(line)["url"])
        self._process.wait()
        reasons = _output_stream(self._process.stderr).read().strip().splitlines()
        if not reasons:
            raise EndpointError(f"the simulated board did not start within {timeout_s:g} s", "try again")
        raise EndpointError(f"the simulated board did not start: {reasons[-1]}")


def _port_option(path: Path, rfc2217: str | None) -> tuple[str, str]:
    """Return option and value of the port that a board in its own process serves."""
    if rfc2217 is not None:
        return "--rfc2217", rfc2217
    try:
        import termios  # noqa: F401  Windows has neither it nor pseudo-terminals
    except ImportError:
        return "--tcp", "127.0.0.1:0"
    return "--pty", str(path)


def _output_stream(stream: IO[str] | None) -> IO[str]:
    assert stream is not None  # all three are pipes
    return stream


def _last_counters(output: str) -> dict[str, int]:
    """Return the counters that the server printed last; empty if it printed none."""
    for line in reversed(output.splitlines()):
        values = json.loads(line)
        if "counters" in values:
            return {str(name): int(count) for name, count in values["counters"].items()}
    return {}


class ProcessTransport(SerialTransport):
    """Transport to a simulated board in a separate process, behind a pseudo-terminal."""

    def __init__(
        self,
        process: SilProcess,
        label: str,
        note: str = "",
        rig: str = "",
        rig_parameters: Mapping[str, float] = MappingProxyType({}),
        recipe: Mapping[str, str] = MappingProxyType({}),
    ) -> None:
        super().__init__(process.url)
        self.recipe = recipe
        self.rig_parameters = rig_parameters
        self.label = label
        self.note = note
        self.rig = rig
        self._process = process
        self._lost = False

    @override
    def read(self, timeout_s: float) -> bytes:
        try:
            return super().read(timeout_s)
        except LinkLost:
            self._lost = True
            raise

    @override
    def write(self, data: bytes) -> None:
        try:
            super().write(data)
        except LinkLost:
            self._lost = True
            raise

    @override
    def close(self) -> None:
        super().close()
        if not self._lost:
            self._process.stop()

    @override
    def reopen(self) -> ProcessTransport:
        return ProcessTransport(
            self._process, self.label, self.note, self.rig, self.rig_parameters, self.recipe
        )


def open_transport(url: str) -> InProcessTransport | ProcessTransport:
    """Start a simulated board and open its port; the entry point ``heli_host.transports``, name ``sil``. The
    board is just powered up, with the arm at rest on the table.
    """
    options = parse_url(url)
    choice = choose(options.board, options.elf)
    no_due = f"no emulated Due: {choice.reason}" if choice.reason else ""
    if options.process:
        values = dict(parse_qsl(urlsplit(url).query))
        values |= {"board": choice.name, "elf": choice.elf, "process": "0"}
        rig = load_rig(options.rig)
        note = _joined_texts(no_due, set_from_rig_text(rig.name, set_from_rig(options, rig)))
        return ProcessTransport(
            SilProcess(options=values),
            choice.text,
            note,
            options.rig,
            parameters_of(rig) | options.rig_faults.uncompared_signs,
            recipe_of(url, options, rig, choice),
        )
    world = SilWorld(replace(options, board=choice.name, elf=choice.elf))
    note = _joined_texts(no_due, set_from_rig_text(world.rig.name, world.set_from_rig))
    recipe = recipe_of(url, options, world.rig, choice)
    return InProcessTransport(world, url, choice.text, note, recipe)


def _joined_texts(*texts: str) -> str:
    return "; ".join(filter(None, texts))
