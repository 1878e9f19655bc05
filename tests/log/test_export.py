"""Exports read by other programs, ROS 2 among them, and comparisons of flights."""

import json
import math
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from heli_host.data.flight import Flight, FlightEvent
from heli_host.data.log.figure import draw, write_figure
from heli_host.data.log.reader import read_flight, read_log
from heli_host.data.log.ros2 import export_ros2
from heli_host.data.log.summary import summarise, tracking_errors_deg
from heli_host.data.log.table import export_mat, export_parquet, write_csv
from heli_host.data.response import (
    count_rad,
    effort_V,
    flight_under_law,
    flown_rows,
    judged_rows,
    measuring_notes,
    responses,
    steps,
)
from heli_host.declaration import Axis, Channel, Flags, State
from heli_host.errors import LogWriteError
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader

from tests.cli.terminal import Terminal, refusal
from tests.log.made import make_samples, open_writer, write_made_log

ROOT = Path(__file__).resolve().parents[2]
NPM = ROOT / "build" / "npm"
ROWS = 400


@pytest.fixture(scope="module")
def ros2_flight(tmp_path_factory: pytest.TempPathFactory) -> Flight:
    path = tmp_path_factory.mktemp("made") / "a.mcap"
    write_made_log(path, ROWS)
    return read_flight(path)


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory, ros2_flight: Flight) -> Path:
    path = tmp_path_factory.mktemp("bag") / "a.ros2.mcap"
    export_ros2(ros2_flight, path)
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
def test_mcap_ros2_support_reads_every_number(bag: Path, ros2_flight: Flight) -> None:
    decoder = pytest.importorskip("mcap_ros2.decoder", reason="skipped: no mcap-ros2-support")
    with bag.open("rb") as file:
        reader = make_reader(file, decoder_factories=[decoder.DecoderFactory()])
        decoded = [(channel.topic, message) for _, channel, _, message in reader.iter_decoded_messages()]
    ticks = [message for topic, message in decoded if topic == "/heli/tick"]
    for name, column in ros2_flight.columns().items():
        field = re.sub("_V$", "_volt", name)
        np.testing.assert_array_equal([getattr(tick, field) for tick in ticks], column)
    events = [message for topic, message in decoded if topic == "/heli/event"]
    assert [(message.name, message.msg) for message in events] == [
        (event.name, event.text) for event in ros2_flight.events
    ]
    parameters = {message.name: message.value for topic, message in decoded if topic == "/heli/parameter"}
    assert parameters == ros2_flight.parameters


