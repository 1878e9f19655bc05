"""The host's protocol without a port: frames, telemetry against a slow witness, clock, events, any bytes."""

import math
import random
from dataclasses import replace

import numpy as np
import pytest
from heli_host import declaration as d
from heli_host.link.channels import declared
from heli_host.link.clock import ClockEstimate, ClockFit
from heli_host.link.events import LinkEvent, event_text
from heli_host.link.frames import Frame, FrameParser, encode_frame
from heli_host.link.session import Session
from heli_host.link.telemetry import (
    CHANNEL_COUNT,
    EMPTY_TICKS,
    MissedEvents,
    TelemetryDecoder,
    TickAccount,
    Ticks,
    insert_missed,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.channels.groups import row_of
from tests.link import host_reference as reference
from tests.link.fake_board import FakeBoard, FakeLine
from tests.link.fuzz_host import fuzz_host
from tests.running.long import samples

payloads = st.binary(max_size=d.MAX_TELEMETRY_PAYLOAD)
ids = st.integers(128, 255)


@pytest.mark.medium
@given(ids, st.integers(0, 1000), payloads)
def test_a_frame_is_what_the_slow_witness_makes(message_id: int, seq: int, payload: bytes) -> None:
    assert encode_frame(message_id, seq, payload) == reference.frame(message_id, seq, payload)


@pytest.mark.medium
@given(st.lists(st.tuples(ids, payloads), max_size=20), st.data())
def test_frames_survive_any_chopping_of_the_stream(
    messages: list[tuple[int, bytes]], data: st.DataObject
) -> None:
    stream = b"".join(
        encode_frame(message_id, seq, payload) for seq, (message_id, payload) in enumerate(messages)
    )
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=30)))
    parser = FrameParser()
    frames = []
    for start, end in zip([0, *cuts], [*cuts, len(stream)], strict=True):
        frames += parser.feed(stream[start:end])
    assert frames == [Frame(message_id, seq, payload) for seq, (message_id, payload) in enumerate(messages)]
    assert (parser.frames_ok, parser.frames_bad, parser.frames_lost) == (len(messages), 0, 0)
    assert parser.bytes_dropped == 0
    assert parser.bytes_received == len(stream)


@pytest.mark.medium
@given(st.binary(max_size=2000), st.binary(max_size=40))
def test_after_any_garbage_the_parser_is_in_step_at_the_next_delimiter(
    garbage: bytes, payload: bytes
) -> None:
    parser = FrameParser()
    parser.feed(garbage)
    parser.feed(b"\0")
    assert parser.feed(encode_frame(200, 3, payload))[-1:] == [Frame(200, 3, payload)]


@pytest.mark.medium
@given(st.binary(min_size=1, max_size=3000))
def test_every_byte_of_a_stream_is_in_a_frame_or_counted_as_dropped(garbage: bytes) -> None:
    parser = FrameParser()
    kept = sum(len(frame.payload) + 8 for frame in parser.feed(garbage + b"\0"))
    assert kept + parser.bytes_dropped + (garbage + b"\0").count(0) == len(garbage) + 1
    assert parser.excerpt == b"" or garbage.replace(b"\0", b"").endswith(parser.excerpt)


def test_a_missing_frame_is_counted_as_lost_and_a_repeated_one_is_not() -> None:
    parser = FrameParser()
    frames = [encode_frame(134, seq, b"") for seq in range(250, 270)]
    parser.feed(frames[0] + frames[1] + frames[1] + frames[5] + frames[6])
    assert (parser.frames_ok, parser.frames_lost, parser.frames_repeated) == (5, 3, 1)


def test_a_restart_of_the_other_end_is_not_a_loss() -> None:
    parser = FrameParser()
    parser.feed(encode_frame(134, 77, b""))
    parser.restart_sequence()
    parser.feed(encode_frame(134, 0, b""))
    assert parser.frames_lost == 0


