"""Iterate over the results of a campaign while it runs."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterator

from heli_lab.apps.campaign.campaign import Campaign
from heli_lab.apps.campaign.case import JobResult
from heli_lab.apps.campaign.run import CampaignProgress, run_campaign
from heli_lab.apps.campaign.store import Store


def campaign_results(
    campaign: Campaign,
    store: Store,
    *,
    scheduler: str | None = None,
    processes: int = 1,
    code: str | None = None,
    again: Callable[[JobResult], bool] | None = None,
) -> Iterator[JobResult]:
    """Run a campaign in a thread, and yield the result of each case as soon as the case has ended.

    Cases whose result was stored before are not yielded.

    Parameters
    ----------
    campaign, store, scheduler, processes, code, again
        See `run_campaign`.

    Raises
    ------
    CampaignError
        When the cluster cannot be used, or stops before all cases have ended. All results up to then are
        stored.
    """
    results: queue.SimpleQueue[JobResult | BaseException | None] = queue.SimpleQueue()

    def report(progress: CampaignProgress) -> None:
        """Pass on the result of the case that has just ended."""
        if progress.newest is not None:
            results.put(progress.newest)

    def run() -> None:
        """Run the campaign, and end the results by None or by an error."""
        try:
            run_campaign(
                campaign,
                store,
                scheduler=scheduler,
                processes=processes,
                code=code,
                again=again,
                on_progress=report,
            )
            results.put(None)
        except BaseException as error:  # noqa: BLE001 - raised again below, in the thread of the caller
            results.put(error)

    threading.Thread(target=run, daemon=True).start()
    while (result := results.get()) is not None:
        if isinstance(result, BaseException):
            raise result
        # A worker that can write to the store leaves the details there, and reports the row only.
        yield store.read([result.key]).get(result.key, result)