@pytest.mark.medium
def test_rosbags_reads_every_number(bag: Path, ros2_flight: Flight) -> None:
    highlevel = pytest.importorskip("rosbags.highlevel", reason="skipped: no rosbags")
    ticks, times_ns = [], []
    with highlevel.AnyReader([bag]) as reader:
        for connection, when_ns, raw in reader.messages():
            if connection.topic == "/heli/tick":
                ticks.append(reader.deserialize(raw, connection.msgtype))
                times_ns.append(when_ns)
    np.testing.assert_array_equal(times_ns, np.rint(ros2_flight.t_s * 1e9))
    for name, column in ros2_flight.columns().items():
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
  const decoders = new Map(), content = {profile: reader.header.profile};
  for await (const message of reader.readMessages()) {
    const channel = reader.channelsById.get(message.channelId);
    if (!decoders.has(channel.id)) {
      const text = Buffer.from(reader.schemasById.get(channel.schemaId).data).toString();
      decoders.set(channel.id, new MessageReader(parse(text, {ros2: true})));
    }
    (content[channel.topic] ||= []).push(decoders.get(channel.id).readMessage(message.data));
  }
  console.log(JSON.stringify(content));
})();
"""


@pytest.mark.medium
def test_mcap_core_and_foxgloves_parser_read_every_number(
    bag: Path, ros2_flight: Flight, tmp_path: Path
) -> None:
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
    for name, column in ros2_flight.columns().items():
        field = re.sub("_V$", "_volt", name)
        np.testing.assert_array_equal([tick[field] for tick in messages["/heli/tick"]], column)
    assert [message["msg"] for message in messages["/heli/event"]] == [
        event.text for event in ros2_flight.events
    ]


def test_counts_are_whole_numbers_and_the_angles_are_their_multiples(bag: Path, ros2_flight: Flight) -> None:
    schema = next(text for text in schemas(bag) if text.startswith("# One row"))
    assert "int32 elevation_count" in schema and "float64 front_volt" in schema
    rad = 2.0 * np.pi / ros2_flight.parameters["elevation_counts_per_rev"]
    np.testing.assert_allclose(
        ros2_flight.extra["elevation_count"] * rad, ros2_flight.elevation_rad, atol=1e-12
    )


def schemas(bag: Path) -> list[str]:
    with bag.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    return [schema.data.decode() for schema in summary.schemas.values()]


def test_the_same_flight_gives_the_same_bytes_at_any_time(
    bag: Path, ros2_flight: Flight, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for clock, value in {"time": 4e9, "time_ns": 4 * 10**18, "monotonic": 4e6}.items():
        monkeypatch.setattr(f"time.{clock}", lambda value=value: value)
    export_ros2(ros2_flight, tmp_path / "again.mcap")
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
    export_ros2(
        Flight(
            t_s=t_s, front_V=t_s, back_V=t_s, elevation_rad=t_s, pitch_rad=t_s, travel_rad=t_s, extra=extra
        ),
        path,
    )
    schema = next(text for text in schemas(path) if text.startswith("# One row"))
    fields = [line.split()[1] for line in schema.splitlines()[1:]]
    assert len(set(fields)) == len(fields) == 6 + len(extra)
    assert all(re.fullmatch(r"^(?!.*__)(?!.*_$)[a-z][a-z0-9_]*$", field) for field in fields), fields


def test_a_file_that_cannot_be_written_is_one_line(tmp_path: Path, ros2_flight: Flight) -> None:
    with pytest.raises(LogWriteError, match="choose another folder"):
        export_ros2(ros2_flight, tmp_path / "missing" / "a.mcap")


@pytest.fixture
def flight(tmp_path: Path) -> Flight:
    write_made_log(tmp_path / "a.mcap", 3000)
    return read_flight(tmp_path / "a.mcap")


@pytest.mark.medium
def test_matlab_gets_columns_parameters_and_plan(tmp_path: Path, flight: Flight) -> None:
    from scipy.io import loadmat

    export_mat(flight, tmp_path / "a.mat")
    content = loadmat(tmp_path / "a.mat", squeeze_me=True)
    np.testing.assert_array_equal(content["travel_rad"], flight.travel_rad)
    assert float(content["parameters"]["hover_V"]) == flight.parameters["hover_V"]
    assert "made" in str(content["plan"])
    export_mat(flight, tmp_path / "b.mat")
    assert (tmp_path / "a.mat").read_bytes() == (tmp_path / "b.mat").read_bytes()


def test_a_table_gets_every_column(tmp_path: Path, flight: Flight) -> None:
    write_csv(flight, tmp_path / "a.csv")
    header = (tmp_path / "a.csv").read_text().partition("\n")[0]
    assert header.split(",") == list(flight.columns())


@pytest.mark.medium
def test_parquet_gets_every_column_or_says_what_to_install(
    tmp_path: Path, flight: Flight, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(LogWriteError, match="pip install"):
        export_parquet(flight, tmp_path / "a.parquet")
    monkeypatch.undo()
    parquet = pytest.importorskip("pyarrow.parquet", reason="skipped: no pyarrow")
    export_parquet(flight, tmp_path / "a.parquet")
    table = parquet.read_table(tmp_path / "a.parquet")
    np.testing.assert_array_equal(table["pitch_rad"].to_numpy(), flight.pitch_rad)


@pytest.mark.parametrize("export", [write_csv, export_mat])
def test_an_export_into_a_missing_folder_is_one_line(tmp_path: Path, flight: Flight, export: object) -> None:
    assert callable(export)
    with pytest.raises(LogWriteError, match="choose another folder"):
        export(flight, tmp_path / "missing" / "a")


def test_errors_count_in_closed_loop_between_take_off_and_landing(flight: Flight) -> None:
    rows = flown_rows(flight)
    assert not rows[flight.t_s < 0.6].any() and rows[(flight.t_s >= 0.6) & (flight.t_s < 2.55)].all()
    assert not rows[flight.t_s >= 2.55].any()
    setpoint = flight.setpoints_rad
    assert setpoint is not None
    expected_deg = np.rad2deg(flight.angles_rad[rows] - setpoint[rows])
    np.testing.assert_allclose(tracking_errors_deg(flight), expected_deg)


def test_without_phases_all_of_the_closed_loop_counts(flight: Flight) -> None:
    by_hand = replace(flight, events=())
    assert flown_rows(by_hand).sum() == np.sum(flight.state == 2)


def test_a_summary_says_what_the_log_says(tmp_path: Path, flight: Flight) -> None:
    summary = summarise(read_log(tmp_path / "a.mcap"))
    errors_deg = tracking_errors_deg(flight)
    content = summary.as_dict()
    assert content["outcome"] == "completed" and summary.completed
    assert content["ticks_logged"] == 3000 and content["ticks_lost"] == 0
    assert content["duration_s"] == pytest.approx(2.999)
    assert content["rms_error_deg"]["travel"] == pytest.approx(
        np.sqrt(np.mean(errors_deg[:, Axis.TRAVEL] ** 2)), abs=1e-4
    )
    assert content["link"] == {"frames_ok": 150, "frames_bad": 0, "retries": 0, "reconnects": 0}
    assert content["plans"] == ["sine"] and content["rig"] == "makki2024"
    summary.write_json(tmp_path / "new" / "summary.json")
    assert json.loads((tmp_path / "new" / "summary.json").read_text()) == {"schema": 1, **content}


def test_a_log_that_was_not_closed_says_so_in_its_summary(tmp_path: Path) -> None:
    data = (write_made_log(tmp_path / "a.mcap", 3000), (tmp_path / "a.mcap").read_bytes())[1]
    (tmp_path / "cut.mcap").write_bytes(data[: len(data) // 2])
    summary = summarise(read_log(tmp_path / "cut.mcap"))
    assert summary.outcome.startswith("not closed") and summary.notes
    assert summary.ticks_logged == 1000


def test_an_axis_that_was_never_closed_has_no_error(tmp_path: Path) -> None:
    tick, raw = make_samples(1500)
    raw[:, Channel.STATE] = State.OPEN_LOOP
    writer = open_writer(tmp_path / "open.mcap")
    writer.write_ticks(tick, raw)
    writer.close()
    summary = summarise(read_log(tmp_path / "open.mcap"))
    assert summary.rms_error_deg == {"elevation": None, "pitch": None, "travel": None}
    assert summary.outcome == "recorded"
    json.dumps(summary.as_dict(), allow_nan=False)


@pytest.mark.slow
def test_a_figure_shows_angles_setpoints_voltages_and_states(tmp_path: Path, flight: Flight) -> None:
    summary = summarise(read_log(tmp_path / "a.mcap"))
    figure = draw(flight, summary)
    texts = [text.get_text() for axes in figure.axes for text in axes.texts]
    assert "sine" in texts and "closed loop" in texts
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    assert any(f"error {summary.rms_error_deg['travel']:.2f}° rms" in title for title in titles)
    lines = {line.get_label() for axes in figure.axes for line in axes.lines}
    assert {"measured", "setpoint", "front", "back"} <= lines
    write_figure(flight, summary, tmp_path / "new" / "figure.png")
    assert (tmp_path / "new" / "figure.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


@pytest.mark.medium
def test_a_long_flight_is_thinned_without_losing_a_peak(tmp_path: Path) -> None:
    tick, raw = make_samples(60_000)
    raw[31_234, Channel.PITCH_COUNT] = 4000
    writer = open_writer(tmp_path / "long.mcap")
    writer.write_ticks(tick, raw)
    writer.close()
    log = read_log(tmp_path / "long.mcap")
    figure = draw(log.flight(), summarise(log))
    line = next(line for line in figure.axes[1 + Axis.PITCH].lines if line.get_label() == "measured")
    points_deg = np.asarray(line.get_ydata())
    assert len(points_deg) < 10_000
    assert points_deg.max() == pytest.approx(4000 * 360 / 4096)


@pytest.mark.medium
def test_a_figure_leaves_no_trace_in_pyplot(tmp_path: Path, flight: Flight) -> None:
    write_figure(flight, summarise(read_log(tmp_path / "a.mcap")), tmp_path / "a.png")
    pyplot = sys.modules.get("matplotlib.pyplot")
    assert pyplot is None or not pyplot.get_fignums()


@pytest.mark.medium
def test_a_figure_of_an_unknown_kind_is_one_line(tmp_path: Path, flight: Flight) -> None:
    with pytest.raises(LogWriteError, match=r"\.png"):
        write_figure(flight, summarise(read_log(tmp_path / "a.mcap")), tmp_path / "a.docx")


NATURAL_rad_s, DAMPING, STEP_deg, AT_s = 3.0, 0.4, 20.0, 5.0


def second_order(state: bool = True, ramp_s: float = 0.0) -> Flight:
    """Travel steps as a linear oscillator does, whose metrics every textbook has; elevation stays."""
    t_s = np.arange(0.0, 20.0, 0.002)
    since = np.maximum(t_s - AT_s, 0.0)
    decay, fast = DAMPING * NATURAL_rad_s, NATURAL_rad_s * math.sqrt(1.0 - DAMPING**2)
    share = 1.0 - np.exp(-decay * since) * (np.cos(fast * since) + decay / fast * np.sin(fast * since))
    wanted = np.clip(since / ramp_s, 0.0, 1.0) if ramp_s else (t_s >= AT_s).astype(float)
    zero = np.zeros_like(t_s)
    return Flight(
        t_s=t_s,
        front_V=zero + 1.5,
        back_V=zero + 2.5,
        elevation_rad=zero + 0.01,
        pitch_rad=zero,
        travel_rad=np.deg2rad(STEP_deg) * share,
        elevation_setpoint_rad=zero,
        pitch_setpoint_rad=zero,
        travel_setpoint_rad=np.deg2rad(STEP_deg) * wanted,
        state=np.full(len(t_s), 4, np.uint8) if state else None,
        state_names={4: "closed_loop", 0: "idle"},
    )


@pytest.mark.medium
@pytest.mark.parametrize("ramp_s", [0.0, 0.4])
def test_metrics_of_a_step_are_those_of_the_textbook(ramp_s: float) -> None:
    elevation, pitch, travel = responses(second_order(ramp_s=ramp_s))
    overshoot = 100.0 * math.exp(-math.pi * DAMPING / math.sqrt(1.0 - DAMPING**2))
    assert travel.step_s == pytest.approx(AT_s, abs=0.005)
    assert travel.step_deg == pytest.approx(STEP_deg)
    assert travel.overshoot_percent == pytest.approx(overshoot, abs=0.1)
    # A second-order system with this damping rises from 10 to 90 % in 1.463 / w, by its closed form.
    share = np.rad2deg(second_order().travel_rad) / STEP_deg
    t_s = second_order().t_s
    rise_s = t_s[np.argmax(share > 0.9)] - t_s[np.argmax(share > 0.1)]
    assert travel.rise_s == pytest.approx(rise_s, abs=0.005)
    outside = np.flatnonzero(np.abs(share[t_s >= AT_s] - 1.0) > 0.05)
    assert travel.settling_s == pytest.approx(t_s[outside[-1]], abs=0.01)
    assert elevation.rms_deg == pytest.approx(math.degrees(0.01))
    assert math.isnan(elevation.rise_s)
    assert pitch.rms_deg == 0.0


@pytest.mark.medium
def test_a_tilt_that_checks_the_travel_encoder_is_no_error_of_the_law() -> None:
    calm = second_order()
    swing_rad = np.where(np.abs(calm.t_s - 10.0) < 3.0, np.deg2rad(12.0) * np.sin(calm.t_s), 0.0)
    is_swinging = calm.t_s >= 8.0
    checked = replace(
        calm,
        pitch_rad=calm.pitch_rad + is_swinging * swing_rad,
        travel_rad=calm.travel_rad + is_swinging * swing_rad,
        front_V=calm.front_V + is_swinging * swing_rad,
        events=(FlightEvent(8.0, "travel_probe", "asked"), FlightEvent(8.4, "travel_probe", "counts")),
    )
    assert responses(replace(checked, events=()))[2].overshoot_percent > 50.0
    elevation, pitch, travel = responses(checked)
    before = responses(calm.between(0.0, 8.0))[2]
    assert (travel.overshoot_percent, travel.settling_s) == (before.overshoot_percent, before.settling_s)
    is_judged = (calm.t_s < 8.0) | (calm.t_s >= 18.4)
    assert calm.travel_setpoint_rad is not None
    error_rad = (calm.travel_rad - calm.travel_setpoint_rad)[is_judged]
    assert travel.rms_deg == pytest.approx(np.rad2deg(np.sqrt(np.mean(error_rad**2))))
    assert (pitch.rms_deg, effort_V(checked)) == (0.0, pytest.approx(0.0, abs=1e-9))
    assert elevation == responses(calm)[0]
    assert measuring_notes(calm) == []
    (note,) = measuring_notes(checked)
    assert note.startswith("a check of the silent travel encoder")


@pytest.mark.medium
def test_a_step_with_missing_rows_is_not_measured_and_a_note_says_so() -> None:
    whole = second_order()
    with_gap = replace(whole, t_s=np.where(whole.t_s < AT_s + 0.2, whole.t_s, whole.t_s + 0.4))
    travel = responses(with_gap)[2]
    assert travel.step_deg == pytest.approx(STEP_deg)
    assert math.isnan(travel.overshoot_percent) and math.isnan(travel.settling_s)
    assert measuring_notes(with_gap) == [
        "rows are missing after 5.198 s: a step response with a gap is not measured"
    ]
    assert not math.isnan(responses(whole)[2].overshoot_percent)
    # A gap before the first row of the step hides when it began.
    late = replace(whole, t_s=np.where(whole.t_s < AT_s - 1e-9, whole.t_s, whole.t_s + 0.4))
    assert math.isnan(responses(late)[2].settling_s)


@pytest.mark.medium
def test_rows_count_if_the_log_does_not_name_its_states() -> None:
    nameless = replace(second_order(), state_names={})
    assert responses(nameless) == responses(second_order(state=False))
    assert measuring_notes(nameless) == [
        "the log does not name its states: rows on the table are measured, too"
    ]


@pytest.mark.medium
def test_effort_is_the_rms_of_what_control_adds_to_the_mean_voltage() -> None:
    steady = second_order()
    assert effort_V(steady) == pytest.approx(0.0, abs=1e-9)
    swing_V = 0.3 * np.sin(2.0 * np.pi * steady.t_s)
    flight = replace(steady, front_V=steady.front_V + swing_V, back_V=steady.back_V - swing_V)
    assert effort_V(flight) == pytest.approx(0.3 / math.sqrt(2.0), rel=1e-3)
    assert flight.state is not None
    flight.state[:] = 0
    assert math.isnan(effort_V(flight))
    assert all(math.isnan(response.rms_deg) for response in responses(flight))


def counted(flight: Flight, counts: float, *, logged: bool) -> Flight:
    """The flight as an encoder of travel shows it, with or without the board's parameter."""
    count_rad = 2.0 * np.pi / counts
    return replace(
        flight,
        travel_rad=np.round(flight.travel_rad / count_rad) * count_rad,
        parameters={"travel_counts_per_rev": -counts} if logged else {},
    )


