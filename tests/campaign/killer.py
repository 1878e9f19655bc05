"""Starts campaigns, schedulers and workers, and kills them."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

from heli_lab.apps.campaign import Campaign, Case, Store, run_campaign
from heli_lab.apps.campaign.cases import Limits

ROOT = Path(__file__).resolve().parents[2]
PATIENCE_s = 120.0


def free_port() -> int:
    with socket.socket() as free_socket:
        free_socket.bind(("127.0.0.1", 0))
        return int(free_socket.getsockname()[1])


def start_program(*words: str, path: Path = ROOT) -> subprocess.Popen[bytes]:
    """Start a Python program in a group of its own, which finds packages in a folder first."""
    return subprocess.Popen(
        [sys.executable, *words],
        cwd=path,
        env={**os.environ, "PYTHONPATH": str(path)},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        start_new_session=True,
    )


def kill_all(program: subprocess.Popen[bytes]) -> None:
    """Kill a program and what it started, as a machine that loses its power does."""
    with suppress(ProcessLookupError):
        os.killpg(program.pid, signal.SIGKILL)
    program.wait()
    if program.stdout is not None:
        program.stdout.close()


def children(program: subprocess.Popen[bytes]) -> list[int]:
    """Processes that a program has started."""
    with suppress(FileNotFoundError):
        tasks = Path(f"/proc/{program.pid}/task").iterdir()
        return sorted(int(child) for task in tasks for child in (task / "children").read_text().split())
    return []


@dataclass
class Cluster:
    """A scheduler and workers of Dask on this machine, each in a process of its own."""

    workers: int = 2
    address: str = ""
    parts: list[subprocess.Popen[bytes]] = field(default_factory=list)

    def __enter__(self) -> Cluster:
        self.begin()
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    def begin(self) -> None:
        port = free_port()
        self.address = f"tcp://127.0.0.1:{port}"
        scheduler = ("-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", str(port))
        self.parts = [start_program(*scheduler, "--no-dashboard")]
        for _ in range(self.workers):
            self.add_worker()

    def add_worker(self, path: Path = ROOT) -> None:
        arguments = ("--nthreads", "1", "--no-nanny", "--no-dashboard", "--memory-limit", "0")
        self.parts.append(
            start_program("-m", "distributed.cli.dask_worker", self.address, *arguments, path=path)
        )

    def wait_for_workers(self, count: int) -> None:
        from distributed import Client

        with Client(self.address, timeout=PATIENCE_s) as client:
            client.wait_for_workers(count, timeout=PATIENCE_s)

    def end(self) -> None:
        for part in self.parts:
            kill_all(part)
        self.parts = []


def wait_until(done: Callable[[], bool], program: subprocess.Popen[bytes]) -> None:
    """Wait until something is so, or the program has ended."""
    until_s = time.monotonic() + PATIENCE_s
    while time.monotonic() < until_s and program.poll() is None and not done():
        time.sleep(0.01)


CODE = "the code of a test"


def gate_of(log: str | Path) -> Path:
    """File that the last case waits for: no campaign ends before a test wants that."""
    return Path(f"{log}.gate")


def cases(count: int, nap_s: float, log: str) -> tuple[Case, ...]:
    work = "tests.campaign.works:count"
    gates = [*("" for _ in range(count - 1)), str(gate_of(log))]
    settings = [
        {"number": number, "nap_s": nap_s, "log": log, "gate": gate} for number, gate in enumerate(gates)
    ]
    return tuple(Case(f"case {values['number']:03d}", work, values) for values in settings)


def main(folder: str, log: str, count: str, nap_s: str, address: str | None = None) -> None:
    campaign = Campaign("squares", cases(int(count), float(nap_s), log), Limits(30.0, 300.0))
    run_campaign(campaign, Store(Path(folder)), scheduler=address, processes=2, code=CODE)


if __name__ == "__main__":
    main(*sys.argv[1:])
