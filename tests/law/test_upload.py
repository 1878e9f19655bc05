"""A law gets to the board whole or not at all, stays there, and comes again after a reset."""

from __future__ import annotations

from pathlib import Path

import heli_host
import pytest
from heli_host.board.law_flight import PART_WORDS, loaded
from heli_host.board.law_program import LawProgram
from heli_host.declaration import (
    LINK_HASH,
    Channel,
    Flags,
    HelloMessage,
    LawBeginMessage,
    LawEndMessage,
    LawMessage,
    LawPartMessage,
    LawReadMessage,
    LawState,
    MessageId,
)
from heli_host.link.telemetry import Ticks
from heli_lab.law import Command, Law, control_law
from heli_sim.sil.inprocess import InProcessTransport

from tests.law.flown import law_of
from tests.link.core_harness import Harness, open_harness, payloads_of

LAWS = Path(__file__).resolve().parents[2] / "docs" / "laws"


def small(name: str, gain: float) -> Law:
    @control_law(name=name)
    def law(now, state, parameter):  # type: ignore[no-untyped-def]
        return Command(gain * now.pitch_rad + 1.0, 1.0)

    return law


def upload_frames(harness: Harness, program: LawProgram, request: int) -> list[bytes]:
    """Frames of an upload, in order."""
    words = program.words
    frames = [harness.frame(LawBeginMessage(request, program.hash, len(words)))]
    for first in range(0, len(words), PART_WORDS):
        part = [*words[first : first + PART_WORDS], *([0] * PART_WORDS)][:PART_WORDS]
        frames.append(harness.frame(LawPartMessage(request + len(frames), first, *part)))
    frames.append(harness.frame(LawEndMessage(request + len(frames))))
    return frames


def law_on(harness: Harness) -> LawMessage:
    """The board's report of its law to a host that has just reconnected."""
    # Half a frame swallows what follows it, as on a line; a host greets until it is answered.
    hello = HelloMessage(240, LINK_HASH, 2)
    greeted = any(
        payloads_of(harness.turn(harness.frame(hello), ticks=2), MessageId.WELCOME) for _ in range(9)
    )
    assert greeted
    (payload,) = payloads_of(harness.ask(LawReadMessage(241)), MessageId.LAW)
    return LawMessage.unpack(payload)


def test_an_upload_cut_at_every_byte_leaves_the_old_law_or_none() -> None:
    old, new = small("old", 0.5).program, small("new", 0.25).program
    byte_count = len(b"".join(upload_frames(open_harness(), new, 50)))
    observed = set()
    for cut in range(byte_count + 1):
        harness = open_harness()
        for frame in upload_frames(harness, old, 1):
            harness.turn(frame, ticks=2)
        remaining_bytes = cut
        for frame in upload_frames(harness, new, 50):
            harness.turn(frame[:remaining_bytes], ticks=2)
            remaining_bytes = max(0, remaining_bytes - len(frame))
        law = law_on(harness)
        if law.state == LawState.READY:
            assert law.hash == (new.hash if cut == byte_count else old.hash), cut
        else:
            assert law.state in (LawState.NONE, LawState.RECEIVING), cut
            assert cut < byte_count
        observed.add((law.state, law.hash if law.state == LawState.READY else 0))
    assert observed >= {(LawState.READY, old.hash), (LawState.READY, new.hash), (LawState.RECEIVING, 0)}


@pytest.mark.medium
def test_a_board_that_was_reset_gets_its_law_again_when_it_is_armed() -> None:
    law = law_of(LAWS / "lqr.py")
    with heli_host.connect("sil://") as heli:
        heli.load_law(law.program)
        transport = heli.session.transport
        assert isinstance(transport, InProcessTransport)
        transport.world.cycle_power()
        assert heli.session.wait_for(lambda: heli.counters.restarts > 0, 8.0)
        assert loaded(heli.session).state == LawState.NONE
        heli.take_off()
        assert loaded(heli.session).hash == law.program.hash
        assert loaded(heli.session).state == LawState.READY


@pytest.mark.medium
def test_a_cable_that_was_out_costs_no_law() -> None:
    law = law_of(LAWS / "lqr.py")
    with heli_host.connect("sil://?unplug=2:1") as heli:
        heli.load_law(law.program)
        heli.session.wait_for(lambda: heli.counters.reconnects > 0, 8.0)
        assert heli.counters.reconnects == 1
        assert loaded(heli.session).hash == law.program.hash


@pytest.mark.medium
def test_from_the_beginning_of_an_upload_to_a_voltage_of_the_law_it_takes_half_a_second_at_most() -> None:
    law = law_of(LAWS / "lqg.py")
    with heli_host.connect("sil://") as heli:
        heli.take_off()
        start = heli.latest.tick
        acting: list[int] = []

        def look(new: Ticks) -> None:
            flown = new.raw[:, Channel.FLAGS] & Flags.LAW
            acting.extend(new.tick[flown != 0].tolist())

        heli.session.subscribe_ticks(look)
        heli.fly_law(law.program, duration_s=0.1)
        assert 0 < acting[0] - start <= 500