@pytest.mark.medium
@pytest.mark.parametrize("logged", [True, False])
@pytest.mark.parametrize("size", [1.0, 1.5])
def test_a_coarse_encoder_settles_when_a_fine_one_does(size: float, logged: bool) -> None:
    flight = second_order()
    travel_rad = size * flight.travel_rad
    flight = replace(
        flight, travel_rad=travel_rad, travel_setpoint_rad=np.deg2rad(size * STEP_deg) * (flight.t_s >= AT_s)
    )
    true, fine, coarse = (
        responses(each)[2]
        for each in (flight, counted(flight, 4096.0, logged=logged), counted(flight, 1024.0, logged=logged))
    )
    # Two samples of 2 ms.
    assert fine.settling_s == pytest.approx(true.settling_s, abs=0.0041)
    assert coarse.settling_s == pytest.approx(fine.settling_s, abs=0.0041)


@pytest.mark.medium
def test_a_count_is_measured_per_axis_where_no_log_states_it() -> None:
    flight = counted(second_order(), 1000.0, logged=False)
    count_deg = np.rad2deg(count_rad(flight))
    assert count_deg[2] == pytest.approx(0.36)
    # Pitch does not move. The angles of a flight without encoders are not whole counts.
    assert np.isnan(count_deg[1]) and np.isnan(count_rad(second_order())[2])


