"""A page's server over a simulated board in real time behind a port, as `heli-host dashboard --sil`."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import heli_host
from heli_host.board.heli import Heli
from heli_host.board.law_program import LawProgram
from heli_host.fly.plan import Plan, load_plan, plan_names
from heli_host.fly.recorder import Recorder
from heli_host.ui.page.cockpit import Cockpit
from heli_host.ui.page.serve import Address, serving
from heli_host.ui.page.source import outline

from tests.sil.harness import SOON_HOLDING

RIG = "makki2024"
SHORT_PLAN = """
title = "Hover for two seconds"
[start]
elevation_deg = 0
rate_deg_s = 15
settle_s = 1
[[segment]]
kind = "hold"
duration_s = 2
"""


@dataclass(frozen=True)
class Served:
    """A running server: its client, its address and the folder of its logs."""

    heli: Heli
    address: Address
    folder: Path

    def logs(self) -> list[Path]:
        return sorted(self.folder.glob("*.mcap"))


@contextlib.contextmanager
def page_of_a_simulated_board(
    folder: Path, speed: float = 1.0, board: str = "native", laws: Sequence[LawProgram] = ()
) -> Iterator[Served]:
    """Serve a page in this process."""
    short = Plan.parse(SHORT_PLAN, "short")
    url = f"sil://?rig={RIG}&seed=1&speed={speed}&process=1&board={board}"
    with heli_host.connect(url) as heli:

        def new_recorder(plans: Sequence[Plan], duration_s: float) -> Recorder:
            path = folder / f"{len(list(folder.glob('*.mcap')))}.mcap"
            return Recorder(heli, path, rig_name=RIG, plans=plans, duration_s=duration_s)

        plans = [short, *(load_plan(name) for name in plan_names())]
        rig = outline(RIG)
        cockpit = Cockpit(heli, new_recorder, plans, "simulated board", rig, laws=laws, rig_name=RIG)
        try:
            with serving(cockpit) as address:
                yield Served(heli, address, folder)
        finally:
            cockpit.close()


@contextlib.contextmanager
def patient_page(folder: Path, laws: Sequence[LawProgram] = ()) -> Iterator[Served]:
    """Serve a page of a board that waits longer for its pilot than it does by default: a machine that stalls
    for a second must not end what a test flies."""
    with page_of_a_simulated_board(folder, laws=laws) as served:
        served.heli.params.restore(SOON_HOLDING)
        yield served


@contextlib.contextmanager
def page_process(*arguments: str, folder: Path) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """Run ``heli-host dashboard`` as a person does; yields the process and the page's address."""
    command = [sys.executable, "-c", "from heli_host.ui.cli import main; main()", "dashboard", *arguments]
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=folder, env={**os.environ}
    )
    try:
        assert process.stdout is not None
        lines = []
        for line in process.stdout:
            lines.append(line)
            if line.startswith("page: "):
                yield process, line.split()[1]
                break
        else:
            raise AssertionError("".join(lines))
    finally:
        process.kill()
        process.wait()
        if process.stdout is not None:
            process.stdout.close()
