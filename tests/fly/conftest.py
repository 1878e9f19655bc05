"""Connected boards: one that is simulated in lockstep, and one behind a pseudo-terminal."""

from collections.abc import Iterator

import pytest
from heli_host.board.heli import Heli
from heli_host.fly.connection import connect

from tests.sil.harness import PATIENT


@pytest.fixture
def heli() -> Iterator[Heli]:
    with connect("sil://?seed=3") as heli:
        yield heli


@pytest.fixture
def heli_at_a_port() -> Iterator[Heli]:
    process = pytest.importorskip("heli_sim.sil.transport", reason="skipped: no simulation")
    with process.SilProcess(speed=None) as sil, connect(sil.url) as heli:
        heli.params.restore(PATIENT)
        yield heli
