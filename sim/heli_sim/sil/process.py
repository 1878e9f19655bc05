"""A simulated board in a separate process, which hosts reach through a port as they reach hardware."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import tempfile
import threading
from pathlib import Path
from types import TracebackType
from typing import IO, Self
from urllib.parse import urlencode

from heli_sim.errors import EndpointError

_STOP_s = 60.0
"""Longest wait for the end of the child [s]. A child that is killed leaves its port behind and reports no
counters; on a busy machine it takes seconds to end in order."""


class SilProcess:
    """A simulated board behind a port, served by a child process; a context manager.

    The port is a pseudo-terminal, or where the system has none, TCP on this machine alone.

    The child ends when this process does, however that ends: it watches its standard input. It is in a
    session of its own, so that Ctrl-C reaches the host alone, which can then still land the rig.
    """

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
