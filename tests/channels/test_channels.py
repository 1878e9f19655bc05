"""Another declaration needs no change of code: new channels, other tables; an invalid one is refused.

The native board is compiled once, from a copy of the sources with one channel more in the middle and one at
the end, and flown by the copy's host.
"""

import itertools
import json
import os
import random
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from heli_host.data.flight import OWN_COLUMNS
from heli_host.data.log.reader import read_flight, read_log
from heli_host.declaration import CHANNELS, Channel, Fault, State

from firmware.generator.declared import DeclarationError, read
from tests.channels import changed_copy, scripted_flight, through_the_host
from tests.channels.changed_copy import DECLARATION, ROOT, ChangedCopy, channel
from tests.running.kept import KEPT
from tests.running.long import samples

HERE = Path(__file__).parent
CORE = "firmware/core/core.cpp"
LAST_PUT = "      .put<Channel::flags>(flags)\n"
ECHO, RATE = "tick_echo", "tilt_rate_rad_s"


def with_two_channels(root: Path, source: Path = ROOT) -> ChangedCopy:
    """Sources with an unsigned number of 32 bits in the middle and a scaled one of 16 bits at the end."""
    copy = ChangedCopy(root, source)
    copy.add_channel(channel("tick_echo", "u32"), before="front")
    copy.add_channel(channel("tilt_rate", "i16", unit="rad/s", scale=0.001))
    copy.replace(
        CORE,
        LAST_PUT,
        LAST_PUT
        + "      .put<Channel::tick_echo>(static_cast<std::int32_t>(observation_.tick ^ 0x80000000U))\n"
        + "      .put<Channel::tilt_rate>("
        + "to_wire(observation_.rate_rad_s[kPitch], Wire::of(link::kTiltRatePerUnit)))\n",
    )
    copy.generate()

    def compiled() -> bytes:
        copy.build()
        return copy.extension.read_bytes()

    # 10 s of CPU, which an edit of Python does not cost again.
    made_by = (Path(__file__), Path(changed_copy.__file__), ROOT / "CMakeLists.txt")
    copy.extension.write_bytes(
        KEPT("board with two channels", compiled, made_by=made_by, rooms=("firmware", "sim/native"))
    )
    return copy


@dataclass(frozen=True)
class Flown:
    """One script flown under two declarations, and what else the longer one's host can do."""

    copy: ChangedCopy
    before: Path
    after: Path


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Flown:
    folder = tmp_path_factory.mktemp("new channel")
    before, after = folder / "before", folder / "after"
    before.mkdir()
    after.mkdir()
    copy = with_two_channels(folder / "copy")
    scripted_flight.write(scripted_flight.fly(), before)
    copy.run(str(HERE / "scripted_flight.py"), str(after))
    copy.heli_host(*["fly", "hover", "--sil", "--board", "native", "--speed", "max", "--log", "hover.mcap"])
    copy.heli_host(*["export", "hover.mcap", "--csv"])
    return Flown(copy, before, after)


def echo_of(tick: np.ndarray) -> np.ndarray:
    return tick.astype(np.int64) ^ 0x80000000


@pytest.mark.slow
def test_old_channels_are_the_same_in_telemetry_tick_by_tick(flown: Flown) -> None:
    before, after = (np.load(folder / "ticks.npz") for folder in (flown.before, flown.after))
    assert len(before["board tick"]) > 19_000
    for name in ("board tick", *map(str, Channel)):
        np.testing.assert_array_equal(before[name], after[name], name)
    flown_states = {State.IDLE, State.ARMED, State.CLOSED_LOOP, State.LANDING, State.FAULT}
    assert set(before["state"]) == flown_states, "it was flown"
    assert set(before["fault"]) == {Fault.NONE, Fault.PITCH_LIMIT}
    assert np.ptp(before["travel_count"]) > 100


