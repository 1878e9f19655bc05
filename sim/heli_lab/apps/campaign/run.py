"""Run a campaign on Dask: on a cluster of this machine, or on a running one; continue an interrupted one."""

from __future__ import annotations

import logging
from collections.abc import Callable, Generator, Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from heli_host.errors import HeliError, install_remedy

from heli_lab.apps.campaign.cases import Campaign, Case, JobResult, natural_order
from heli_lab.apps.campaign.store import Store, row_of
from heli_lab.apps.campaign.worker import CodeMismatchError, Job, code_difference, release, run_job
from heli_lab.code_digest import code_digest
from heli_lab.errors import CampaignError

if TYPE_CHECKING:
    from distributed import Client, Future

LOOPBACK: Final = "127.0.0.1:0"
"""Address of Dask's HTTP server. Without one, it listens on every interface, even if its dashboard is off
(measured with version 2026.8)."""
CONNECT_s: Final = 10.0
"""Longest wait for an answer of the scheduler [s]."""
FIRST_WORKER_s: Final = 60.0
"""Longest wait for the first worker of a cluster [s]; a batch system may still be starting its workers."""
_NO_WORKER_REMEDY: Final = "install this version of heli-host on the workers, and start them again"


@dataclass(frozen=True)
class CampaignProgress:
    """Progress of a campaign, after each case."""

    ended: int
    """ended, failed, cases: Number of cases that have ended, of those among them that failed, and of all
    cases."""
    failed: int
    cases: int
    newest: JobResult | None = None  # The case that has just ended; None at the beginning
    note: str = ""
    """A problem that is not a failed case, such as a worker that cannot be used; otherwise empty."""


def run_campaign(
    campaign: Campaign,
    store: Store,
    *,
    scheduler: str | None = None,
    processes: int = 1,
    code: str | None = None,
    is_repeated: Callable[[JobResult], bool] | None = None,
    on_progress: Callable[[CampaignProgress], None] | None = None,
) -> list[dict[str, Any]]:
    """Run all cases that have no result yet, and write the table of all cases.

    Parameters
    ----------
    campaign : Campaign
        Cases and their limits.
    store : Store
        Folder of results. Cases with a stored result of the same code are not run again.
    scheduler : str, optional
        Address of a Dask scheduler; without it, the cases run on this machine.
    processes : int
        Number of cases that run in parallel on this machine.
    code : str, optional
        Digest of the code, if results do not depend on the code of the installed packages.
    is_repeated : callable, optional
        Takes a stored result, and returns whether the case is run again.
    on_progress : callable, optional
        Called with the progress of the campaign after each case.

    Returns
    -------
    list of dict
        Rows of the table, by column, in the order of the cases' names.

    Raises
    ------
    CampaignError
        When the cluster cannot be used, or stops before all cases have ended. All results up to then are
        stored.
    """
    rows: dict[str, dict[str, Any]] = {}
    with closing(_run(campaign, store, rows, scheduler, processes, code, is_repeated)) as states:
        for state in states:
            if on_progress is not None:
                on_progress(state)
    return sorted(rows.values(), key=lambda row: natural_order(str(row["case"])))


def campaign_results(
    campaign: Campaign,
    store: Store,
    *,
    scheduler: str | None = None,
    processes: int = 1,
    code: str | None = None,
    is_repeated: Callable[[JobResult], bool] | None = None,
) -> Iterator[JobResult]:
    """Run a campaign, and yield the result of each case as soon as the case has ended.

    Cases whose result was stored before are not yielded.

    Parameters
    ----------
    campaign, store, scheduler, processes, code, is_repeated
        See `run_campaign`.

    Raises
    ------
    CampaignError
        When the cluster cannot be used, or stops before all cases have ended. All results up to then are
        stored.
    """
    with closing(_run(campaign, store, {}, scheduler, processes, code, is_repeated)) as states:
        for state in states:
            if state.newest is not None:
                # A worker that can write to the store leaves the details there, and reports the row only.
                yield store.read([state.newest.key]).get(state.newest.key, state.newest)


