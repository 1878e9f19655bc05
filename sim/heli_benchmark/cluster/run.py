"""Cases of a run on a Dask cluster, by the campaign engine of the laboratory."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

from heli_benchmark.entries.case_process import WALL_FACTOR, RunLimits, run_case
from heli_benchmark.entries.method import MethodAddress, find_method
from heli_benchmark.errors import BenchmarkError

_WORK: Final = "heli_benchmark.cluster.run:answer_case"
_MARGIN_s: Final = 60.0
"""Time for which the engine waits longer than the limit of a case, so that the case reports its end."""


def answer_case(settings: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Answer a case on a worker, in a process with limits."""
    method = find_method(settings["method"])
    if method.digest != settings["digest"]:
        raise BenchmarkError(f"{method.file} differs on this worker", "install the same version there")
    resources = None if settings["resources"] is None else Path(settings["resources"])
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "result.json"
        result = run_case(method, settings["case"], resources, RunLimits(**settings["limits"]), file)
    return {"answered": not result["failure"]}, result


def run_on_cluster(
    scheduler: str,
    method: MethodAddress,
    cases: Sequence[Path],
    resources: Path | None,
    limits: RunLimits,
) -> Iterator[tuple[str, dict[str, Any]]]:
    """Run a method on cases, and yield the name and the result of each case that ends.

    `method`: File and function, which every worker must see under the same path.
    """
    if not cases:
        return
    # Only a run on a cluster needs Dask.
    from heli_lab.apps.campaign import Campaign, Case, Store, campaign_results
    from heli_lab.apps.campaign.cases import Limits

    settings = {
        "method": method.text,
        "digest": method.digest,
        "resources": None if resources is None else str(resources.resolve()),
        "limits": asdict(limits),
    }
    campaign = Campaign(
        "benchmark",
        tuple(Case(case.name, _WORK, {"case": str(case.resolve()), **settings}) for case in cases),
        Limits(wait_s=WALL_FACTOR * limits.cpu_s + _MARGIN_s),
    )
    with tempfile.TemporaryDirectory() as folder:
        for result in campaign_results(campaign, Store(Path(folder)), scheduler=scheduler):
            unanswered = {"answer": None, "failure": result.failure, "cpu_s": None, "peak_MB": None}
            yield result.name, unanswered if result.failure else result.detail