@pytest.mark.slow
def test_new_channels_say_what_the_board_put_there(flown: Flown) -> None:
    ticks = np.load(flown.after / "ticks.npz")
    np.testing.assert_array_equal(ticks["tick_echo"], echo_of(ticks["board tick"]))
    flying = ticks["fault"] == Fault.NONE
    turned_rad = np.cumsum(ticks["tilt_rate"][flying]) * 1e-3 * 1e-3
    counted_rad = ticks["pitch_count"][flying] * 2.0 * np.pi / 4096.0
    assert np.ptp(counted_rad) > 0.05
    # The rate is filtered, and therefore late.
    np.testing.assert_allclose(turned_rad, counted_rad, atol=0.02)


@pytest.mark.slow
def test_a_log_and_its_tables_have_the_old_columns_and_the_new(flown: Flown) -> None:
    before = read_flight(flown.before / "flight.mcap")
    for name in ("flight.mcap", "flight.csv"):
        after = read_flight(flown.after / name)
        assert set(after.columns()) - set(before.columns()) == {ECHO, RATE}
        assert set(after.extra) - set(before.extra) == {ECHO, RATE}
        for column in OWN_COLUMNS:
            np.testing.assert_allclose(after.columns()[column], before.columns()[column], atol=1e-9)
    ticks = np.load(flown.after / "ticks.npz")
    for name in ("flight.mcap", "flight.csv"):
        extra = read_flight(flown.after / name).extra
        np.testing.assert_array_equal(extra[ECHO], ticks["tick_echo"])
        np.testing.assert_allclose(extra[RATE], ticks["tilt_rate"] * 1e-3, atol=1e-12)


@pytest.mark.slow
def test_matlab_and_parquet_have_them_too(flown: Flown) -> None:
    from scipy.io import loadmat

    flight = read_flight(flown.after / "flight.mcap")
    matlab = loadmat(flown.after / "flight.mat", squeeze_me=True)
    parquet = pytest.importorskip("pyarrow.parquet", reason="skipped: no pyarrow")
    table = parquet.read_table(flown.after / "flight.parquet")
    for name, column in flight.columns().items():
        # This host does not know the scale of the new ones, and has them in the single precision of the log.
        tolerance = 1e-7 if name in flight.extra else 0.0
        np.testing.assert_allclose(matlab[name], column, rtol=tolerance, err_msg=name)
        np.testing.assert_allclose(table[name].to_numpy(), column, rtol=tolerance, err_msg=name)


@pytest.mark.slow
def test_a_plan_flies_to_its_end_and_its_log_knows_state_and_fault(flown: Flown) -> None:
    log = read_log(flown.copy.root / "hover.mcap")
    assert log.metadata["result"]["outcome"] == "completed"
    names = log.layout.names("STATE")
    state = log.ticks["state"]
    changes = state[np.flatnonzero(np.diff(state, prepend=255))]
    assert [names[int(number)] for number in changes] == ["idle", "armed", "closed_loop", "landing", "idle"]
    assert not log.ticks["fault"].any()
    np.testing.assert_array_equal(log.ticks[ECHO], echo_of(log.ticks["tick"]))
    flight, table = log.flight(), read_flight(flown.copy.root / "hover.csv")
    assert abs(np.degrees(flight.elevation_rad[20_000])) < 1.0
    for name, column in flight.columns().items():
        np.testing.assert_allclose(table.columns()[name], column, atol=1e-9)


@pytest.mark.slow
def test_a_fault_in_flight_is_reported_by_its_name(flown: Flown) -> None:
    program = """
import numpy as np
import heli_host
from heli_host.fly.runner import fly
from heli_host.declaration import Axis
with heli_host.connect("sil://?speed=max") as heli:
    world = heli.session.transport.world
    def tilt(progress):
        if progress.t_s > 3.0:
            tilted = world.state
            tilted[Axis.PITCH] = np.radians(60.0)
            world.state = tilted
    print(fly(heli, "hover", on_progress=tilt).outcome)
"""
    assert "fault pitch_limit" in flown.copy.run("-c", program)


