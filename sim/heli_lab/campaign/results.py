"""Results of a campaign, one after the other as its cases end."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterator

from heli_lab.campaign.campaign import Campaign
from heli_lab.campaign.case import JobResult
from heli_lab.campaign.run import State, run_campaign
from heli_lab.campaign.store import Store


def campaign_results(
    campaign: Campaign,
    store: Store,
    *,
    scheduler: str | None = None,
    processes: int = 1,
    code: str | None = None,
    again: Callable[[JobResult], bool] | None = None,
) -> Iterator[JobResult]:
    """Run a campaign in a thread, and yield the result of each case that ends now, with its details.

    Parameters
    ----------
    campaign, store, scheduler, processes, code, again
        See `run_campaign`.

    Raises
    ------
    CampaignError
        When the cluster cannot be used, or is gone before all cases have ended; all results so far stay
        stored.
    """
    results: queue.SimpleQueue[JobResult | BaseException | None] = queue.SimpleQueue()

    def report(state: State) -> None:
        if state.newest is not None:
            results.put(state.newest)

    def run() -> None:
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
        except BaseException as error:  # noqa: BLE001 - raised again where it is waited for
            results.put(error)

    threading.Thread(target=run, daemon=True).start()
    while (result := results.get()) is not None:
        if isinstance(result, BaseException):
            raise result
        # A worker that sees the store leaves the details there.
        yield store.read([result.key]).get(result.key, result)
