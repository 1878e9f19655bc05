"""The flight code on a board with other numbers than the Due's."""

from __future__ import annotations

import numpy as np
import pytest
from heli_host import declaration as d
from heli_host.declaration import ParamsSource, Result
from heli_host.link.telemetry import TelemetryDecoder
from heli_test_native import link

from tests.flight.harness import DUTY_FULL, PAGE_BYTES, Harness

SUPPLY_V = 12.0
FRONT_V, BACK_V = 3.0, 1.5
SET_BYTES = 512
HOVER = next(spec.index for spec in d.PARAMS if spec.name == "hover_V")


def driven(duty_full: int) -> Harness:
    """A board of which the host streams voltages to the motors."""
    harness = Harness(duty_full=duty_full)
    harness.arm()
    harness.ask(d.StreamMessage(0))
    for _ in range(200):
        harness.send(d.VoltagesMessage(FRONT_V, BACK_V, 50))
        harness.tick(10)
    return harness


@pytest.mark.parametrize("duty_full", [255, 1000, DUTY_FULL, 4095, 10000])
def test_a_voltage_is_its_share_of_the_boards_own_full_duty(duty_full: int) -> None:
    harness = driven(duty_full)
    front, back, enabled = harness.motors
    assert enabled
    assert front == pytest.approx(duty_full * FRONT_V / SUPPLY_V, abs=0.5)
    assert back == pytest.approx(duty_full * BACK_V / SUPPLY_V, abs=0.5)


@pytest.mark.parametrize("duty_full", [255, 1000, 10000])
def test_the_voltage_logged_is_the_one_that_the_duty_makes(duty_full: int) -> None:
    harness = driven(duty_full)
    ticks = TelemetryDecoder().decode([f.payload for f in harness.frames if f.id == d.MessageId.TELEMETRY])
    channels = {channel.name: index for index, channel in enumerate(d.CHANNELS)}
    front, back, _ = harness.motors
    acted_mV = ticks.raw[-1, [channels["front"], channels["back"]]]
    assert np.abs(acted_mV - 1000 * SUPPLY_V * np.array([front, back]) / duty_full).max() <= 0.5


@pytest.mark.parametrize("duty_full", [255, 1000])
def test_no_duty_is_beyond_full(duty_full: int) -> None:
    harness = Harness(duty_full=duty_full)
    assert harness.set("motor_max_V", SUPPLY_V).result == Result.OK
    harness.arm()
    harness.ask(d.StreamMessage(0))
    for _ in range(200):
        harness.send(d.VoltagesMessage(SUPPLY_V, SUPPLY_V, 50))
        harness.tick(10)
    assert harness.motors == (duty_full, duty_full, True)


def saved(board: link.Board, hover_V: float) -> bool:
    params = link.Params()
    params.set(HOVER, hover_V, True)
    return link.Store(board).save(params)


@pytest.mark.parametrize("page_bytes", [PAGE_BYTES, 1024, 4096])
def test_parameters_are_kept_in_pages_of_any_length(page_bytes: int) -> None:
    board = link.Board(DUTY_FULL, page_bytes)
    assert len(board.flash) == 2 * page_bytes
    for hover_V in (2.0, 3.0, 4.0):
        assert saved(board, hover_V)
        params = link.Params()
        assert link.Store(board).load(params) == ParamsSource.STORED
        assert params.get(HOVER) == hover_V
    for page in (0, 1):
        behind = board.flash[page * page_bytes + SET_BYTES : (page + 1) * page_bytes]
        assert behind == b"\xff" * (page_bytes - SET_BYTES)