@pytest.mark.medium
def test_a_small_step_settles_within_a_count_of_the_encoder() -> None:
    small = replace(
        second_order(),
        travel_rad=second_order().travel_rad / 15.0 + np.deg2rad(0.08),
        travel_setpoint_rad=np.deg2rad(STEP_deg / 15.0) * (second_order().t_s >= AT_s),
    )
    small = counted(small, 4096.0, logged=True)
    (_, _, travel) = responses(small)
    assert travel.step_deg == pytest.approx(STEP_deg / 15.0)
    # 0.08 degrees stay: more than 5 % of the step, less than a count.
    assert not math.isnan(travel.settling_s)


@pytest.mark.medium
def test_a_sine_has_no_steps_at_any_rate_of_samples() -> None:
    for step_s in (0.001, 0.01):
        t_s = np.arange(0.0, 40.0, step_s)
        zero = np.zeros_like(t_s)
        sine = np.deg2rad(4.0) * np.sin(2.0 * np.pi * t_s / 15.0)
        flight = Flight(
            t_s=t_s, front_V=zero, back_V=zero, elevation_rad=sine, pitch_rad=zero, travel_rad=sine,
            elevation_setpoint_rad=sine, pitch_setpoint_rad=zero, travel_setpoint_rad=5.0 * sine,
        )  # fmt: skip
        assert not steps(flight, "elevation") and not steps(flight, "travel")


