"""Run cases in a separate process, so that a case which crashes or does not end harms nothing else.

Jobs and replies go through two pipes, one JSON text per line. The process ends itself when its pipe of jobs
is closed, so that it does not outlive its worker. The kernel counts the CPU time of a case, and ends a
process that exceeds the limit, even in compiled code. A case that waits without end uses no CPU time, so that
a limit by the clock ends it. If the kernel cannot limit the CPU time (Windows), a thread of the process
counts it. That thread cannot run while compiled code blocks Python; such a case is ended by the clock.
"""

from __future__ import annotations

import importlib
import json
import math
import os
import queue
import signal
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import IO, Any, Final, Self

from heli_host.fly.process_limits import can_limit, limit_process

from heli_lab.apps.campaign.case import Case, JobResult

_ONE_THREAD: Final = {f"{name}_NUM_THREADS": "{threads}" for name in ("OMP", "OPENBLAS", "MKL")}
_RETRIES_AFTER_KILL: Final = 2
"""Number of times that a case is run again after its process was killed from outside. The system does so if
memory is short, and the next time there may be enough."""
_CPU_LIMIT_STATUS: Final = 152
"""Exit status of a process that ends itself because of its CPU time: that of SIGXCPU in a shell."""
_WATCH_INTERVAL_s: Final = 0.1


@dataclass(frozen=True)
class Limits:
    """Limits of CPU time, time and threads for one case."""

    cpu_s: float = 3600.0  # Largest CPU time [s]; counted in whole seconds, at least 1
    wait_s: float = 36000.0  # Longest time by the clock [s], for a case that waits and uses no CPU time
    threads: int = 1  # Number of threads of the libraries for linear algebra, and of the fits


class WorkerProcess:
    """Runs cases, one after the other, in a separate process. If a case ends the process, a new one is
    started.
    """

    def __init__(self, limits: Limits, modules: str = "") -> None:
        self.limits = limits
        self.modules = modules
        self._process: subprocess.Popen[bytes] | None = None
        self._jobs: IO[bytes] | None = None
        self._replies: queue.SimpleQueue[bytes] = queue.SimpleQueue()

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
        with suppress(OSError):
            if self._jobs is not None:
                self._jobs.close()
        self._process = self._jobs = None

    def run(self, case: Case, key: str) -> JobResult:
        """Run a case, whose result is stored under `key`; a failure is reported in the result."""
        started_s = time.monotonic()
        result = None
        for _ in range(1 + _RETRIES_AFTER_KILL):
            result = self._run_once(case, key)
            if result is not None:
                break
        if result is None:
            result = JobResult(case.name, key, failure="its process was killed from outside, again and again")
        return replace(result, seconds=time.monotonic() - started_s)

    def _run_once(self, case: Case, key: str) -> JobResult | None:
        """Run the case once; None if the process was killed from outside."""
        if self._process is None or self._process.poll() is not None:
            self.close()
            self._start_process()
        assert self._process and self._jobs
        job = {"work": case.work, "settings": case.settings, "cpu_s": self.limits.cpu_s}
        try:
            self._jobs.write(json.dumps(job).encode() + b"\n")
            self._jobs.flush()
        except OSError:
            return self._result_of_ended_process(case, key)
        try:
            line = self._replies.get(timeout=self.limits.wait_s)
        except queue.Empty:
            self.close()
            return JobResult(case.name, key, failure=f"no answer within {self.limits.wait_s:g} s")
        if not line.endswith(b"\n"):
            return self._result_of_ended_process(case, key)
        reply = json.loads(line)
        return JobResult(case.name, key, reply["row"], reply["detail"], reply["failure"], reply["cpu_s"])

    def _result_of_ended_process(self, case: Case, key: str) -> JobResult | None:
        """Return a result with the reason why the process has ended; None if it was killed from outside."""
        assert self._process
        code = self._process.wait()
        self.close()
        name = signal.Signals(-code).name if code < 0 else ""
        if name == "SIGXCPU" or code == _CPU_LIMIT_STATUS:
            limit_s = self.limits.cpu_s
            return JobResult(
                case.name, key, failure=f"the case used more than {limit_s:g} s of CPU", cpu_s=limit_s
            )
        if name in ("SIGKILL", "SIGTERM"):
            return None
        return JobResult(case.name, key, failure=f"its process crashed: {name or f'exit status {code}'}")

    def _start_process(self) -> None:
        """Start the process, and a thread that reads its replies."""
        threads = {name: text.format(threads=self.limits.threads) for name, text in _ONE_THREAD.items()}
        paths = [*sys.path, self.modules]
        # multiprocessing does not work here: it refuses children of daemonic processes, which workers may be.
        self._process = subprocess.Popen(
            [sys.executable, "-m", "heli_lab.apps.campaign.worker_process"],
            env={**os.environ, **threads, "PYTHONPATH": os.pathsep.join(filter(None, paths))},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        )
        self._jobs, self._replies = self._process.stdin, queue.SimpleQueue()
        pipes = (self._process.stdout, self._replies)
        # Windows cannot wait for a pipe with a time limit, so a thread reads the pipe.
        threading.Thread(target=_read_lines, args=pipes, daemon=True).start()


def _read_lines(pipe: IO[bytes], lines: queue.SimpleQueue[bytes]) -> None:
    """Read the lines of a pipe into a queue; at the end of the pipe, put an empty line, b""."""
    with pipe:
        for line in pipe:
            lines.put(line)
    lines.put(b"")


