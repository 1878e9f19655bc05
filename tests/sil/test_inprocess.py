"""In process the simulation is a transport like any other, and the same seed gives the same bytes."""

from __future__ import annotations

import pytest
from heli_host.errors import LinkLost, PortError
from heli_host.link.frames import FrameParser
from heli_host.link.transport import Transport, open_transport
from heli_sim.errors import OptionError, RigError
from heli_sim.sil.inprocess import InProcessTransport

from tests.sil.harness import hello_frame, world

pytestmark = pytest.mark.medium


def conversation(url: str, step_s: float = 0.02, until_s: float = 2.0) -> bytes:
    transport = open_transport(url)
    transport.write(hello_frame())
    received = b""
    while transport.now_s() < until_s:
        received += transport.read(step_s)
    return received


def test_heli_host_finds_the_simulation_by_its_address() -> None:
    transport = open_transport("sil://?seed=4")
    assert isinstance(transport, Transport)
    assert isinstance(transport, InProcessTransport)
    assert transport.lockstep
    assert transport.url == "sil://?seed=4"


def test_the_same_seed_gives_the_same_bytes() -> None:
    url = "sil://?seed=5&flip=1e-4&drop=1e-3&double=1e-3&stall=0.5:0.2"
    assert conversation(url) == conversation(url)
    assert len(conversation(url)) > 1000


def test_another_seed_gives_other_faults() -> None:
    assert conversation("sil://?seed=5&flip=1e-3") != conversation("sil://?seed=6&flip=1e-3")


def test_time_stands_still_between_reads_and_the_date_follows_it() -> None:
    transport = open_transport("sil://")
    assert (transport.now_s(), transport.now_s()) == (0.0, 0.0)
    start_ns = transport.wall_ns()
    transport.read(0.25)
    assert transport.now_s() == pytest.approx(0.25)
    assert transport.wall_ns() - start_ns == 250_000_000


def test_a_read_returns_when_bytes_come_but_not_before_its_slice() -> None:
    transport = open_transport("sil://?slice_ms=20")
    transport.write(hello_frame())
    received = transport.read(5.0)
    assert received
    assert 0.02 <= transport.now_s() < 0.1


def test_the_smallest_read_lets_a_millisecond_pass() -> None:
    transport = open_transport("sil://")
    transport.read(0.0)
    assert transport.now_s() == pytest.approx(0.001)


def test_frames_come_out_whole() -> None:
    parser = FrameParser()
    parser.feed(conversation("sil://?seed=1"))
    assert (parser.frames_bad, parser.bytes_dropped) == (0, 0)
    assert parser.frames_ok > 90


def test_a_closed_transport_is_lost() -> None:
    transport = open_transport("sil://")
    transport.close()
    transport.close()
    with pytest.raises(LinkLost):
        transport.read(0.1)
    with pytest.raises(LinkLost):
        transport.write(b"x")


def test_pulling_the_cable_loses_the_link_until_it_is_back_and_the_board_flies_on() -> None:
    flown = world(unplug="0.5:0.45")
    lost = InProcessTransport(flown)
    with pytest.raises(LinkLost):
        while True:
            lost.read(0.02)
    assert flown.tick == 500
    refused = 0
    while refused < 20:
        try:
            transport = lost.reopen()
            break
        except PortError:
            refused += 1
    assert refused == 5
    transport.write(hello_frame())
    assert transport.read(0.1)
    assert flown.board.sim.boots == 1


def test_opening_resets_the_board_when_asked_to() -> None:
    flown = world(reset_on_open="1")
    flown.advance(100)
    InProcessTransport(flown).read(0.3)
    assert flown.board.sim.boots == 2


@pytest.mark.parametrize(("url", "error"), [("sil://?rig=none", RigError), ("sil://?x=1", OptionError)])
def test_a_wrong_address_is_refused(url: str, error: type[Exception]) -> None:
    with pytest.raises(error):
        open_transport(url)
