"""Run a campaign, or continue one that was interrupted."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from heli_host.errors import HeliError

from heli_lab.apps.campaign.campaign import Campaign
from heli_lab.apps.campaign.case import Case, Cell, JobResult, natural_order
from heli_lab.apps.campaign.cluster import campaign_client, workers_by_code
from heli_lab.apps.campaign.store import Store, row_of
from heli_lab.apps.campaign.worker import CodeMismatch, Job, release, run_job
from heli_lab.code_digest import code_digest
from heli_lab.errors import CampaignError

if TYPE_CHECKING:
    from distributed import Client, Future

_FLUSH_s: Final = 5.0
"""Time between two parts of the table [s]. Shorter: many small files. Longer: after a kill, more rows are
made again from the JSON files; nothing is lost."""
_MAX_LOST_WORKERS: Final = 20
"""If a case has lost so many workers, it fails."""
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
    again: Callable[[JobResult], bool] | None = None,
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
    again : callable, optional
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
    report = on_progress or (lambda _: None)
    digest = _code_digest_of(campaign) if code is None else code
    cases = {case.key(digest): case for case in campaign.cases}
    with store.locked():
        rows = _stored_rows(store, cases, again)
        failed = sum(bool(row.get("failure")) for row in rows.values())
        report(CampaignProgress(len(rows), failed, len(cases)))
        # Even if results do not depend on the installed code, all workers need the same packages.
        works, worker_code = (campaign.works, digest) if code is None else ((), code_digest())
        open_cases = {key: case for key, case in cases.items() if key not in rows}
        jobs = _jobs(campaign, store, open_cases, works, worker_code)
        # Rows that are not in the table yet.
        unwritten: list[dict[str, Cell]] = []
        written_s = time.monotonic()
        try:
            for result, note in _run_jobs(jobs, scheduler, processes):
                if result is None:
                    report(CampaignProgress(len(rows), failed, len(cases), note=note))
                    continue
                store.write(result)
                rows[result.key] = _table_row(cases[result.key], result)
                unwritten.append(rows[result.key])
                failed += bool(result.failure)
                if time.monotonic() - written_s > _FLUSH_s:
                    store.append(unwritten)
                    unwritten, written_s = [], time.monotonic()
                report(CampaignProgress(len(rows), failed, len(cases), newest=result))
        finally:
            store.append(unwritten)
        store.write_table(rows.values())
    return sorted(rows.values(), key=lambda row: natural_order(str(row["case"])))


def _jobs(
    campaign: Campaign, store: Store, cases: dict[str, Case], works: tuple[str, ...], code: str
) -> dict[str, Job]:
    """Make the jobs of the `cases`, by key, for workers whose functions `works` have the digest `code`."""
    return {
        key: Job(
            case=case,
            key=key,
            code=code,
            works=works,
            limits=campaign.limits,
            cases=str(store.cases.resolve()),
            token=store.token,
            modules=campaign.modules,
        )
        for key, case in cases.items()
    }


def _code_digest_of(campaign: Campaign) -> str:
    """Compute the digest of the code that runs the cases; a CampaignError reports a missing module."""
    try:
        return code_digest(campaign.works, campaign.modules)
    except ImportError as error:
        raise CampaignError(
            f"work = {', '.join(campaign.works)}: {error}",
            "put the module into the folder of the campaign file, or install it",
        ) from None


def _table_row(case: Case, result: JobResult) -> dict[str, Cell]:
    """Return the row of a case in the table; for a failed case, with the drawn values too."""
    row = row_of(case, result)
    if result.failure:
        # Imported here, because a campaign with other functions does not need the simulation.
        from heli_lab.apps.campaign.works import WORKS, drawn_row

        if case.work in WORKS.values():
            with suppress(HeliError, OSError):
                row |= drawn_row(case.settings)
    return row


def _stored_rows(
    store: Store, cases: dict[str, Case], again: Callable[[JobResult], bool] | None
) -> dict[str, dict[str, Any]]:
    """Return the rows of the cases that have a stored result, by key, and add missing ones to the table.

    Results of cases that are run again, as in `run_campaign`, are removed from the store.
    """
    stored = store.read(cases)
    if again is not None:
        store.remove(key for key, result in stored.items() if again(result))
        stored = {key: result for key, result in stored.items() if not again(result)}
    rows: dict[str, dict[str, Any]] = {key: _table_row(cases[key], result) for key, result in stored.items()}
    keys_in_table = {row["key"] for row in store.rows()}
    store.append([row for key, row in rows.items() if key not in keys_in_table])
    return rows


def _run_jobs(
    jobs: dict[str, Job], scheduler: str | None, processes: int
) -> Iterator[tuple[JobResult | None, str]]:
    """Run the jobs, and yield each result as it arrives, or None with a note on a worker."""
    if not jobs:
        return
    # Code, functions and modules are the same in all jobs.
    any_job = next(iter(jobs.values()))
    with campaign_client(scheduler, min(processes, len(jobs))) as client:
        usable_workers, unusable = workers_by_code(client, any_job.code, any_job.works, any_job.modules)
        for address, why in unusable.items():
            yield None, f"worker {address} is not used: {why}"
        if not usable_workers:
            raise CampaignError("no worker has this code", _NO_WORKER_REMEDY)
        try:
            yield from _run_on_workers(client, jobs, set(unusable))
        finally:
            with suppress(Exception):
                client.run(release, on_error="return")


def _run_on_workers(
    client: Client, jobs: dict[str, Job], unusable: set[str]
) -> Iterator[tuple[JobResult | None, str]]:
    """Run jobs on a cluster. A job whose worker is lost, or has other code, is submitted again. Returns
    `result`, `note`.
    """
    from distributed import as_completed

    def submit(job: Job) -> Future[Any]:
        """Submit a job to the usable workers.

        If no worker is usable, any worker may take the job and then reports that its code differs. A job
        without a worker would wait forever.
        """
        workers = None
        if unusable:
            workers = [worker for worker in client.scheduler_info()["workers"] if worker not in unusable]
        # Not pure: Dask must not share the result with another campaign that has other limits.
        return client.submit(
            run_job, job, pure=False, workers=workers or None, allow_other_workers=bool(workers)
        )

    tasks = {submit(job): job for job in jobs.values()}
    lost_workers: Counter[str] = Counter()
    ended_count = 0
    completed = as_completed(tasks)
    for future in completed:
        job = tasks.pop(future)
        if future.cancelled():
            raise CampaignError(
                f"the scheduler has stopped: {ended_count} of {len(jobs)} cases have ended in this run and "
                "are saved",
                "run the same command again to continue with the others",
            )
        result = _result_of_task(future, job, lost_workers)
        if isinstance(result, JobResult):
            ended_count += 1
            yield result, ""
            continue
        if result is not None:
            is_new = result.where not in unusable
            unusable.add(result.where)
            if is_new:
                yield None, f"worker {result.where} is not used: {result.why}"
            elif not {*client.scheduler_info()["workers"]} - unusable:
                raise CampaignError("no worker is left that has this code", _NO_WORKER_REMEDY)
        task = submit(job)
        tasks[task] = job
        completed.add(task)


def _result_of_task(
    future: Future[Any], job: Job, lost_workers: Counter[str]
) -> JobResult | CodeMismatch | None:
    """Return the result of a task; None if its worker was lost and another worker should run the job."""
    from distributed import KilledWorker

    try:
        result: JobResult | CodeMismatch = future.result()
    except KilledWorker:
        lost_workers[job.key] += 1
        if lost_workers[job.key] < _MAX_LOST_WORKERS:
            return None
        return JobResult(job.case.name, job.key, failure="worker after worker was lost under it")
    except Exception as error:  # noqa: BLE001 - whatever a worker raises belongs to the case
        text = " ".join(f"{type(error).__name__}: {error}".split())
        return JobResult(job.case.name, job.key, failure=f"its worker failed: {text}")
    return result
