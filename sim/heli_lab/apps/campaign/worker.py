"""Run the cases of a campaign on a Dask worker, each in a separate process.

A case that crashes, hangs or uses too much CPU time therefore ends neither the worker nor other cases, and
its reason is known. Modules of the user are imported in that process only, so that a running cluster never
uses an old version of them. Jobs and replies go through two pipes, one JSON text per line. The process ends
itself when its pipe of jobs is closed, so that it does not outlive its worker.
"""

from __future__ import annotations

import importlib
import json
import os
import queue
import signal
import socket
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import IO, Any, Final, Self

from heli_lab.apps.campaign.cases import Case, JobResult, Limits
from heli_lab.apps.campaign.store import read_result, write_result
from heli_lab.code_digest import code_digest
from heli_lab.errors import CampaignError

_THREAD_VARIABLES: Final = tuple(f"{name}_NUM_THREADS" for name in ("OMP", "OPENBLAS", "MKL"))
_RETRIES_AFTER_KILL: Final = 2
"""Number of times that a case is run again after its process was killed from outside. The system does so if
memory is short, and the next time there may be enough."""
_WATCH_INTERVAL_s: Final = 0.1
"""Time between two readings of a case's CPU time [s]."""


@dataclass(frozen=True)
class Job:
    """A case with everything that a worker needs to run it."""

    case: Case  # Case to run
    key: str  # Key under which the result is stored
    code: str  # Digest of the campaign's code
    work_functions: tuple[str, ...]  # Functions that the digest covers
    limits: Limits  # Limits of CPU time, time and threads
    cases: str  # Folder of the results
    token: str
    """Text of the file ``store.txt`` next to the folder `cases`. A worker that reads the same text there sees
    the same folder, and stores the result before it reports it."""
    modules: str = ""  # Folder of modules that are not installed


class CodeMismatchError(Exception):
    """The code of a worker differs from the campaign's; its arguments are the worker and the difference."""


def code_difference(code: str, work_functions: tuple[str, ...], modules: str = "") -> str:
    """Describe the difference between the code of this process and the campaign's; empty if there is none."""
    try:
        worker_code = code_digest(work_functions, modules)
    except ImportError as error:
        return str(error)
    return "" if worker_code == code else f"its code has the digest {worker_code}, the campaign's has {code}"


def run_job(job: Job) -> JobResult:
    """Run a case in a separate process, store its result, and return it."""
    # If the result is stored already, the case is not run again: a cluster that loses a worker submits its
    # cases a second time. If this worker can write to the folder of the results, it stores the result there
    # and returns the row of the table only.
    difference = code_difference(job.code, job.work_functions, job.modules)
    if difference:
        raise CodeMismatchError(worker_name(), difference)
    cases = Path(job.cases)
    # The file of this name proves that the folder is that of the campaign, and not one of the same path on
    # another machine.
    token_file = cases.with_name("store.txt")
    sees_store = token_file.is_file() and token_file.read_text() == job.token
    result = read_result(cases, job.key) if sees_store else None
    if result is None:
        result = replace(_process_of_thread(job).run(job.case, job.key), where=worker_name())
        if sees_store:
            write_result(cases, result)
    return replace(result, detail=None) if sees_store else result


def worker_name() -> str:
    """Return the name of this worker: its address in the cluster, or otherwise machine and process id."""
    from distributed import get_worker

    try:
        return str(get_worker().address)
    except ValueError:
        return f"{socket.gethostname()}:{os.getpid()}"


_processes: Final[dict[int, tuple[str, WorkerProcess]]] = {}
"""Process of each thread of this Dask worker with the digest of its code, by the thread's number."""


def _process_of_thread(job: Job) -> WorkerProcess:
    """Return the process of this thread, or a new one if its code, modules or threads are not the job's."""
    thread = threading.get_ident()
    code, process = _processes.get(thread, ("", None))  # ("", None): this thread has no process yet
    if (
        process is None
        or code != job.code
        or process.modules != job.modules
        or process.limits.threads != job.limits.threads
    ):
        if process is not None:
            process.close()
        process = WorkerProcess(job.limits, job.modules)
        _processes[thread] = job.code, process
    process.limits = job.limits
    return process


def release() -> None:
    """End the processes of this Dask worker that wait for cases."""
    for _, process in list(_processes.values()):
        if not process.is_busy:
            process.close()


