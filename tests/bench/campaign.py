"""Gain of a campaign by a second worker, and cost of the campaign itself."""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

from heli_lab.apps.campaign import Campaign, Case, Store, run_campaign
from heli_lab.apps.campaign.cases import Limits

from tests.bench.result import Measured
from tests.running.alone import spent_s

CASES, NAP_s = 200, 0.1
"""Cases that wait and use no core: what is measured is the campaign and not how many cores are free."""


def measure() -> list[Measured]:
    """Do two hundred cases with one worker, then with two."""
    taken_s, spent = [], []
    for processes in (1, 2):
        cases = tuple(
            Case(f"{number}", "tests.campaign.works:count", {"number": number, "nap_s": NAP_s})
            for number in range(CASES)
        )
        with tempfile.TemporaryDirectory() as folder:
            start_s, before_s = time.perf_counter(), spent_s()
            run_campaign(
                Campaign("naps", cases, Limits(60.0, 600.0)), Store(Path(folder)), processes=processes
            )
            taken_s.append(time.perf_counter() - start_s)
            spent.append((spent_s() - before_s) / CASES)
    return [
        Measured("campaign_two_workers_ratio", [taken_s[0] / taken_s[1]]),
        Measured("campaign_case_overhead_cpu_ms", [1e3 * cpu_s for cpu_s in spent]),
    ]