@pytest.mark.medium
def test_all_steps_are_found_and_the_largest_is_reported() -> None:
    t_s = np.arange(0.0, 30.0, 0.001)
    zero = np.zeros_like(t_s)
    wanted = np.deg2rad(np.select([t_s < 5.0, t_s < 15.0], [0.0, 6.0], -4.0))
    flight = Flight(
        t_s=t_s,
        front_V=zero,
        back_V=zero,
        elevation_rad=zero,
        pitch_rad=zero,
        travel_rad=wanted,
        elevation_setpoint_rad=zero,
        pitch_setpoint_rad=zero,
        travel_setpoint_rad=wanted,
    )
    assert [(step.start_s, round(step.size_deg, 6)) for step in steps(flight, "travel")] == [
        (pytest.approx(5.0), 6.0),
        (pytest.approx(15.0), -10.0),
    ]
    assert responses(flight)[2].step_deg == pytest.approx(-10.0)


@pytest.mark.medium
def test_an_axis_that_a_law_does_not_lead_has_no_error() -> None:
    flight = second_order()
    assert flight.state is not None
    law = np.where(flight.t_s > 10.0, Flags.LAW, 0).astype(np.uint8)
    flight_of_law = replace(flight, flags=law, pitch_rad=flight.pitch_rad + 0.1)
    commanded = np.where(law > 0, flight_of_law.pitch_rad, 0.0)
    all_responses = responses(replace(flight_of_law, pitch_setpoint_rad=commanded))
    # Over the rows in which the board led it alone: no merit for the law.
    assert all_responses[1].rms_deg == pytest.approx(math.degrees(0.1))
    rows_of_law = flight_under_law(replace(flight_of_law, pitch_setpoint_rad=commanded))
    assert rows_of_law.t_s[0] > 10.0
    assert math.isnan(responses(rows_of_law)[1].rms_deg)
    assert responses(rows_of_law)[0].rms_deg == pytest.approx(math.degrees(0.01))
    # A check that ended just before the law began still moves the arm.
    checks = (FlightEvent(9.0, "travel_probe", "asked"), FlightEvent(9.4, "travel_probe", "counts"))
    after_check = flight_under_law(replace(flight_of_law, events=checks))
    assert (judged_rows(after_check, "travel") == (after_check.t_s >= 19.4)).all()
    assert judged_rows(after_check, "elevation").all()


