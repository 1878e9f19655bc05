"""A campaign of its own: ``python -m tests.campaign.driver FOLDER LOG CASES NAP_S [ADDRESS]``."""

from __future__ import annotations

import sys
from pathlib import Path

from heli_lab.apps.campaign import Campaign, Case, Store, run_campaign
from heli_lab.apps.campaign.worker_process import Limits

CODE = "the code of a test"


def gate_of(log: str | Path) -> Path:
    """File that the last case waits for: no campaign ends before a test wants that."""
    return Path(f"{log}.gate")


def cases(count: int, nap_s: float, log: str) -> tuple[Case, ...]:
    work = "tests.campaign.works:count"
    gates = [*("" for _ in range(count - 1)), str(gate_of(log))]
    settings = [
        {"number": number, "nap_s": nap_s, "log": log, "gate": gate} for number, gate in enumerate(gates)
    ]
    return tuple(Case(f"case {values['number']:03d}", work, values) for values in settings)


def main(folder: str, log: str, count: str, nap_s: str, address: str | None = None) -> None:
    campaign = Campaign("squares", cases(int(count), float(nap_s), log), Limits(30.0, 300.0))
    run_campaign(campaign, Store(Path(folder)), scheduler=address, processes=2, code=CODE)


if __name__ == "__main__":
    main(*sys.argv[1:])
