"""File of a search's estimates: another search refuses it, and an interruption does not spoil it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from heli_lab import code_digest
from heli_lab.errors import IdentifyError
from heli_lab.explain.comparison import EstimateCache, fingerprint
from heli_lab.fit.records import Record, prepare
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import parse_effects
from heli_sim.rig import load_rig

from tests.diagnose.hidden import hovering

pytestmark = pytest.mark.medium


def _record() -> Record:
    """Return a short record."""
    return prepare(hovering(4.0), load_rig("makki2024"), "still")


def test_flights_rigs_models_and_parts_have_different_digests() -> None:
    rig, record = load_rig("makki2024"), _record()
    start, stop = record.segments[0]
    variants = (
        (MultibodyModel(), rig, [record]),
        (MultibodyModel(parse_effects(["rotor_lag=0.05"])), rig, [record]),
        (MultibodyModel(), rig.replace(thrust_gain=0.5), [record]),
        (MultibodyModel(), rig, [replace(record, angles_rad=record.angles_rad + 1e-9)]),
        (MultibodyModel(), rig, [replace(record, segments=((start, stop - 1),))]),
        (MultibodyModel(), rig, [record, record]),
    )
    digests = [fingerprint(*variant) for variant in variants]
    assert len(set(digests)) == len(digests)
    assert fingerprint(*variants[0]) == digests[0]


def test_fingerprint_changes_with_the_compiled_filter(monkeypatch: pytest.MonkeyPatch) -> None:
    arguments = MultibodyModel(), load_rig("makki2024"), [_record()]
    before, read = fingerprint(*arguments), Path.read_bytes

    def rebuilt(path: Path) -> bytes:
        return read(path) + (b"rebuilt" if path.name.startswith("_kalman.") else b"")

    monkeypatch.setattr(Path, "read_bytes", rebuilt)
    code_digest.package_digest.cache_clear()
    after = fingerprint(*arguments)
    code_digest.package_digest.cache_clear()
    assert after != before


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b'{"search_of": "other"}\n', "is from a search with other flights"),
        (b"t_s,front_V\n0,1\n", "is not a --resume file"),
        (b"[1, 2]\n", "is not a --resume file"),
        (b"\xff\xfe\n", "is not a --resume file"),
    ],
)
def test_file_of_another_kind_is_refused_and_not_changed(tmp_path: Path, content: bytes, words: str) -> None:
    (tmp_path / "search").write_bytes(content)
    with pytest.raises(IdentifyError, match=words):
        EstimateCache(tmp_path / "search", "mine")
    assert (tmp_path / "search").read_bytes() == content


def test_incomplete_last_line_is_dropped_and_earlier_lines_stay(tmp_path: Path) -> None:
    path = tmp_path / "search"
    EstimateCache(path, "mine")
    head = path.read_bytes()
    path.write_bytes(head + b'{"key": "a"}\n{"key": "b", "the')
    EstimateCache(path, "mine")
    assert path.read_bytes() == head + b'{"key": "a"}\n'
