"""A blind flight and a blind export give nothing away, and their seal settles the answer beforehand."""

import base64
import binascii
import contextlib
import json
import re
import shutil
import stat
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from heli_host.board.twins import EVENT
from heli_host.data.log.blind import blind, hide
from heli_host.data.log.reader import read_flight, read_log
from heli_host.data.log.table import notes_path
from heli_host.ui.cli import run
from heli_sim.rig import load_rig, write_rig

from tests.cli.terminal import Terminal, refusal

pytestmark = pytest.mark.medium

EFFECT, SIZE, SEED, RIG = "rotor_lag", "0.08371", "918273645", "workshop_rig"
SECRETS = (EFFECT, SIZE, SEED, RIG, "makki2024", "sil://", "effect=", "thrust_gain")
SHORT = "title = 'Short'\n[start]\nsettle_s = 1\n[[segment]]\nkind = 'hold'\nduration_s = 2\n"
FLOWN = ("short.toml", "--sil", "--rig", f"{RIG}.toml", "--effect", f"{EFFECT}={SIZE}", "--speed", "max")
FORMATS = {"--csv": "a.csv", "--mat": "a.mat", "--parquet": "a.parquet", "--ros2": "a.ros2.mcap"}


def write_inputs(folder: Path) -> None:
    (folder / "short.toml").write_text(SHORT)
    write_rig(load_rig("makki2024").replace(thrust_gain=0.6), folder / f"{RIG}.toml")


@pytest.fixture
def short(terminal: Terminal, tmp_path: Path) -> Terminal:
    write_inputs(tmp_path)
    return terminal