@pytest.mark.slow
@pytest.mark.parametrize("how", [(), ("raise",)], ids=["by its end", "by an exception"])
def test_leaving_the_block_in_flight_lands(flown: Flown, how: tuple[str, ...]) -> None:
    seen: dict[str, Any] = json.loads(flown.copy.run(str(HERE / "leaving.py"), *how))
    assert seen["state"] == "closed_loop" and abs(seen["elevation_deg"]) < 3.0
    assert min(seen["volts_in_flight_V"]) > 0.5
    assert seen.get("raised", False) == (how == ("raise",))
    assert seen["landings"] >= 1
    assert seen["volts_V"] == [0.0, 0.0]


@pytest.mark.slow
def test_the_samples_of_a_session_have_the_new_channels_in_units(flown: Flown) -> None:
    program = """
import heli_host, json
with heli_host.connect("sil://?speed=max") as heli:
    heli.wait(0.5)
    sample, samples = heli.latest, heli.samples()
print(json.dumps([
    sample.tick, sample.tick_echo, sample.tilt_rate_rad_s, str(sample.state), str(sample.fault),
    sample.elevation_deg, samples.tick_echo.tolist(), samples.tick.tolist(),
]))
"""
    tick, echo, rate_rad_s, state, fault, elevation_deg, echoes, ticks = json.loads(
        flown.copy.run("-c", program)
    )
    assert (echo, rate_rad_s) == (tick ^ 0x80000000, 0.0)
    assert (state, fault) == ("idle", "none") and elevation_deg == pytest.approx(-25.0, abs=0.1)
    np.testing.assert_array_equal(echoes, echo_of(np.array(ticks)))


@pytest.mark.slow
def test_an_older_host_reads_the_log_of_a_longer_declaration_and_the_other_way_round(flown: Flown) -> None:
    newer = read_flight(flown.after / "flight.mcap")
    known = set(read_flight(flown.before / "flight.mcap").extra)
    assert {ECHO, RATE} == set(newer.extra) - known, "this host does not know them"
    program = """
import sys
from heli_host.errors import LogError
from heli_host.data.log.reader import read_flight
from heli_host.data.log.reader import read_log
flight = read_flight(sys.argv[1])
assert not {"tick_echo", "tilt_rate_rad_s"} & set(flight.extra)
print(len(flight))
try:
    read_log(sys.argv[1]).raw
except LogError as error:
    print(error)
"""
    rows, output = flown.copy.run("-c", program, str(flown.before / "flight.mcap")).splitlines()
    assert int(rows) == len(read_flight(flown.before / "flight.mcap"))
    assert "no channel tick_echo" in output and "read it with the heli-host version that wrote it" in output


def compiled(copy: ChangedCopy) -> str:
    """Messages of the compiler about the core; empty if it compiles."""
    compiler = os.environ.get("CXX", "c++")
    core = copy.root / "firmware" / "core"
    command = [compiler, "-std=c++17", "-fsyntax-only", f"-I{core}", str(core / "core.cpp")]
    return subprocess.run(command, capture_output=True, text=True, check=False).stderr


@pytest.mark.slow
def test_a_channel_that_is_declared_but_never_put_does_not_compile(tmp_path: Path) -> None:
    copy = ChangedCopy(tmp_path / "copy")
    assert compiled(copy) == ""
    copy.add_channel(channel("tick_echo", "u32"))
    copy.generate()
    assert "a channel that is never put()" in compiled(copy)
    copy.replace(CORE, LAST_PUT, LAST_PUT + "      .put<Channel::tick_echo>(0)\n")
    assert compiled(copy) == ""


@pytest.mark.slow
def test_a_channel_that_is_put_twice_does_not_compile(tmp_path: Path) -> None:
    copy = ChangedCopy(tmp_path / "copy")
    copy.replace(CORE, LAST_PUT, LAST_PUT + LAST_PUT)
    assert "this channel is put() twice" in compiled(copy)


