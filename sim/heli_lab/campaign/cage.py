"""A process of its own for cases, so that one which crashes or runs away takes nothing else with it.

Orders and answers go through two pipes, one JSON a line. The process ends itself when nobody can give it
orders any more, so that none outlives its worker. The kernel counts the CPU time of a case and ends a process
that exceeds it, whatever code it is in; a case that waits for ever uses none, and is ended by the clock.
"""

from __future__ import annotations

import importlib
import json
import os
import queue
import select
import signal
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import IO, Any, Final, Self

from heli_lab.campaign.case import Answer, Case

_ONE_THREAD: Final = {f"{name}_NUM_THREADS": "{threads}" for name in ("OMP", "OPENBLAS", "MKL")}
_KILLED_AGAIN: Final = 2
"""Times that a case is begun again whose process somebody else killed: the system does so when memory is
short, and the next time there may be enough."""


@dataclass(frozen=True)
class Limits:
    """What one case may take.

    Parameters
    ----------
    cpu_s : float
        CPU time; counted in whole seconds, one at least.
    wait_s : float
        Time by the clock, for a case that waits and uses no CPU.
    threads : int
        Threads of the libraries for linear algebra, and of the fits.
    """

    cpu_s: float = 3600.0
    wait_s: float = 36000.0
    threads: int = 1


class Cage:
    """Runs cases, one after the other, in a process of its own, made anew when a case has ended it."""

    def __init__(self, limits: Limits) -> None:
        self.limits = limits
        self._process: subprocess.Popen[bytes] | None = None
        self._orders: IO[bytes] | None = None
        self._answers: IO[bytes] | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the process."""
        if self._process is None:
            return
        with suppress(ProcessLookupError):
            self._process.kill()
        self._process.wait()
        for pipe in (self._orders, self._answers):
            if pipe is not None:
                with suppress(OSError):
                    pipe.close()
        self._process = self._orders = self._answers = None

    def run(self, case: Case, key: str) -> Answer:
        """Do a case, whose result has the name `key`; what goes wrong is told in the answer."""
        started_s = time.monotonic()
        answer = self._attempt(case, key)
        for _ in range(_KILLED_AGAIN):
            if answer is not None:
                break
            answer = self._attempt(case, key)
        if answer is None:
            answer = Answer(case.name, key, failure="its process was killed from outside, again and again")
        return Answer(**{**answer.to_json(), "seconds": time.monotonic() - started_s})

    def _attempt(self, case: Case, key: str) -> Answer | None:
        """Do it once; None where the process was killed from outside."""
        if self._process is None or self._process.poll() is not None:
            self.close()
            self._start()
        assert self._process and self._orders and self._answers
        order = {"work": case.work, "settings": case.settings, "cpu_s": self.limits.cpu_s}
        try:
            self._orders.write(json.dumps(order).encode() + b"\n")
            self._orders.flush()
        except BrokenPipeError:
            return self._ended(case, key)
        if not select.select([self._answers], [], [], self.limits.wait_s)[0]:
            self.close()
            return Answer(case.name, key, failure=f"no answer after {self.limits.wait_s:g} s: it hung")
        line = self._answers.readline()
        if not line.endswith(b"\n"):
            return self._ended(case, key)
        said = json.loads(line)
        return Answer(case.name, key, said["row"], said["detail"], said["failure"], said["cpu_s"])

    def _ended(self, case: Case, key: str) -> Answer | None:
        """Say why the process has ended."""
        assert self._process
        code = self._process.wait()
        self.close()
        if code == -signal.SIGXCPU:
            limit_s = self.limits.cpu_s
            return Answer(case.name, key, failure=f"over {limit_s:g} s of CPU: it ran away", cpu_s=limit_s)
        if code in (-signal.SIGKILL, -signal.SIGTERM):
            return None
        why = signal.Signals(-code).name if code < 0 else f"exit status {code}"
        return Answer(case.name, key, failure=f"its process crashed: {why}")

    def _start(self) -> None:
        order_end, self_orders = os.pipe()
        self_answers, answer_end = os.pipe()
        threads = {name: text.format(threads=self.limits.threads) for name, text in _ONE_THREAD.items()}
        # Not by multiprocessing, which refuses children to the daemonic processes that workers are.
        self._process = subprocess.Popen(
            [sys.executable, "-m", "heli_lab.campaign.cage", str(order_end), str(answer_end)],
            pass_fds=(order_end, answer_end),
            env={**os.environ, **threads, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(order_end)
        os.close(answer_end)
        self._orders, self._answers = os.fdopen(self_orders, "wb"), os.fdopen(self_answers, "rb")


def serve(orders: IO[bytes], answers: IO[bytes]) -> None:
    """Do what `orders` say, one JSON a line, and write an answer a line to `answers`, until nobody
    gives orders.
    """
    waiting: queue.SimpleQueue[bytes] = queue.SimpleQueue()

    def read() -> None:
        for line in orders:
            waiting.put(line)
        # Whoever gave the orders is gone: what is being done is of no use to anybody.
        os._exit(0)

    threading.Thread(target=read, daemon=True).start()
    while True:
        order = json.loads(waiting.get())
        before_s = time.process_time()
        _allow_cpu(before_s + order["cpu_s"])
        said = _done(order["work"], order["settings"])
        answers.write(_line({**said, "cpu_s": time.process_time() - before_s}) + b"\n")
        answers.flush()


def _done(work: str, settings: Mapping[str, Any]) -> dict[str, Any]:
    from heli_host.errors import HeliError

    try:
        module, _, function = work.partition(":")
        row, detail = getattr(importlib.import_module(module), function)(settings)
    except HeliError as error:
        return {"row": {}, "detail": None, "failure": str(error)}
    except Exception as error:  # noqa: BLE001 - whatever a case raises is its own failure and no other's
        text = " ".join(f"{type(error).__name__}: {error}".split())
        return {"row": {}, "detail": {"traceback": traceback.format_exc()}, "failure": text}
    return {"row": dict(row), "detail": detail, "failure": ""}


def _line(said: Mapping[str, Any]) -> bytes:
    try:
        return json.dumps(said, default=_plain).encode()
    except (TypeError, ValueError) as error:
        failed: dict[str, Any] = {"row": {}, "detail": None, "failure": f"its result is no JSON: {error}"}
        return json.dumps({**failed, "cpu_s": said["cpu_s"]}).encode()


def _plain(value: Any) -> Any:
    """Numbers and arrays of numpy as Python has them."""
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} is no JSON")


def _allow_cpu(until_s: float) -> None:
    """Have the kernel end this process once it has used so much CPU time."""
    import resource

    hard = resource.getrlimit(resource.RLIMIT_CPU)[1]
    seconds = max(1, int(until_s) + 1)
    if hard != resource.RLIM_INFINITY:
        seconds = min(seconds, hard)
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, hard))
    resource.setrlimit(resource.RLIMIT_CORE, (0, resource.getrlimit(resource.RLIMIT_CORE)[1]))


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for whoever gives the orders
    with os.fdopen(int(sys.argv[1]), "rb") as given, os.fdopen(int(sys.argv[2]), "wb") as told:
        serve(given, told)