@pytest.fixture(scope="module")
def open_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The log of a flight that hides nothing."""
    folder = tmp_path_factory.mktemp("open")
    write_inputs(folder)
    with contextlib.chdir(folder):
        assert run(["fly", *FLOWN, "--seed", SEED, "--log", "a.mcap"]) == 0
    return folder / "a.mcap"


def texts(path: Path) -> Iterator[bytes]:
    """All that a file holds, compressed parts unpacked."""
    data = path.read_bytes()
    yield data
    if path.suffix == ".mcap":
        yield from mcap_records(path)
    if path.suffix == ".csv":
        yield notes_path(path).read_bytes()
    if path.suffix == ".mat":
        yield from mat_elements(data)
    for word in re.findall(rb"[A-Za-z0-9+/]{40,}={0,2}", data) if path.suffix == ".parquet" else ():
        try:
            yield base64.b64decode(word + b"=" * (-len(word) % 4))
        except binascii.Error:
            continue


def mcap_records(path: Path) -> Iterator[bytes]:
    from mcap.stream_reader import StreamReader

    with path.open("rb") as file:
        for record in StreamReader(file).records:
            for value in vars(record).values():
                yield value if isinstance(value, bytes) else str(value).encode()


def mat_elements(data: bytes) -> Iterator[bytes]:
    place = 128
    while place < len(data):
        kind, size = (int.from_bytes(data[place + at : place + at + 4], "little") for at in (0, 4))
        assert kind == 15, "each element is compressed"
        unpacked = zlib.decompress(data[place + 8 : place + 8 + size])
        # MATLAB's texts have two bytes a character.
        yield from (unpacked, unpacked.replace(b"\0", b""))
        place += 8 + size


def given_away(path: Path) -> set[str]:
    return {word for word in SECRETS for text in texts(path) if word.encode() in text}


def sealed_of(path: Path) -> str:
    seals: set[str] = {
        seal.decode() for text in texts(path) for seal in re.findall(rb"sha256:[0-9a-f]{64}", text)
    }
    (sealed,) = seals
    return sealed


@pytest.mark.slow
def test_a_blind_flight_gives_nothing_away_in_any_of_its_files(short: Terminal, tmp_path: Path) -> None:
    files = ("--log", "a.mcap", "--json", "a.json", "--figure", "a.svg")
    result = short("fly", *FLOWN, "--seed", SEED, "--blind", *files)
    assert result.code == 0, result
    assert "truth (keep it, share only the other files): a.truth.json" in result.out
    assert not [word for word in SECRETS if word in result.out.replace("a.truth.json", "")]
    for name in ("a.mcap", "a.json", "a.svg"):
        assert given_away(tmp_path / name) == set(), name
    log = read_log("a.mcap")
    assert "boot_id" not in log.metadata["session"], "the seed settles it"
    for option, name in FORMATS.items():
        assert short("export", "a.mcap", option).code == 0
        assert given_away(tmp_path / name) == set(), name
    shown = short("info", "a.mcap", "--events", "--params", "--plan")
    assert not [word for word in SECRETS if word in shown.out]
    assert not [word for word in SECRETS if word in short("info", "a.mcap", "--json", "-").out]


@pytest.mark.slow
def test_the_same_flight_without_blind_does_give_it_away(
    short: Terminal, open_log: Path, tmp_path: Path
) -> None:
    shutil.copy(open_log, tmp_path)
    for name in ("a.mcap", *FORMATS.values()):
        if name in FORMATS.values():
            (option,) = [option for option, file in FORMATS.items() if file == name]
            assert short("export", "a.mcap", option).code == 0
        assert {EFFECT, SIZE, SEED, RIG, "sil://"} <= given_away(tmp_path / name), name


def test_a_blind_export_of_an_open_log_gives_nothing_away(
    short: Terminal, open_log: Path, tmp_path: Path
) -> None:
    shutil.copy(open_log, tmp_path)
    seals = set()
    for option, name in FORMATS.items():
        assert short("export", "a.mcap", option, "--blind").code == 0
        assert given_away(tmp_path / name) == set(), name
        seals.add(sealed_of(tmp_path / name))
    assert len(seals) == 1, "all exports of a log have one seal"
    there = short("export", "a.mcap", "--csv", "--blind", "--output", "-")
    assert seals.pop() in there.out and "a.truth.json" not in there.out
    whole, bare = read_flight("a.mcap"), read_flight("a.csv")
    np.testing.assert_allclose(bare.front_V, whole.front_V, atol=1e-6)
    assert dict(whole.parameters) == dict(bare.parameters) and len(whole.events) == len(bare.events)
    # The log itself, and the export, each match the truth file.
    for file in ("a.mcap", "a.csv"):
        result = short("info", file, "--truth", "a.truth.json")
        assert result.code == 0 and f"{EFFECT}%3D{SIZE}" in result.out


def test_the_truth_file_settles_what_flew(short: Terminal, tmp_path: Path) -> None:
    for name in ("a", "b"):
        assert short("fly", *FLOWN, "--blind", "--log", f"{name}.mcap").code == 0
    key = tmp_path / "a.truth.json"
    assert stat.S_IMODE(key.stat().st_mode) == 0o600
    result = short("info", "a.mcap", "--truth", "a.truth.json")
    assert f"truth, effects: {EFFECT}={SIZE}" in result.out and f"truth, rig: {RIG}.toml" in result.out
    truth: dict[str, Any] = json.loads(short("info", "a.mcap", "--truth", "a.truth.json", "--json", "-").out)[
        "truth"
    ]
    assert truth["sealed"] == sealed_of(tmp_path / "a.mcap") == json.loads(key.read_text())["sealed"]
    assert "thrust_gain" in truth["files"][f"{RIG}.toml"], "the rig's numbers are sealed too"
    # Without --seed each flight has a seed of its own, and the salt makes equal truths unequal.
    seeds = {json.loads((tmp_path / f"{name}.truth.json").read_text())["flown"]["seed"] for name in "ab"}
    assert len(seeds) == 2 and 1 not in seeds
    assert "does not match" in refusal(short("info", "b.mcap", "--truth", "a.truth.json"), code=5)
    key.write_text(key.read_text().replace(SIZE, "0.2"))
    assert "one of the two files was changed" in refusal(
        short("info", "a.mcap", "--truth", "a.truth.json"), code=5
    )
    (tmp_path / "none.json").write_text("[1]")
    assert "is not a truth file" in refusal(short("info", "a.mcap", "--truth", "none.json"), code=5)


def test_blind_is_refused_where_it_would_hide_nothing(short: Terminal, tmp_path: Path) -> None:
    refused = short("fly", "short.toml", "--port", "/dev/null", "--blind")
    assert refused.code == 2 and "--blind is for a simulated board only; add --sil" in refused.err
    result = short("fly", *FLOWN, "--blind", "--twin", "makki2024")
    assert result.code == 2 and "--twin names what has changed" in result.err
    assert not list(tmp_path.glob("*.truth.json"))


def test_texts_of_events_lose_addresses_and_boot_ids() -> None:
    lost = "lost sil://?rig=x&effect=rotor_lag%3D0.1&seed=7: unplugged; check cable"
    assert hide(lost) == "lost the board: unplugged; check cable"
    assert hide("board started (power_up), boot id 123456") == "board started (power_up), boot id hidden"
    assert hide("fault elevation_limit: 30.1 deg") == "fault elevation_limit: 30.1 deg"


def test_an_export_leaves_out_what_a_twin_said_and_notes_of_others(
    short: Terminal, open_log: Path, tmp_path: Path
) -> None:
    shutil.copy(open_log, tmp_path)
    assert short("export", "a.mcap", "--csv").code == 0
    table = tmp_path / "a.csv"
    notes = (
        f"# event.{EVENT}: 3.0 the rotors lag by {SIZE} s\n# remark: hidden is {EFFECT}\n# {EFFECT} it is\n"
    )
    table.write_text(notes + table.read_text())
    assert EFFECT in str(read_flight(table).meta) and EVENT in {
        event.name for event in read_flight(table).events
    }
    bare = blind(read_flight(table), "sha256:0")
    assert not [word for word in SECRETS if word in str(bare.meta) + str(bare.events)]
    assert bare.meta["sealed"] == "sha256:0"
    assert len(bare.events) == len(read_flight(table).events) - 1