PROGRAM = Path(through_the_host.__file__)
MARK = "[[channel]]\n"
NAMES = [spec.name for spec in CHANNELS]


def rearranged(text: str, order: list[str]) -> str:
    """A declaration with its channels in another order."""
    head, *entries = text.split(MARK)
    last, mark, tail = entries[-1].partition("\n# ----")
    entries[-1] = last + "\n"
    by_name = dict(zip(NAMES, entries, strict=True))
    return head + "".join(MARK + by_name[name] for name in order) + mark.lstrip("\n") + tail


def came_through(copy: ChangedCopy, folder: Path) -> list[str]:
    """Check the copy's host; its channels, in order."""
    copy.generate()
    return copy.run(str(PROGRAM), str(folder)).strip().split(",")


@pytest.mark.slow
def test_the_declared_channels_come_through(tmp_path: Path) -> None:
    through_the_host.check(tmp_path)


@pytest.mark.slow
@pytest.mark.parametrize(
    "order",
    [NAMES[::-1], random.Random(1).sample(NAMES, len(NAMES)), NAMES[-3:] + NAMES[:-3]][: samples(3, 1)],
    ids=["backwards", "shuffled", "unsigned first"][: samples(3, 1)],
)
def test_channels_of_every_type_may_stand_anywhere_in_any_order(tmp_path: Path, order: list[str]) -> None:
    copy = ChangedCopy(tmp_path / "copy")
    path = copy.root / DECLARATION
    path.write_text(rearranged(path.read_text(encoding="utf-8"), order), encoding="utf-8")
    added = itertools.product(("u32", "u16", "u8", "i16", "i32"), ((1.0, ""), (0.0625, "rad/s2")))
    places = [order[0], order[0], "front", "state", "flags", *[""] * 5]
    for number, ((wire_type, (scale, unit)), before) in enumerate(zip(added, places, strict=True)):
        copy.add_channel(channel(f"more_{number}", wire_type, unit, scale), before)
    # Second channels of an enumeration share its names.
    copy.add_channel(channel("state_before", "u8", "enum state"), before="state")
    copy.add_channel(channel("reset_cause", "u8", "enum reset"))
    names = came_through(copy, tmp_path)
    assert [name for name in names if name in NAMES] == order
    assert names[:2] == ["more_0", "more_1"] and names[-2:] == ["more_9", "reset_cause"]
    assert names[names.index("state") - 1] == "state_before"
    assert len(names) == len(NAMES) + 12


@pytest.mark.slow
def test_a_log_by_a_version_with_a_finer_scale_is_not_rounded_to_ours(tmp_path: Path) -> None:
    copy = ChangedCopy(tmp_path / "copy")
    back = 'name = "back"\ntype = "i16"\nunit = "V"\nscale = '
    copy.replace(DECLARATION, f"{back}0.001", f"{back}0.00001")
    came_through(copy, tmp_path)
    logged, table = (read_flight(tmp_path / name) for name in ("a.mcap", "a.csv"))
    assert np.abs(table.back_V).max() < 0.13
    np.testing.assert_allclose(logged.back_V, table.back_V, rtol=1e-6, atol=1e-9)


TEXT = (ROOT / DECLARATION).read_text(encoding="utf-8")