def test_joining_in_the_middle_of_a_frame_is_no_bad_frame() -> None:
    parser = FrameParser()
    frames = parser.feed(encode_frame(133, 1, b"tail of this")[5:] + encode_frame(133, 2, b"whole"))
    assert [frame.payload for frame in frames] == [b"whole"]
    assert parser.frames_bad == 0
    assert parser.bytes_dropped > 0


def test_a_stream_without_delimiters_takes_bounded_memory_and_is_dropped() -> None:
    parser = FrameParser()
    for _ in range(100):
        assert parser.feed(b"\x55" * 1000) == []
        assert len(parser.pending) <= 1000
    parser.feed(b"\0")
    assert parser.bytes_dropped == 100_000
    assert [f.seq for f in parser.feed(encode_frame(134, 9, b""))] == [9]


def test_another_protocol_version_is_refused() -> None:
    plain = bytes([d.PROTOCOL + 1, 130, 0])
    frame = reference.cobs_encode(plain + reference.crc32(plain).to_bytes(4, "little")) + b"\0"
    parser = FrameParser()
    assert parser.feed(b"\0" + frame) == []
    assert parser.frames_bad == 1


def test_a_payload_longer_than_the_board_takes_is_refused_before_it_is_sent() -> None:
    with pytest.raises(ValueError, match=str(d.MAX_COMMAND_PAYLOAD)):
        encode_frame(1, 0, bytes(d.MAX_COMMAND_PAYLOAD + 1))
    with pytest.raises(ValueError, match=str(d.MAX_TELEMETRY_PAYLOAD)):
        encode_frame(133, 0, bytes(d.MAX_TELEMETRY_PAYLOAD + 1))


@pytest.mark.parametrize(("message_id", "size"), [(1, d.MAX_COMMAND_PAYLOAD), (133, d.MAX_TELEMETRY_PAYLOAD)])
def test_the_longest_payload_passes(message_id: int, size: int) -> None:
    payload = bytes(k % 251 for k in range(size))
    assert [frame.payload for frame in FrameParser().feed(encode_frame(message_id, 0, payload))] == [payload]


@pytest.mark.medium
@pytest.mark.parametrize("damage", ["flip", "drop", "double"])
def test_no_damaged_frame_passes_and_every_loss_is_counted(damage: str) -> None:
    chance = random.Random(7)
    sent_values = [
        bytes(chance.randrange(256) for _ in range(chance.randrange(10, 200))) for _ in range(3000)
    ]
    # 3 in 10^3 bytes: some thirty times worse than what the link must stand, so that much is tried.
    stream = bytearray()
    for byte in b"".join(encode_frame(133, seq, payload) for seq, payload in enumerate(sent_values)):
        hit = chance.random() < 3e-3
        if hit and damage == "flip":
            stream.append(byte ^ (1 << chance.randrange(8)))
        elif hit and damage == "double":
            stream += bytes([byte, byte])
        elif not hit:
            stream.append(byte)
    parser = FrameParser()
    frames = parser.feed(b"\0" + bytes(stream) + encode_frame(133, len(sent_values), b"last"))
    remaining = iter(enumerate(sent_values))
    for frame in frames[:-1]:
        assert any(seq % 256 == frame.seq and payload == frame.payload for seq, payload in remaining)
    assert frames[-1].payload == b"last"
    assert parser.frames_bad > 0
    assert parser.frames_ok + parser.frames_lost == len(sent_values) + 1


Batch = tuple[int, list[list[int]]]

CODES = {"u8": "<B", "u16": "<H", "u32": "<I", "i16": "<h", "i32": "<i"}


