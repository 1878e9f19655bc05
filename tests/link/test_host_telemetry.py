"""Telemetry batches: the vectorised decoder against a slow witness."""

from __future__ import annotations

import random
from dataclasses import replace

import numpy as np
import pytest
from heli_host.declaration import CHANNELS, ChannelSpec
from heli_host.link.telemetry import EMPTY_TICKS, TelemetryDecoder
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.link import host_reference as reference
from tests.running.long import samples

Batch = tuple[int, list[list[int]]]

CODES = {"u8": "<B", "u16": "<H", "u32": "<I", "i16": "<h", "i32": "<i"}


@st.composite
def batches(draw: st.DrawFn, types: list[str] = reference.TYPES) -> Batch:
    """A first tick and 1 to 32 samples; each channel still, slow, or anything that its type holds.

    Samples follow from a drawn seed: to draw each by itself takes fifty times as long as to decode it.
    """
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


def declared(types: list[str]) -> list[ChannelSpec]:
    """Channels of these types, one after the other."""
    return [
        replace(CHANNELS[0], name=f"channel_{number}", code=CODES[wire_type])
        for number, wire_type in enumerate(types)
    ]


@pytest.mark.slow
@settings(max_examples=samples(200, 40))
@given(st.lists(st.sampled_from([*CODES]), min_size=1, max_size=16), st.data())
def test_channels_of_any_type_may_stand_anywhere(types: list[str], data: st.DataObject) -> None:
    sent = data.draw(st.lists(batches(types), min_size=1, max_size=3))
    payloads = [reference.telemetry_payload(first, rows, types=types) for first, rows in sent]
    decoder = TelemetryDecoder(declared(types))
    assert decoder.decode(payloads).raw.tolist() == [row for _, rows in sent for row in rows]
    assert decoder.malformed == 0


@pytest.mark.slow
@settings(max_examples=samples(200, 40))
@given(batches(), st.data())
def test_wider_deltas_than_needed_decode_alike(sent: Batch, data: st.DataObject) -> None:
    first, rows = sent
    narrow = reference.telemetry_payload(first, rows)
    widths = narrow[5 : 5 + (len(CHANNELS) + 1) // 2]
    codes = [nibble for byte in widths for nibble in (byte % 16, byte // 16)][: len(CHANNELS)]
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
    rows = [[k * (c + 1) for c in range(len(CHANNELS))] for k in range(20)]
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
    ticks = TelemetryDecoder().decode([reference.telemetry_payload(2**32 - 2, [[0] * len(CHANNELS)] * 4)])
    assert ticks.tick.tolist() == [2**32 - 2, 2**32 - 1, 0, 1]


@pytest.mark.medium
def test_hundreds_of_batches_of_changing_size_keep_their_order() -> None:
    sent_values = []
    first = 0
    for index in range(600):
        count = 20 if index % 50 else 5 + index % 7
        columns = range(3, 3 + len(CHANNELS))
        sent_values.append((first, [[(first + k) * c % 250 for c in columns] for k in range(count)]))
        first += count
    ticks = TelemetryDecoder().decode([reference.telemetry_payload(*batch) for batch in sent_values])
    assert ticks.tick.tolist() == list(range(first))
    assert ticks.raw.tolist() == [row for _, rows in sent_values for row in rows]


def test_no_payloads_are_no_ticks() -> None:
    assert TelemetryDecoder().decode([]) is EMPTY_TICKS