def _run(
    campaign: Campaign,
    store: Store,
    rows: dict[str, dict[str, Any]],
    scheduler: str | None,
    processes: int,
    code: str | None,
    is_repeated: Callable[[JobResult], bool] | None,
) -> Generator[CampaignProgress, None, None]:
    """Run the cases without a result, add the row of each case to `rows`, and yield the progress."""
    # `digest` is part of the keys of stored results; `worker_code` is the code that all workers must have.
    if code is None:
        digest = worker_code = _code_digest_of(campaign)
        work_functions = campaign.work_functions
    else:
        # Results do not depend on the code of the functions, but all workers need the same packages.
        digest, worker_code, work_functions = code, code_digest(), ()
    cases = {case.key(digest): case for case in campaign.cases}
    with store.locked():
        stored = store.read(cases)
        repeated = [key for key, result in stored.items() if is_repeated is not None and is_repeated(result)]
        store.remove(repeated)
        rows |= {key: _row(cases[key], result) for key, result in stored.items() if key not in repeated}
        failed = sum(bool(row["failure"]) for row in rows.values())
        jobs = [
            Job(
                case=case,
                key=key,
                code=worker_code,
                work_functions=work_functions,
                limits=campaign.limits,
                cases=str(store.cases.resolve()),
                token=store.token,
                modules=campaign.modules,
            )
            for key, case in cases.items()
            if key not in rows
        ]
        yield CampaignProgress(len(rows), failed, len(cases))
        try:
            for result, note in _run_jobs(jobs, scheduler, processes):
                if result is not None:
                    store.write(result)
                    rows[result.key] = _row(cases[result.key], result)
                    failed += bool(result.failure)
                yield CampaignProgress(len(rows), failed, len(cases), result, note)
        finally:
            if rows:
                store.write_table(rows.values())


def _code_digest_of(campaign: Campaign) -> str:
    """Compute the digest of the code that runs the cases; a CampaignError reports a missing module."""
    try:
        return code_digest(campaign.work_functions, campaign.modules)
    except ImportError as error:
        raise CampaignError(
            f"work = {', '.join(campaign.work_functions)}: {error}",
            "put the module into the folder of the campaign file, or install it",
        ) from None


def _row(case: Case, result: JobResult) -> dict[str, Any]:
    """Return the row of a case in the table; for a failed case, with the drawn values too."""
    row: dict[str, Any] = row_of(case, result)
    if result.failure:
        # Imported here, because a campaign with other functions does not need the simulation.
        from heli_lab.apps.campaign.works import WORKS, drawn_row

        if case.work in WORKS.values():
            with suppress(HeliError, OSError):
                row |= drawn_row(case.settings)
    return row


def _run_jobs(
    jobs: list[Job], scheduler: str | None, processes: int
) -> Iterator[tuple[JobResult | None, str]]:
    """Run the jobs, and yield each result as it arrives, or None with a note on a worker."""
    if not jobs:
        return
    with _client(scheduler, min(processes, len(jobs))) as client:
        # Code, functions and modules are the same in all jobs.
        code, work_functions, modules = jobs[0].code, jobs[0].work_functions, jobs[0].modules
        replies = client.run(code_difference, code, work_functions, modules, on_error="return")
        unusable = {address for address, reply in replies.items() if reply}
        for address in sorted(unusable):
            reply = replies[address]
            why = _one_line(reply) if isinstance(reply, BaseException) else reply
            yield None, f"worker {address} is not used: {why}"
        if len(unusable) == len(replies):
            raise CampaignError("no worker has this code", _NO_WORKER_REMEDY)
        try:
            yield from _run_on_workers(client, jobs, unusable)
        finally:
            with suppress(Exception):
                client.run(release, on_error="return")


