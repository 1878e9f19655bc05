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
class _Cages:
    """Idle processes of this worker."""

    idle: list[WorkerProcess] = field(default_factory=list)
    lock: threading.Lock = field(default_factory=threading.Lock)

    @contextmanager
    def one(self, limits: Limits, modules: str) -> Iterator[WorkerProcess]:
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
        cage = fit or WorkerProcess(limits, modules)
        cage.limits = limits
        try:
            yield cage
        finally:
            with self.lock:
                self.idle.append(cage)

    def close(self) -> None:
        with self.lock:
            for cage in self.idle:
                cage.close()
            self.idle.clear()


@cache
def _cages() -> _Cages:
    return _Cages()


def here() -> str:
    """Name this worker: its address in the cluster, or machine and process id outside of one."""
    from distributed import get_worker

    try:
        return str(get_worker().address)
    except ValueError:
        return f"{socket.gethostname()}:{os.getpid()}"


def other_code(code: str, works: tuple[str, ...], modules: str = "") -> str:
    """Say how the code of this process differs from that of digest `code`, which covers the functions
    `works`, also of modules in the folder `modules`; empty where it is the same.
    """
    try:
        worker_code = code_digest(works, modules)
    except ImportError as error:
        return str(error)
    return "" if worker_code == code else f"its code has the digest {worker_code}, the campaign's has {code}"


def run_job(order: Job) -> JobResult | CodeMismatch:
    """Run a case in a separate process, and store its result.

    A result that is there already is taken: a cluster that has lost the worker which held it asks again.
    Where this worker sees the folder of the results, only the row travels.
    """
    why = other_code(order.code, order.works, order.modules)
    if why:
        return CodeMismatch(here(), why)
    cases = Path(order.cases)
    mark = cases.with_name("store.txt")
    seen = mark.is_file() and mark.read_text() == order.token
    answer = kept(cases, order.key) if seen else None
    if answer is None:
        with _cages().one(order.limits, order.modules) as cage:
            answer = replace(cage.run(order.case, order.key), where=here())
        if seen:
            keep(cases, answer)
    return replace(answer, detail=None) if seen else answer


def release() -> None:
    """End the processes that wait for cases."""
    _cages().close()
