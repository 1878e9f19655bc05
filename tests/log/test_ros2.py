"""An export for ROS 2, read by readers that know nothing of this package."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from heli_host.data.flight import Flight
from heli_host.data.log.reader import read_flight
from heli_host.data.log.ros2 import export_ros2
from heli_host.errors import LogWriteError
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader

from tests.log.made import write_made_log

ROOT = Path(__file__).resolve().parents[2]
NPM = ROOT / "build" / "npm"
ROWS = 400


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Flight:
    path = tmp_path_factory.mktemp("made") / "a.mcap"
    write_made_log(path, ROWS)
    return read_flight(path)


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory, flight: Flight) -> Path:
    path = tmp_path_factory.mktemp("bag") / "a.ros2.mcap"
    export_ros2(flight, path)
    return path


def test_the_file_says_ros2_and_every_channel_is_cdr(bag: Path) -> None:
    with bag.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert reader.get_header().profile == "ros2"
    assert summary is not None
    assert {channel.message_encoding for channel in summary.channels.values()} == {"cdr"}
    assert {schema.encoding for schema in summary.schemas.values()} == {"ros2msg"}


@pytest.mark.medium
def test_mcap_ros2_support_reads_every_number(bag: Path, flight: Flight) -> None:
    decoder = pytest.importorskip("mcap_ros2.decoder", reason="skipped: no mcap-ros2-support")
    with bag.open("rb") as file:
        reader = make_reader(file, decoder_factories=[decoder.DecoderFactory()])
        decoded = [(channel.topic, message) for _, channel, _, message in reader.iter_decoded_messages()]
    ticks = [message for topic, message in decoded if topic == "/heli/tick"]
    for name, column in flight.columns().items():
        field = re.sub("_V$", "_volt", name)
        np.testing.assert_array_equal([getattr(tick, field) for tick in ticks], column)
    events = [message for topic, message in decoded if topic == "/heli/event"]
    assert [(message.name, message.msg) for message in events] == [
        (event.name, event.text) for event in flight.events
    ]
    parameters = {message.name: message.value for topic, message in decoded if topic == "/heli/parameter"}
    assert parameters == flight.parameters


@pytest.mark.medium
def test_rosbags_reads_every_number(bag: Path, flight: Flight) -> None:
    highlevel = pytest.importorskip("rosbags.highlevel", reason="skipped: no rosbags")
    ticks, times_ns = [], []
    with highlevel.AnyReader([bag]) as reader:
        for connection, when_ns, raw in reader.messages():
            if connection.topic == "/heli/tick":
                ticks.append(reader.deserialize(raw, connection.msgtype))
                times_ns.append(when_ns)
    np.testing.assert_array_equal(times_ns, np.rint(flight.t_s * 1e9))
    for name, column in flight.columns().items():
        field = re.sub("_V$", "_volt", name)
        np.testing.assert_array_equal([getattr(tick, field) for tick in ticks], column)


READ_BY_NODE = """
const {McapIndexedReader} = require('@mcap/core');
const {parse} = require('@foxglove/rosmsg');
const {MessageReader} = require('@foxglove/rosmsg2-serialization');
const {decompress} = require('fzstd');
const {readFileSync} = require('fs');
(async () => {
  const data = readFileSync(process.argv[2]);
  const readable = {
    size: async () => BigInt(data.length),
    read: async (at, length) => new Uint8Array(data.subarray(Number(at), Number(at + length))),
  };
  const decompressHandlers = {zstd: (packed) => decompress(packed)};
  const reader = await McapIndexedReader.Initialize({readable, decompressHandlers});
  const decoders = new Map(), found = {profile: reader.header.profile};
  for await (const message of reader.readMessages()) {
    const channel = reader.channelsById.get(message.channelId);
    if (!decoders.has(channel.id)) {
      const text = Buffer.from(reader.schemasById.get(channel.schemaId).data).toString();
      decoders.set(channel.id, new MessageReader(parse(text, {ros2: true})));
    }
    (found[channel.topic] ||= []).push(decoders.get(channel.id).readMessage(message.data));
  }
  console.log(JSON.stringify(found));
})();
"""


@pytest.mark.medium
def test_mcap_core_and_foxgloves_parser_read_every_number(bag: Path, flight: Flight, tmp_path: Path) -> None:
    if shutil.which("node") is None:
        pytest.skip("skipped: no node")
    if not (NPM / "node_modules" / "@mcap" / "core").is_dir():
        pytest.skip("skipped: no @mcap/core; .ci/setup test installs it where there is npm")
    script = NPM / "read.cjs"
    script.write_text(READ_BY_NODE)
    process = subprocess.run(["node", str(script), str(bag)], capture_output=True, text=True, check=False)
    assert process.returncode == 0, process.stderr[-2000:]
    messages = json.loads(process.stdout)
    assert messages["profile"] == "ros2"
    for name, column in flight.columns().items():
        field = re.sub("_V$", "_volt", name)
        np.testing.assert_array_equal([tick[field] for tick in messages["/heli/tick"]], column)
    assert [message["msg"] for message in messages["/heli/event"]] == [event.text for event in flight.events]


def test_counts_are_whole_numbers_and_the_angles_are_their_multiples(bag: Path, flight: Flight) -> None:
    schema = next(text for text in schemas(bag) if text.startswith("# One row"))
    assert "int32 elevation_count" in schema and "float64 front_volt" in schema
    rad = 2.0 * np.pi / flight.parameters["elevation_counts_per_rev"]
    np.testing.assert_allclose(flight.extra["elevation_count"] * rad, flight.elevation_rad, atol=1e-12)


def schemas(bag: Path) -> list[str]:
    with bag.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    return [schema.data.decode() for schema in summary.schemas.values()]


def test_the_same_flight_gives_the_same_bytes_at_any_time(
    bag: Path, flight: Flight, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for clock, value in {"time": 4e9, "time_ns": 4 * 10**18, "monotonic": 4e6}.items():
        monkeypatch.setattr(f"time.{clock}", lambda value=value: value)
    export_ros2(flight, tmp_path / "again.mcap")
    assert (tmp_path / "again.mcap").read_bytes() == bag.read_bytes()


@pytest.mark.medium
@settings(max_examples=12)
@given(st.lists(st.text(max_size=12), min_size=1, max_size=5, unique=True))
def test_any_name_of_a_column_becomes_one_that_ros_2_takes(
    tmp_path_factory: pytest.TempPathFactory, names: list[str]
) -> None:
    t_s = np.asarray(np.arange(12) * 0.1, np.float64)
    extra = {name: t_s for name in names if name != "t_s"}
    path = tmp_path_factory.getbasetemp() / "named.mcap"
    export_ros2(Flight(t_s, t_s, t_s, t_s, t_s, t_s, extra=extra), path)
    schema = next(text for text in schemas(path) if text.startswith("# One row"))
    fields = [line.split()[1] for line in schema.splitlines()[1:]]
    assert len(set(fields)) == len(fields) == 6 + len(extra)
    assert all(re.fullmatch(r"^(?!.*__)(?!.*_$)[a-z][a-z0-9_]*$", field) for field in fields), fields


def test_a_file_that_cannot_be_written_is_one_line(tmp_path: Path, flight: Flight) -> None:
    with pytest.raises(LogWriteError, match="choose another folder"):
        export_ros2(flight, tmp_path / "missing" / "a.mcap")
