"""A case on a Dask worker: the worker checks that it may run the case, runs it, and stores the result."""

from __future__ import annotations

import os
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path

from heli_lab.campaign.case import Case, JobResult
from heli_lab.campaign.store import keep, kept
from heli_lab.campaign.worker_process import Limits, WorkerProcess
from heli_lab.code_digest import code_digest


@dataclass(frozen=True)
class Job:
    """A case on its way to a worker.

    Parameters
    ----------
    key : str
        Key under which the result is stored.
    code : str
        Digest of the code that the campaign was begun with.
    works : tuple of str
        Functions that the digest covers.
    cases : str
        Folder of the results.
    token : str
        Text of the file ``store.txt`` next to the folder `cases`. A worker that reads the same text there
        sees the same folder, and stores the result before it reports it.
    modules : str
        Folder of modules that are not installed.
    """

    case: Case
    key: str
    code: str
    works: tuple[str, ...]
    limits: Limits
    cases: str
    token: str
    modules: str = ""


@dataclass(frozen=True)
class CodeMismatch:
    """A worker, `where`, whose code differs from the campaign's; `why` states the difference in one line."""

    where: str
    why: str


@dataclass
class _IdleProcesses:
    """Idle processes of this worker."""

    idle: list[WorkerProcess] = field(default_factory=list)
    lock: threading.Lock = field(default_factory=threading.Lock)

    @contextmanager
    def borrowed(self, limits: Limits, modules: str) -> Iterator[WorkerProcess]:
        with self.lock:
            wanted = (limits.threads, modules)
            fit = next(
                (
                    idle_process
                    for idle_process in self.idle
                    if (idle_process.limits.threads, idle_process.modules) == wanted
                ),
                None,
            )
            if fit is not None:
                self.idle.remove(fit)
        process = fit or WorkerProcess(limits, modules)
        process.limits = limits
        try:
            yield process
        finally:
            with self.lock:
                self.idle.append(process)

    def close(self) -> None:
        with self.lock:
            for process in self.idle:
                process.close()
            self.idle.clear()


@cache
def _idle_processes() -> _IdleProcesses:
    return _IdleProcesses()


def here() -> str:
    """Return the name of this worker: its address in the cluster, or otherwise machine and process id."""
    from distributed import get_worker

    try:
        return str(get_worker().address)
    except ValueError:
        return f"{socket.gethostname()}:{os.getpid()}"


def other_code(code: str, works: tuple[str, ...], modules: str = "") -> str:
    """Return how the code of this process differs from the campaign's, in one line; empty if it is the same.
    The digest `code` covers the functions `works`, also those of modules in the folder `modules`.
    """
    try:
        worker_code = code_digest(works, modules)
    except ImportError as error:
        return str(error)
    return "" if worker_code == code else f"its code has the digest {worker_code}, the campaign's has {code}"


def run_job(job: Job) -> JobResult | CodeMismatch:
    """Run a case in a separate process, and store its result.

    A stored result is returned without a run, because a cluster that lost a worker asks again. If this worker
    sees the folder of the results, it returns the row of the table only.
    """
    why = other_code(job.code, job.works, job.modules)
    if why:
        return CodeMismatch(here(), why)
    cases = Path(job.cases)
    mark = cases.with_name("store.txt")
    seen = mark.is_file() and mark.read_text() == job.token
    result = kept(cases, job.key) if seen else None
    if result is None:
        with _idle_processes().borrowed(job.limits, job.modules) as process:
            result = replace(process.run(job.case, job.key), where=here())
        if seen:
            keep(cases, result)
    return replace(result, detail=None) if seen else result


def release() -> None:
    """End the processes that wait for cases."""
    _idle_processes().close()