class WorkerProcess:
    """Runs cases, one after the other, in a separate process. If a case ends the process, a new one is
    started.
    """

    def __init__(self, limits: Limits, modules: str = "") -> None:
        self.limits = limits
        self.modules = modules
        self.is_busy = False
        self._process: subprocess.Popen[bytes] | None = None
        self._replies: queue.SimpleQueue[bytes] = queue.SimpleQueue()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> int | None:
        """End the process, and return its exit status; None if there is no process."""
        process, self._process = self._process, None
        if process is None:
            return None
        with suppress(ProcessLookupError):
            process.kill()
        status = process.wait()
        with suppress(OSError):
            if process.stdin is not None:
                process.stdin.close()
        return status

    def run(self, case: Case, key: str) -> JobResult:
        """Run a case, whose result is stored under `key`; a failure is reported in the result."""
        started_s = time.monotonic()
        self.is_busy = True
        result = None
        for _ in range(1 + _RETRIES_AFTER_KILL):
            result = self._run_once(case, key)
            if result is not None:
                break
        self.is_busy = False
        if result is None:
            result = JobResult(case.name, key, failure="its process was killed from outside, again and again")
        return replace(result, seconds=time.monotonic() - started_s)

    def _run_once(self, case: Case, key: str) -> JobResult | None:
        """Run the case once; None if the process was killed from outside."""
        process = self._running_process()
        assert process.stdin is not None
        with suppress(OSError):
            process.stdin.write(json.dumps({"work": case.work, "settings": case.settings}).encode() + b"\n")
            process.stdin.flush()
        reply = self._wait_for_reply(process.pid)
        if isinstance(reply, JobResult):
            self.close()
            return replace(reply, name=case.name, key=key)
        if reply.endswith(b"\n"):
            content = json.loads(reply)
            return JobResult(
                case.name,
                key,
                row=content["row"],
                detail=content["detail"],
                failure=content["failure"],
                cpu_s=content["cpu_s"],
            )
        # The process has ended by itself, so that closing it only collects its status.
        process.wait()
        status = self.close() or 0
        name = signal.Signals(-status).name if status < 0 else ""
        if name in ("SIGKILL", "SIGTERM"):
            return None
        return JobResult(case.name, key, failure=f"its process crashed: {name or f'exit status {status}'}")

    def _wait_for_reply(self, pid: int) -> bytes | JobResult:
        """Wait for a line of the process; b"" if it ends, or a failure if the case exceeds its limits."""
        before_s, deadline_s = _cpu_s(pid), time.monotonic() + self.limits.wait_s
        while (remaining_s := deadline_s - time.monotonic()) > 0.0:
            with suppress(queue.Empty):
                return self._replies.get(timeout=min(_WATCH_INTERVAL_s, remaining_s))
            spent_s = _cpu_s(pid) - before_s
            if spent_s > self.limits.cpu_s:
                failure = f"the case used more than {self.limits.cpu_s:g} s of CPU"
                return JobResult("", "", failure=failure, cpu_s=spent_s)
        return JobResult("", "", failure=f"no answer within {self.limits.wait_s:g} s")

    def _running_process(self) -> subprocess.Popen[bytes]:
        """Return the process; start one if there is none, with a thread that reads its replies."""
        if self._process is not None and self._process.poll() is None:
            return self._process
        self.close()
        paths = [*sys.path, self.modules]
        environment = {
            **os.environ,
            **dict.fromkeys(_THREAD_VARIABLES, str(self.limits.threads)),
            "PYTHONPATH": os.pathsep.join(filter(None, paths)),
        }
        # multiprocessing does not work here: it refuses children of daemonic processes, which workers may be.
        self._process = process = subprocess.Popen(
            [sys.executable, "-m", "heli_lab.apps.campaign.worker"],
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        )
        self._replies = queue.SimpleQueue()
        # Windows cannot wait for a pipe with a time limit, so a thread reads the pipe.
        threading.Thread(target=_read_lines, args=(process.stdout, self._replies), daemon=True).start()
        # The first line reports that the process has started, whose CPU time is not that of a case.
        self._replies.get()
        return process


def _cpu_s(pid: int) -> float:
    """Return the CPU time of a process [s]; 0 if it has ended."""
    import psutil

    try:
        times = psutil.Process(pid).cpu_times()
    except psutil.Error:
        return 0.0
    return float(times.user + times.system)


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

    threading.Thread(target=read_jobs, daemon=True).start()
    replies.write(b"started\n")
    replies.flush()
    while True:
        job = json.loads(waiting.get())
        before_s = time.process_time()
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


def _reserved_pipe(descriptor: int, mode: str) -> IO[bytes]:
    """Open standard input or output for jobs or replies only, and connect the `descriptor` to nothing."""
    # A case that reads or prints can then neither take a job nor disturb a reply.
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
