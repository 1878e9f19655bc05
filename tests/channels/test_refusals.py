"""The generator refuses a mistake in one line with place and reason, and then writes nothing."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from firmware.generator.declared import DeclarationError, read
from tests.channels.changed_copy import DECLARATION, ROOT, channel

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
