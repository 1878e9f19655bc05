"""Run a case on a Dask worker, which first compares its code with the campaign's, and stores the result."""

from __future__ import annotations

import os
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path

from heli_lab.apps.campaign.case import Case, JobResult
from heli_lab.apps.campaign.store import read_result, write_result
from heli_lab.apps.campaign.worker_process import Limits, WorkerProcess
from heli_lab.code_digest import code_digest


@dataclass(frozen=True)
class Job:
    """A case with everything that a worker needs to run it."""

    case: Case  # Case to run
    key: str  # Key under which the result is stored
    code: str  # Digest of the campaign's code
    works: tuple[str, ...]  # Functions that the digest covers
    limits: Limits  # Limits of CPU time, time and threads
    cases: str  # Folder of the results
    token: str
    """Text of the file ``store.txt`` next to the folder `cases`. A worker that reads the same text there sees
    the same folder, and stores the result before it reports it."""
    modules: str = ""  # Folder of modules that are not installed


@dataclass(frozen=True)
class CodeMismatch:
    """Reply of a worker whose code differs from the campaign's."""

    where: str  # Name of the worker
    why: str  # The difference, in one line


@dataclass
class _IdleProcesses:
    """Processes of this worker that wait for a case. A case borrows one of them, or starts a new one."""

    idle: list[WorkerProcess] = field(default_factory=list)  # The processes
    lock: threading.Lock = field(default_factory=threading.Lock)
    """Held while the list changes, because a worker runs several cases in parallel."""

    @contextmanager
    def borrowed(self, limits: Limits, modules: str) -> Iterator[WorkerProcess]:
        """Lend a process with these `modules` and as many threads as in `limits`, until the block ends."""
        process = self._take_idle(limits, modules) or WorkerProcess(limits, modules)
        process.limits = limits
        try:
            yield process
        finally:
            with self.lock:
                self.idle.append(process)

    def _take_idle(self, limits: Limits, modules: str) -> WorkerProcess | None:
        """Remove a suitable process from the list, and return it; None if there is none."""
        with self.lock:
            for process in self.idle:
                if process.limits.threads == limits.threads and process.modules == modules:
                    self.idle.remove(process)
                    return process
        return None

    def close(self) -> None:
        """End all processes."""
        with self.lock:
            for process in self.idle:
                process.close()
            self.idle.clear()


@cache
def _idle_processes() -> _IdleProcesses:
    """Return the idle processes of this worker; there is one list per Python process."""
    return _IdleProcesses()


def worker_name() -> str:
    """Return the name of this worker: its address in the cluster, or otherwise machine and process id."""
    from distributed import get_worker

    try:
        return str(get_worker().address)
    except ValueError:
        return f"{socket.gethostname()}:{os.getpid()}"


def code_difference(code: str, works: tuple[str, ...], modules: str = "") -> str:
    """Describe the difference between the code of this process and the campaign's; empty if there is none."""
    try:
        worker_code = code_digest(works, modules)
    except ImportError as error:
        return str(error)
    return "" if worker_code == code else f"its code has the digest {worker_code}, the campaign's has {code}"


def run_job(job: Job) -> JobResult | CodeMismatch:
    """Run a case in a separate process, store its result, and return it.

    If the result is stored already, the case is not run again: a cluster that loses a worker submits its
    cases a second time. If this worker can write to the folder of the results, it stores the result there and
    returns the row of the table only.
    """
    why = code_difference(job.code, job.works, job.modules)
    if why:
        return CodeMismatch(worker_name(), why)
    cases = Path(job.cases)
    token_file = cases.with_name("store.txt")
    sees_store = token_file.is_file() and token_file.read_text() == job.token
    result = read_result(cases, job.key) if sees_store else None
    if result is None:
        with _idle_processes().borrowed(job.limits, job.modules) as process:
            result = replace(process.run(job.case, job.key), where=worker_name())
        if sees_store:
            write_result(cases, result)
    return replace(result, detail=None) if sees_store else result


def release() -> None:
    """End the processes that wait for cases."""
    _idle_processes().close()
