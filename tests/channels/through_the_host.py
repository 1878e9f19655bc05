"""Sends raw numbers through the host's ends under whatever is declared: decoder, samples, log, tables.

Every way gives back what went in, under the names of the declaration. Run as a program with a folder to write
into.
"""

import sys
from pathlib import Path

import numpy as np
from heli_host.board.samples import Scales
from heli_host.data.log.reader import read_flight, read_log
from heli_host.data.log.table import export_mat, export_parquet, write_csv
from heli_host.data.log.writer import LogWriter
from heli_host.declaration import CHANNELS, PARAMS, Channel
from heli_host.link.channels import rad_per_count
from heli_host.link.telemetry import TelemetryDecoder, Ticks
from numpy.typing import NDArray
from scipy.io import loadmat

from tests.link import host_reference as reference

TICKS = 2000
WIRE = {"<B": "u8", "<H": "u16", "<I": "u32", "<h": "i16", "<i": "i32"}
TYPES = [WIRE[spec.code] for spec in CHANNELS]
PARAMETERS = {spec.name: spec.default for spec in PARAMS}
KINDS = [spec.kind for spec in CHANNELS]


def random_raw_numbers() -> NDArray[np.int32]:
    """Raw numbers (TICKS, channels): wandering, jumping to the ends of each type, each channel its own."""
    random = np.random.default_rng(1)
    raw = np.empty((TICKS, len(CHANNELS)), np.int64)
    for channel, wire_type in enumerate(TYPES):
        low, high = reference.limits(wire_type)
        column = np.clip(random.integers(-3, 4, TICKS).cumsum() + 7 * channel, low, high)
        jumps = random.random(TICKS) < 0.02
        column[jumps] = random.choice([low, high, 0], jumps.sum())
        raw[:, channel] = column
    for channel, kind in enumerate(KINDS):
        if kind is not None:
            raw[:, channel] = random.choice([member.value for member in kind], TICKS)
    # A flight of which the reader's checks of plausibility think well.
    for channel, spec in enumerate(CHANNELS):
        if spec.axis is not None:
            raw[:, channel] = np.rint(200.0 * np.sin(np.arange(TICKS) / 300.0 + channel))
        if spec.unit == "V":
            raw[:, channel] = random.integers(-12_000, 12_001, TICKS)
    return raw.astype(np.int32)


def value_in_unit(channel: int, number: int) -> float:
    """A raw number in the unit of its column, by docs/reference/link.md."""
    spec = CHANNELS[channel]
    unsigned_number = number % 2**32 if spec.code == "<I" else number
    if spec.axis is not None:
        return unsigned_number * 2.0 * np.pi / abs(PARAMETERS[f"{spec.axis}_counts_per_rev"])
    return unsigned_number * spec.scale


def decoded(raw: NDArray[np.int32]) -> Ticks:
    """The same by way of the wire, as the slow witness packs it."""
    payloads = [
        reference.telemetry_payload(at, raw[at : at + 20].tolist(), types=TYPES) for at in range(0, TICKS, 20)
    ]
    ticks = TelemetryDecoder().decode(payloads)
    np.testing.assert_array_equal(ticks.raw, raw)
    return ticks


def check(folder: Path) -> None:
    """Fail when a number comes out otherwise than it went in."""
    raw = random_raw_numbers()
    ticks = decoded(raw)
    expected = {
        spec.column: np.array([value_in_unit(channel, number) for number in raw[:, channel].tolist()])
        for channel, spec in enumerate(CHANNELS)
    }
    scales = Scales(PARAMETERS)
    samples = scales.samples(ticks.tick.astype(np.int64), raw)
    for name, column in expected.items():
        np.testing.assert_allclose(getattr(samples, name), column, rtol=1e-15, err_msg=name)
    for row in range(0, TICKS, 97):
        sample = scales.sample(row, raw[row])
        assert all(getattr(sample, name) == column[row] for name, column in expected.items())
        kinds = [kind for kind in KINDS if kind is not None]
        assert [type(getattr(sample, spec.column)) for spec in CHANNELS if spec.kind is not None] == kinds

    writer = LogWriter(
        folder / "a.mcap",
        start_wall_ns=0,
        metadata={"parameters": {name: repr(number) for name, number in PARAMETERS.items()}},
        rad_per_count=rad_per_count(PARAMETERS),
    )
    writer.write_ticks(ticks.tick, raw)
    writer.close()
    log = read_log(folder / "a.mcap")
    np.testing.assert_array_equal(log.raw, raw)
    flight = log.flight()
    counts = {spec.field for spec in CHANNELS if spec.axis is not None}
    assert set(flight.columns()) == {"t_s", *expected, *counts}
    write_csv(flight, folder / "a.csv")
    export_mat(flight, folder / "a.mat")
    export_parquet(flight, folder / "a.parquet")
    matlab = loadmat(folder / "a.mat", squeeze_me=True)
    table = read_flight(folder / "a.csv").columns()
    for name, column in expected.items():
        np.testing.assert_array_equal(flight.columns()[name], column, name)
        np.testing.assert_array_equal(matlab[name], column, name)
        np.testing.assert_allclose(table[name], column, rtol=1e-9, atol=5e-10, err_msg=name)


if __name__ == "__main__":
    check(Path(sys.argv[1]))
    print(",".join(str(channel) for channel in Channel))
