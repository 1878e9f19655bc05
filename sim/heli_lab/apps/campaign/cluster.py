"""Connect to the workers of a campaign: a running Dask cluster, or a cluster on this machine."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any, Final

from heli_host.errors import install_remedy

from heli_lab.apps.campaign.worker import code_difference
from heli_lab.errors import CampaignError

if TYPE_CHECKING:
    from distributed import Client

LOOPBACK: Final = "127.0.0.1:0"
"""Address of Dask's HTTP server. Without one, it listens on every interface, even if its dashboard is off
(measured with version 2026.8)."""
CONNECT_s: Final = 10.0
"""Longest wait for an answer of the scheduler [s]."""
FIRST_WORKER_s: Final = 60.0
"""Longest wait for the first worker of a cluster [s]; a batch system may still be starting its workers."""


@contextmanager
def campaign_client(scheduler: str | None, processes: int) -> Iterator[Client]:
    """Connect to a cluster, or start one on this machine, until the block ends."""
    try:
        import dask
        import distributed
    except ImportError as error:
        raise CampaignError(f"a campaign needs {error.name}", install_remedy("campaign")) from None
    # Dask logs each lost worker; the campaign reports those that matter.
    logging.getLogger(distributed.__name__).setLevel(logging.CRITICAL)
    settings: dict[str, Any] = {
        "distributed.scheduler.allowed-failures": 1000,
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
    """Start a cluster in this process, with one thread per parallel case.

    Each thread only waits for a separate process that runs the case.
    """
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


def workers_by_code(
    client: Client, code: str, works: tuple[str, ...], modules: str = ""
) -> tuple[list[str], dict[str, str]]:
    """Sort the workers of a cluster by whether their code is that of the campaign. Returns `usable_workers`,
    `unusable`.
    """
    replies = client.run(code_difference, code, works, modules, on_error="return")
    unusable = {}
    for address, reply in replies.items():
        if isinstance(reply, BaseException):
            unusable[address] = " ".join(f"{type(reply).__name__}: {reply}".split())
        elif reply:
            unusable[address] = reply
    return [address for address in replies if address not in unusable], unusable