@st.composite
def batches(draw: st.DrawFn, types: list[str] = reference.TYPES) -> Batch:
    """A first tick and 1 to 32 samples; each channel still, slow, or anything that its type holds."""
    # Samples follow from a drawn seed: to draw each by itself takes fifty times as long as to decode it.
    count = draw(st.integers(1, 32))
    walk = random.Random(draw(st.integers(0, 2**32 - 1)))
    columns = []
    for wire_type in types:
        low, high = reference.limits(wire_type)
        reach = draw(st.sampled_from([0, 1, 3, 60, 10_000, 2**32]))
        value = draw(st.integers(low, high))
        column = [value]
        for _ in range(count - 1):
            value = walk.randint(max(low, value - reach), min(high, value + reach))
            column.append(value)
        columns.append(column)
    return draw(st.integers(0, 2**32 - 33)), [list(row) for row in zip(*columns, strict=True)]


@pytest.mark.slow
@settings(max_examples=samples(200, 40))
@given(st.lists(batches(), max_size=5))
def test_any_batches_decode_to_what_was_packed(sent: list[Batch]) -> None:
    ticks = TelemetryDecoder().decode([reference.telemetry_payload(first, rows) for first, rows in sent])
    assert ticks.tick.dtype == np.uint32
    assert ticks.raw.dtype == np.int32
    assert ticks.tick.tolist() == [first + k for first, rows in sent for k in range(len(rows))]
    assert ticks.raw.tolist() == [row for _, rows in sent for row in rows]


def channels_of_types(types: list[str]) -> list[d.ChannelSpec]:
    """Channels of these types, one after the other."""
    return [
        replace(d.CHANNELS[0], name=f"channel_{number}", code=CODES[wire_type])
        for number, wire_type in enumerate(types)
    ]


@pytest.mark.slow
@settings(max_examples=samples(200, 40))
@given(st.lists(st.sampled_from([*CODES]), min_size=1, max_size=16), st.data())
def test_channels_of_any_type_may_stand_anywhere(types: list[str], data: st.DataObject) -> None:
    sent = data.draw(st.lists(batches(types), min_size=1, max_size=3))
    payloads = [reference.telemetry_payload(first, rows, types=types) for first, rows in sent]
    decoder = TelemetryDecoder(channels_of_types(types))
    assert decoder.decode(payloads).raw.tolist() == [row for _, rows in sent for row in rows]
    assert decoder.malformed == 0