@pytest.mark.medium
def test_step_that_does_not_settle_has_no_settling_time() -> None:
    (_, _, travel) = responses(second_order().between(0.0, AT_s + 1.2))
    assert math.isnan(travel.settling_s)
    assert travel.overshoot_percent > 0.0


@pytest.mark.medium
def test_flights_are_laid_over_each_other_with_their_metrics(terminal: Terminal) -> None:
    for name in ("a", "b"):
        write_csv(second_order(state=False), f"{name}.csv")
    result = terminal("plot", "a.csv", "b.csv", "--figure", "both.png")
    assert result.code == 0, result
    assert Path("both.png").read_bytes().startswith(b"\x89PNG")
    head, *rows = result.out.splitlines()
    assert head.split()[:2] == ["flight", "axis"]
    assert [row.split()[0] for row in rows if row[0] != " "] == ["a.csv", "b.csv", "files:"]
    numbers = json.loads(terminal("plot", "a.csv", "b.csv", "--json", "-").out)
    assert numbers["figure"] is None
    assert numbers["flights"][0]["axis"]["travel"]["step_deg"] == pytest.approx(STEP_deg, rel=1e-3)
    assert numbers["flights"][0]["axis"]["elevation"]["rise_s"] is None


@pytest.mark.medium
def test_too_many_and_the_same_twice_are_refused(terminal: Terminal) -> None:
    write_csv(second_order(), "a.csv")
    assert "twice" in refusal(terminal("plot", "a.csv", "a.csv"), code=2)
    assert "are too many for one figure" in refusal(terminal("plot", *(f"{i}.csv" for i in range(9))), code=2)


@pytest.mark.medium
def test_figure_in_no_format_that_can_be_drawn_is_one_line(terminal: Terminal) -> None:
    write_csv(second_order(), "a.csv")
    write_csv(second_order(), "b.csv")
    assert "both.txt" in refusal(terminal("plot", "a.csv", "b.csv", "--figure", "both.txt"), code=2)