def _run_on_workers(
    client: Client, jobs: list[Job], unusable: set[str]
) -> Iterator[tuple[JobResult | None, str]]:
    """Run jobs on a cluster, and yield results as `_run_jobs`; Dask submits those of lost workers again."""
    # A worker that joins late may have other code: its job is submitted again to the others.
    from distributed import KilledWorker, as_completed

    def submit(job: Job) -> Future[Any]:
        """Submit a job to the usable workers."""
        # If no worker is usable, any worker may take the job and then reports that its code differs. A job
        # without a worker would wait forever.
        workers = None
        if unusable:
            workers = [worker for worker in client.scheduler_info()["workers"] if worker not in unusable]
        # Not pure: Dask must not share the result with another campaign that has other limits.
        return client.submit(
            run_job, job, pure=False, workers=workers or None, allow_other_workers=bool(workers)
        )

    job_of_task = {submit(job): job for job in jobs}
    completed = as_completed(job_of_task)
    ended = 0
    for task in completed:
        job = job_of_task.pop(task)
        if task.cancelled():
            raise CampaignError(
                f"the scheduler has stopped: {ended} of {len(jobs)} cases have ended in this run and are "
                "saved",
                "run the same command again to continue with the others",
            )
        note, failure, result = "", "", None
        try:
            result = task.result()
        except CodeMismatchError as mismatch:
            worker, difference = mismatch.args
            note = "" if worker in unusable else f"worker {worker} is not used: {difference}"
            unusable.add(worker)
            if not note and not {*client.scheduler_info()["workers"]} - unusable:
                raise CampaignError("no worker is left that has this code", _NO_WORKER_REMEDY) from None
            second_task = submit(job)
            job_of_task[second_task] = job
            completed.add(second_task)
        except KilledWorker:
            failure = "worker after worker was lost under it"
        except Exception as error:  # noqa: BLE001 - whatever a worker raises belongs to the case
            failure = f"its worker failed: {_one_line(error)}"
        if failure:
            result = JobResult(job.case.name, job.key, failure=failure)
        ended += result is not None
        if result is not None or note:
            yield result, note


def _one_line(error: BaseException) -> str:
    """Describe an error in one line."""
    return " ".join(f"{type(error).__name__}: {error}".split())


@contextmanager
def _client(scheduler: str | None, processes: int) -> Iterator[Client]:
    """Connect to a cluster, or start one on this machine, until the block ends."""
    try:
        import dask
        import distributed
    except ImportError as error:
        raise CampaignError(f"a campaign needs {error.name}", install_remedy("campaign")) from None
    # Dask logs each lost worker; the campaign reports those that matter.
    logging.getLogger(distributed.__name__).setLevel(logging.CRITICAL)
    settings: dict[str, Any] = {
        "distributed.comm.timeouts.connect": f"{CONNECT_s:g}s",
        "distributed.admin.tick.limit": "1h",
        "distributed.worker.memory.terminate": False,
        # A campaign does not need these pages, and other users of this machine must not see them.
        "distributed.scheduler.http.routes": [],
        "distributed.worker.http.routes": [],
    }
    with dask.config.set(settings):
        connected = _local_client(processes) if scheduler is None else _cluster_client(scheduler)
        with connected as client:
            yield client


@contextmanager
def _local_client(processes: int) -> Iterator[Client]:
    """Start a cluster in this process, with one thread per parallel case; each thread waits for a process."""
    from distributed import Client, LocalCluster

    with (
        LocalCluster(
            n_workers=1,
            threads_per_worker=processes,
            processes=False,
            dashboard_address=LOOPBACK,
            worker_dashboard_address=LOOPBACK,
            scheduler_kwargs={"dashboard": False},
            memory_limit=0,
        ) as cluster,
        Client(cluster) as client,
    ):
        yield client


@contextmanager
def _cluster_client(scheduler: str) -> Iterator[Client]:
    """Connect to the running cluster at the address `scheduler`, and wait for its first worker."""
    from distributed import Client

    try:
        client = Client(scheduler, timeout=CONNECT_s)
    except (OSError, ValueError, TimeoutError):
        raise CampaignError(
            f"no scheduler answers at {scheduler}",
            "start one (dask scheduler), or leave out --scheduler to use this machine",
        ) from None
    try:
        try:
            client.wait_for_workers(1, timeout=FIRST_WORKER_s)
        except TimeoutError:
            raise CampaignError(
                f"the scheduler at {scheduler} has no workers", f"start at least one: dask worker {scheduler}"
            ) from None
        yield client
    finally:
        with suppress(OSError, TimeoutError):
            client.close(timeout=CONNECT_s)