@pytest.mark.slow
@settings(max_examples=samples(200, 40))
@given(batches(), st.data())
def test_wider_deltas_than_needed_decode_alike(sent: Batch, data: st.DataObject) -> None:
    first, rows = sent
    narrow = reference.telemetry_payload(first, rows)
    # Behind first tick and count: a code of four bits for the width of each channel's differences.
    widths = narrow[5 : 5 + (len(d.CHANNELS) + 1) // 2]
    codes = [nibble for byte in widths for nibble in (byte % 16, byte // 16)][: len(d.CHANNELS)]
    wide = [data.draw(st.integers(code, 5)) for code in codes]
    assert TelemetryDecoder().decode([reference.telemetry_payload(first, rows, wide)]).raw.tolist() == rows


@pytest.mark.slow
@given(batches(), st.binary(min_size=1, max_size=8), st.booleans())
def test_a_payload_whose_length_does_not_fit_is_refused_and_counted(
    sent: Batch, extra: bytes, longer: bool
) -> None:
    payload = reference.telemetry_payload(*sent)
    decoder = TelemetryDecoder()
    assert len(decoder.decode([payload + extra if longer else payload[: -len(extra)]])) == 0
    assert decoder.malformed == 1


@pytest.mark.medium
@given(st.binary(max_size=480))
def test_any_payload_decodes_like_the_witness_or_is_refused(payload: bytes) -> None:
    decoder = TelemetryDecoder()
    ticks = decoder.decode([payload])
    if decoder.malformed:
        assert ticks.tick.tolist() == []
    else:
        assert ticks.raw.tolist() == reference.telemetry_samples(payload)[1]


def test_a_malformed_payload_does_not_spoil_its_neighbours() -> None:
    rows = [[k * (c + 1) for c in range(len(d.CHANNELS))] for k in range(20)]
    good = reference.telemetry_payload(100, rows)
    later = reference.telemetry_payload(120, rows)
    bad_width = bytes([*good[:5], 0x66, *good[6:]])
    no_samples = bytes([*good[:4], 0, *good[5:]])
    decoder = TelemetryDecoder()
    ticks = decoder.decode([good, bad_width, good[:-1], b"", no_samples, later])
    assert ticks.tick.tolist() == list(range(100, 140))
    assert ticks.raw.tolist() == rows + rows
    assert decoder.malformed == 4


def test_the_last_tick_before_the_counter_wraps_is_followed_by_zero() -> None:
    ticks = TelemetryDecoder().decode([reference.telemetry_payload(2**32 - 2, [[0] * len(d.CHANNELS)] * 4)])
    assert ticks.tick.tolist() == [2**32 - 2, 2**32 - 1, 0, 1]


@pytest.mark.medium
def test_hundreds_of_batches_of_changing_size_keep_their_order() -> None:
    sent_values = []
    first = 0
    for index in range(600):
        count = 20 if index % 50 else 5 + index % 7
        columns = range(3, 3 + len(d.CHANNELS))
        sent_values.append((first, [[(first + k) * c % 250 for c in columns] for k in range(count)]))
        first += count
    ticks = TelemetryDecoder().decode([reference.telemetry_payload(*batch) for batch in sent_values])
    assert ticks.tick.tolist() == list(range(first))
    assert ticks.raw.tolist() == [row for _, rows in sent_values for row in rows]


def test_no_payloads_are_no_ticks() -> None:
    assert TelemetryDecoder().decode([]) is EMPTY_TICKS


def arrivals(
    fit: ClockFit,
    *,
    ticks: range,
    tick_s: float = 1e-3,
    start_s: float = 100.0,
    quickest_s: float = 0.0,
    late_s: float = 0.02,
) -> None:
    """Batches of 20 ticks, each late by a length of time that only chance knows."""
    chance = random.Random(3)
    for tick in ticks[::20]:
        fit.observe(tick, start_s + tick * tick_s + quickest_s + late_s * chance.random() ** 2)


def estimated(fit: ClockFit) -> ClockEstimate:
    estimate = fit.estimate()
    assert estimate is not None
    return estimate


def test_nothing_seen_is_no_estimate() -> None:
    assert ClockFit().estimate() is None


@pytest.mark.parametrize("drift_ppm", [-80.0, 0.0, 50.0])
def test_offset_and_drift_are_found_below_late_arrivals(drift_ppm: float) -> None:
    fit = ClockFit()
    tick_s = 1e-3 / (1.0 + drift_ppm * 1e-6)
    arrivals(fit, ticks=range(60_000), tick_s=tick_s)
    estimate = estimated(fit)
    assert estimate.host_s_at(60_000) == pytest.approx(100.0 + 60_000 * tick_s, abs=1e-3)
    assert estimate.drift_ppm == pytest.approx(drift_ppm, abs=15.0)
    assert estimate.tick_at(estimate.host_s_at(12_345.0)) == pytest.approx(12_345.0, abs=1e-3)
    assert 0.01 < estimate.jitter_s < 0.021


def test_half_of_the_shortest_round_trip_is_taken_off() -> None:
    fit = ClockFit()
    for second in range(30):
        tick = 1000 * second
        asked_s = 100.0 + tick * 1e-3 - 0.002
        fit.observe_pong(asked_s, tick, asked_s + 0.004)
        arrivals(fit, ticks=range(tick + 20, tick + 1000), quickest_s=0.006)
    estimate = estimated(fit)
    assert estimate.round_trip_s == pytest.approx(0.004)
    assert estimate.host_s_at(29_000) == pytest.approx(129.0, abs=1e-3)


@pytest.mark.parametrize("speed", [0.2, 5.0, 50.0])
def test_a_simulation_at_any_speed_is_followed(speed: float) -> None:
    fit = ClockFit()
    arrivals(fit, ticks=range(30_000), tick_s=1e-3 / speed, late_s=0.01 / speed)
    assert estimated(fit).rate == pytest.approx(speed, rel=1e-3)


def test_a_pause_of_the_device_is_forgotten_within_three_seconds() -> None:
    fit = ClockFit()
    arrivals(fit, ticks=range(30_000))
    arrivals(fit, ticks=range(30_000, 33_000), start_s=101.5)
    assert estimated(fit).host_s_at(33_000) == pytest.approx(134.5, abs=3e-3)


def test_a_change_of_speed_is_followed() -> None:
    fit = ClockFit()
    arrivals(fit, ticks=range(20_000))
    arrivals(
        fit, ticks=range(20_000, 80_000), start_s=100.0 + 20.0 - 20_000 * 1e-4, tick_s=1e-4, late_s=0.002
    )
    estimate = estimated(fit)
    assert estimate.rate == pytest.approx(10.0, rel=0.02)
    assert estimate.host_s_at(80_000) == pytest.approx(126.0, abs=0.01)


def test_one_arrival_gives_an_offset_at_the_nominal_rate() -> None:
    fit = ClockFit()
    fit.observe(500, 7.0)
    assert estimated(fit).host_s_at(1500) == pytest.approx(8.0)


def test_a_reset_forgets() -> None:
    fit = ClockFit()
    arrivals(fit, ticks=range(5000))
    fit.reset()
    assert fit.estimate() is None


def ticks_of(*numbers: int) -> Ticks:
    tick = np.array([number % 2**32 for number in numbers], np.uint32)
    return Ticks(tick, np.arange(len(numbers) * len(d.Channel), dtype=np.int32).reshape(-1, len(d.Channel)))


def test_consecutive_ticks_are_received_and_none_lost() -> None:
    account = TickAccount()
    account.take(ticks_of(7, 8, 9))
    account.take(ticks_of(10, 11))
    assert (account.received, account.lost, account.last) == (5, 0, 11)


def test_gaps_between_and_within_readings_are_lost() -> None:
    account = TickAccount()
    account.take(ticks_of(7, 8, 12))
    accepted, jumped = account.take(ticks_of(20, 21))
    assert (account.received, account.lost, account.last) == (5, 3 + 7, 21)
    assert (len(accepted), jumped) == (2, False)


def test_ticks_are_counted_on_when_32_bits_run_out() -> None:
    account = TickAccount()
    account.take(ticks_of(2**32 - 2, 2**32 - 1, 2**32, 2**32 + 3))
    assert (account.received, account.lost, account.last) == (4, 2, 2**32 + 3)
    assert account.unwrap(5) == 2**32 + 5
    assert account.unwrap(2**32 - 1) == 2**32 - 1


def test_a_jump_back_ends_what_is_accepted() -> None:
    account = TickAccount()
    accepted, jumped = account.take(ticks_of(100, 101, 3, 4))
    assert jumped
    assert accepted.tick.tolist() == [100, 101]
    accepted, jumped = account.take(ticks_of(101, 102))
    assert jumped
    assert len(accepted) == 0
    assert (account.received, account.lost) == (2, 0)
    account.restart()
    account.take(ticks_of(3, 4))
    assert (account.received, account.lost, account.last) == (4, 0, 4)


def ticks(first: int, *rows: tuple[d.State, d.Trigger] | tuple[d.State, d.Trigger, d.Fault]) -> Ticks:
    raw = np.zeros((len(rows), CHANNEL_COUNT), np.int32)
    for row, (state, trigger, *fault) in zip(raw, rows, strict=True):
        row[d.Channel.STATE], row[d.Channel.TRIGGER], row[d.Channel.FAULT] = state, trigger, sum(fault)
    return Ticks(np.arange(first, first + len(rows)).astype(np.uint32), raw)


FLYING = (d.State.CLOSED_LOOP, d.Trigger.CLOSE_LOOP)
HOLDING = (d.State.HOLD, d.Trigger.STALE_HOLD)
LANDING = (d.State.LANDING, d.Trigger.STALE_LAND)
LANDED = (d.State.IDLE, d.Trigger.STALE_LAND)
TRIPPED = (d.State.FAULT, d.Trigger.TRIP, d.Fault.PITCH_LIMIT)


def event(tick: int, state: d.State, cause: d.Trigger) -> d.EventMessage:
    return d.EventMessage(tick=tick, kind=d.Event.STATE, detail=state, cause=cause, value=0.0)


def watching(*flown: tuple[d.State, d.Trigger]) -> MissedEvents:
    missed = MissedEvents()
    assert missed.take_ticks(ticks(100, *flown)) == []
    return missed


def test_the_first_samples_report_no_change() -> None:
    assert watching(LANDING, LANDING).take_ticks(ticks(102, LANDING)) == []


def test_a_change_with_a_lost_event_is_reported_with_trigger_and_tick() -> None:
    missed = watching(FLYING)
    events = missed.take_ticks(ticks(101, FLYING, HOLDING, HOLDING, LANDING))
    assert events == [
        event(102, d.State.HOLD, d.Trigger.STALE_HOLD),
        event(104, d.State.LANDING, d.Trigger.STALE_LAND),
    ]
    assert missed.take_ticks(ticks(105, LANDING, LANDING)) == []


def link_event(tick: int, message: d.EventMessage | None) -> LinkEvent:
    return LinkEvent(tick, 0, "any", "", message)


@pytest.mark.parametrize("base", [1000, 2**32 - 150], ids=["usual", "counter overflows"])
def test_a_reconstructed_event_stands_after_earlier_and_before_later_ones(base: int) -> None:
    earlier, lost, later = ((base + ticks) % 2**32 for ticks in (0, 100, 200))
    events = [
        link_event(earlier, event(earlier, *FLYING)),
        # An event of the link has no tick of its own.
        link_event(later, None),
        link_event(later, event(later, *LANDING)),
    ]
    insert_missed(event(lost, *HOLDING), wall_ns=5, events=events)
    assert [entry.tick for entry in events] == [earlier, later, lost, later]
    assert events[2].message == event(lost, *HOLDING) and events[2].wall_ns == 5
    insert_missed(event((later + 1) % 2**32, *LANDED), wall_ns=5, events=events)
    assert events[-1].message == event((later + 1) % 2**32, *LANDED)


def test_a_change_that_an_event_reported_is_not_reported_again() -> None:
    missed = watching(FLYING)
    missed.take_event(event(102, d.State.HOLD, d.Trigger.STALE_HOLD))
    assert missed.take_ticks(ticks(101, FLYING, HOLDING, LANDING)) == [
        event(103, d.State.LANDING, d.Trigger.STALE_LAND)
    ]


def test_an_event_within_a_gap_of_the_telemetry_counts_and_one_from_before_it_does_not() -> None:
    for tick, missing in ((101, 0), (900, 0), (1000, 0), (100, 1), (1001, 1)):
        missed = watching(FLYING)
        missed.take_event(event(tick, d.State.HOLD, d.Trigger.STALE_HOLD))
        assert len(missed.take_ticks(ticks(1000, HOLDING))) == missing, tick


def test_an_unseen_landing_is_reported_with_its_cause() -> None:
    missed = watching(FLYING)
    assert missed.take_ticks(ticks(9000, LANDED)) == [event(9000, d.State.IDLE, d.Trigger.STALE_LAND)]


def test_an_unseen_hold_is_reported_although_the_state_is_the_same() -> None:
    back = (d.State.CLOSED_LOOP, d.Trigger.SETPOINT_FRESH)
    assert watching(FLYING).take_ticks(ticks(900, back)) == [
        event(900, d.State.CLOSED_LOOP, d.Trigger.SETPOINT_FRESH)
    ]


def test_ticks_may_pass_2_to_the_32() -> None:
    missed = MissedEvents()
    missed.take_ticks(ticks(2**32 - 10, FLYING))
    missed.take_event(event(3, d.State.HOLD, d.Trigger.STALE_HOLD))
    assert missed.take_ticks(ticks(5, HOLDING)) == []


def test_a_fault_is_reported_by_its_code() -> None:
    missed = watching(FLYING)
    missed.take_event(event(101, d.State.FAULT, d.Trigger.TRIP))
    [fault] = missed.take_ticks(ticks(101, TRIPPED, TRIPPED))
    assert (fault.kind, fault.detail, fault.tick) == (d.Event.FAULT, d.Fault.PITCH_LIMIT, 101)
    assert math.isnan(fault.value)
    assert "pitch_limit" in event_text(fault) and "nan" not in event_text(fault)


@pytest.mark.medium
@pytest.mark.parametrize("lost", [False, True])
def test_a_session_reports_a_lost_event_once_with_telemetry_as_source(board: FakeBoard, lost: bool) -> None:
    session = Session(FakeLine(board))
    received: list[LinkEvent] = []
    session.subscribe_events(received.append)
    session.connect()
    session.wait(0.5)
    board.change_state(d.State.HOLD, tell=not lost)
    session.wait(0.5)
    [event] = [event for event in received if event.kind == "state"]
    assert event.text.startswith("state hold, because of ")
    assert ("lost" in event.text) == lost


@pytest.mark.slow
def test_a_million_frames_raise_only_errors_of_the_package() -> None:
    frames = samples(1_000_000, 15_000)
    sent, broken = fuzz_host(2, frames)
    assert sent >= frames
    assert not broken, broken.most_common(5)


@pytest.mark.medium
@pytest.mark.parametrize("value", [math.inf, -math.inf, math.nan, 2.0**127, 0.5])
@pytest.mark.parametrize("kind", [*d.Event, 200])
def test_an_event_may_carry_any_number(board: FakeBoard, session: Session, kind: int, value: float) -> None:
    session.wait(0.1)
    board.send(d.EventMessage(tick=board.tick, kind=kind, detail=1, cause=1, value=value))
    session.wait_for(lambda: False, 0.5)
    assert session.connected
    assert session.counters.restarts == 0
    [event] = [event for event in session.events if event.message is not None and event.message.kind == kind]
    assert event.text == event_text(d.EventMessage(tick=0, kind=kind, detail=1, cause=1, value=value))


def test_a_sample_of_a_state_that_nobody_declared_is_refused_and_counted(board: FakeBoard) -> None:
    session = Session(FakeLine(board))
    received: list[Ticks] = []
    session.subscribe_ticks(received.append)
    session.connect()
    session.wait(0.1)
    board.state = 9  # type: ignore[assignment]
    session.wait_for(lambda: False, 0.2)
    board.state = d.State.IDLE
    session.wait(0.2)
    counters = session.counters
    delivered = sum(map(len, received))
    assert all(raw in list(d.State) for ticks in received for raw in ticks.raw[:, d.Channel.STATE])
    assert counters.frames_bad >= 1
    assert counters.ticks_lost >= 180
    assert counters.ticks_received == delivered
    assert delivered + counters.ticks_lost == int(received[-1].tick[-1]) - int(received[0].tick[0]) + 1


def test_every_declared_value_passes_and_no_other() -> None:
    for channel in (d.Channel.STATE, d.Channel.FAULT, d.Channel.TRIGGER):
        kind = d.CHANNELS[channel].kind
        assert kind is not None
        for number in (*range(-1, 260), 2**31 - 1, -(2**31)):
            raw = np.array([row_of({channel: number})], np.int32)
            assert declared(raw).tolist() == [number in [int(value) for value in kind]], (channel, number)
    assert declared(np.array([row_of({d.Channel.FLAGS: 255, d.Channel.FRONT: -5000})], np.int32)).all()