def declared(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "link.toml"
    path.write_text(text, encoding="utf-8")
    return path


def with_channel(entry: str) -> str:
    head, mark, tail = TEXT.partition("[[message]]")
    return head + entry + mark + tail


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        (channel("front", "i16", "V", 0.001), "two are called front"),
        (channel("front_volt", "u8"), "front already has a front_volt"),
        (channel("elevation", "i32", "rad", 1e-5), "elevation_count already has a elevation_rad"),
        (channel("pitch", "i16", "deg", 0.01), "every log or sample already has a pitch_deg"),
        (channel("tick", "u32"), "already has a tick"),
        (channel("t", "u32", "s", 0.001), "already has a t_s"),
        (channel("plan", "u8"), "already has a plan"),
        (channel("class", "u8"), "'class' is no name"),
        (channel("lambda", "u8"), "'lambda' is no name"),
        (channel("2nd", "u8"), "'2nd' is no name"),
        (channel("supplyVoltage", "u16", "V", 0.001), "a log cannot hold 'supplyVoltage_volt'"),
        (channel("a__b", "u8"), "a log cannot hold 'a__b'"),
        (channel("x" * 64, "u8"), "MATLAB"),
        (channel("load", "u8", "%"), "unit '%' cannot end a name"),
        (channel("speed", "f32", "rad/s"), "no type f32; it may be u8, u16, u32, i16, i32"),
        (channel("ticks_since", "u64"), "no type u64"),
        (channel("speed", "i8"), "no type i8"),
        (channel("speed", "i16", "rad/s", 0.0), "scale 0.0 is no size"),
        (channel("speed", "i16", "rad/s", -1.0), "scale -1.0 is no size"),
        (channel("mood", "u8", "enum mood"), "there is no enum mood; it may be axis, "),
        (channel("more", "u8", "bits more"), "there is no bits more"),
        (channel("state_before", "u16", "enum state"), "enum state takes type u8"),
        (channel("state_before", "u8", "enum state", 2.0), "enum state takes scale 1.0"),
        (channel("yaw_count", "i32", "count"), "only an encoder counts"),
        (channel("misses", "u16", "count"), "or leave unit empty"),
        (channel("speed", "i16", meaning="two\\nlines"), "more than one line"),
        ('[[channel]]\nname = "speed"\ntype = "i16"\n', "meaning is missing, or not known"),
        (channel("speed", "i16") + 'colour = "red"\n', "colour is missing, or not known"),
        (channel("speed", "i16").replace('unit = ""', "unit = 5"), "unit 5 is no text"),
        ("[[channel]\n", "cannot be read"),
    ],
)
def test_a_channel_that_would_not_work_is_refused(tmp_path: Path, entry: str, message: str) -> None:
    with pytest.raises(DeclarationError) as refused:
        read(declared(tmp_path, with_channel(entry)))
    assert message in str(refused.value) and "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("pitch = { bit = 1", "pitch = { bit = 3", "bits axes: its bits are those of enum axis"),
        ("pitch = { value = 1", "pitch = { value = 4", "enum axis: its values count from 0"),
        ('name = "pitch_counts_per_rev"', 'name = "pitch_lines"', "no parameter pitch_counts_per_rev"),
        ('name = "pitch_count"', 'name = "travel_count"', "two are called travel_count"),
        ("max = 24\n", "", "lacks 'max'"),
        ("[enums.reset]", "[enums.channel]", "two are called channel"),
        ('name = "hello"', 'name = "ping"', "message: two are called ping"),
        ("id = 2\n", "id = 1\n", "two entries of [[message]] share a id"),
        ('name = "host_us", type = "u64"', 'name = "host_us", type = "u63"', "ping.host_us: no type u63"),
    ],
)
def test_a_contradiction_is_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in TEXT
    with pytest.raises(DeclarationError) as refused:
        read(declared(tmp_path, TEXT.replace(old, new, 1)))
    assert message in str(refused.value) and "\n" not in str(refused.value)


@pytest.mark.medium
def test_a_refusal_is_one_line_for_a_person_and_nothing_is_written(tmp_path: Path) -> None:
    source = declared(tmp_path, with_channel(channel("tick", "u32")))
    command = [sys.executable, str(ROOT / "firmware" / "generate.py"), "--source", str(source)]
    command += ["--root", str(tmp_path / "out")]
    process = subprocess.run(command, capture_output=True, text=True, check=False)
    assert process.returncode == 2 and process.stdout == ""
    assert process.stderr.count("\n") == 1 and process.stderr.startswith("link.toml: channel tick: ")
    assert not (tmp_path / "out").exists()


def test_a_missing_declaration_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(DeclarationError, match="cannot be read"):
        read(tmp_path / "link.toml")