def serve_jobs(jobs: IO[bytes], replies: IO[bytes]) -> None:
    """Run jobs until the pipe of jobs is closed, which ends this process."""
    waiting: queue.SimpleQueue[bytes] = queue.SimpleQueue()

    def read_jobs() -> None:
        """Read jobs into the queue; end the process when the pipe is closed."""
        for line in jobs:
            waiting.put(line)
        # The worker has ended, and nobody reads the result of the present case.
        os._exit(0)

    # Set before the thread starts: if this fails later, the process cannot end, because the thread holds the
    # lock of the pipe.
    allow_cpu = _cpu_limit()
    threading.Thread(target=read_jobs, daemon=True).start()
    while True:
        job = json.loads(waiting.get())
        before_s = time.process_time()
        allow_cpu(before_s + job["cpu_s"])
        reply = _run_and_describe(job["work"], job["settings"])
        replies.write(_json_line({**reply, "cpu_s": time.process_time() - before_s}) + b"\n")
        replies.flush()


def _run_and_describe(work: str, settings: Mapping[str, Any]) -> dict[str, Any]:
    """Run a case, and return its row and detail, or the reason of its failure with the traceback."""
    from heli_host.errors import HeliError

    try:
        row, detail = _row_and_detail(work, _import_function(work)(settings))
    except HeliError as error:
        return {"row": {}, "detail": None, "failure": str(error)}
    except Exception as error:  # noqa: BLE001 - an error of a case is a failure of this case only
        text = " ".join(f"{type(error).__name__}: {error}".split())
        return {"row": {}, "detail": {"traceback": traceback.format_exc()}, "failure": text}
    return {"row": row, "detail": detail, "failure": ""}


def _import_function(work: str) -> Callable[[Mapping[str, Any]], Any]:
    """Import the function `work`, given as ``package.module:function``."""
    from heli_lab.errors import CampaignError

    module, _, name = work.partition(":")
    function = getattr(importlib.import_module(module), name, None)
    if not callable(function):
        raise CampaignError(f"module {module} has no function {name}", "correct work = in the campaign file")
    imported: Callable[[Mapping[str, Any]], Any] = function
    return imported


def _row_and_detail(work: str, returned: Any) -> tuple[dict[str, Any], Any]:
    """Check the value that the function `work` has `returned`, and return it as row and detail; a
    CampaignError reports a value of another form.
    """
    from heli_lab.errors import CampaignError

    if not isinstance(returned, tuple) or len(returned) != 2:
        wrong_form = (
            f"{len(returned)} values" if isinstance(returned, tuple) else f"a {type(returned).__name__}"
        )
    elif not isinstance(returned[0], Mapping):
        wrong_form = f"a {type(returned[0]).__name__} for its row"
    elif not all(isinstance(column, str) for column in returned[0]):
        wrong_form = "a row with columns that are no texts"
    else:
        return dict(returned[0]), returned[1]
    raise CampaignError(
        f"{work} returned {wrong_form}",
        "return (row, detail): a dict by column, and anything that JSON holds",
    )


def _json_line(message: Mapping[str, Any]) -> bytes:
    """Return a reply as JSON; a result that JSON cannot hold becomes a failure of its case."""
    try:
        return json.dumps(message, default=_without_numpy_types).encode()
    except (TypeError, ValueError) as error:
        failed: dict[str, Any] = {"row": {}, "detail": None, "failure": f"its result is no JSON: {error}"}
        return json.dumps({**failed, "cpu_s": message["cpu_s"]}).encode()


def _without_numpy_types(value: Any) -> Any:
    """Convert numbers and arrays of numpy to those of Python."""
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} is no JSON")


def _cpu_limit() -> Callable[[float], None]:
    """Return a function that sets the CPU time of this process [s] at which the process is ended.

    The kernel counts the time if it can; otherwise, a thread does.
    """
    if not can_limit():
        return _cpu_limit_by_thread()
    limit_process("CORE", 0)
    return lambda until_s: limit_process("CPU", max(1, int(until_s) + 1))


def _cpu_limit_by_thread() -> Callable[[float], None]:
    """Return the same function as `_cpu_limit`, for a thread that watches the CPU time."""
    limit_s = math.inf

    def watch() -> None:
        """End the process when its CPU time reaches the limit."""
        while time.process_time() < limit_s:
            time.sleep(_WATCH_INTERVAL_s)
        os._exit(_CPU_LIMIT_STATUS)

    def set_limit(until_s: float) -> None:
        """Set the limit [s]."""
        nonlocal limit_s
        limit_s = until_s

    threading.Thread(target=watch, daemon=True).start()
    return set_limit


def _reserved_pipe(descriptor: int, mode: str) -> IO[bytes]:
    """Open standard input or output for jobs or replies only, and connect the `descriptor` to nothing.

    A case that reads or prints can then neither take a job nor disturb a reply.
    """
    pipe = os.fdopen(os.dup(descriptor), mode)
    null_device = os.open(os.devnull, os.O_RDWR)
    os.dup2(null_device, descriptor)
    os.close(null_device)
    return pipe


if __name__ == "__main__":
    # The worker handles Ctrl-C.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with _reserved_pipe(0, "rb") as jobs, _reserved_pipe(1, "wb") as replies:
        serve_jobs(jobs, replies)
