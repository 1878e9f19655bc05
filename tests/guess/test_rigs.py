"""A log is held against the rig given, and a better one is named; or against the nearest, if none is."""

from __future__ import annotations

from dataclasses import replace

import pytest
from heli_host.tables import Angle, Profile, Table, Voltage
from heli_lab.guess import Guess, guess_by_rigs, rigs
from heli_sim.rig import Rig, load_rig

PROFILE = Profile(
    {axis: Angle(axis) for axis in ("elevation", "pitch", "travel")},
    {"front": Voltage("f"), "back": Voltage("b")},
    "t",
)
OTHER = replace(PROFILE, mirrored=True)


def told(monkeypatch: pytest.MonkeyPatch, nats: dict[str, float], profiles: dict[str, Profile]) -> None:
    def proposed(table: Table, rig: Rig, rate_Hz: float | None = None) -> tuple[Guess, Table]:
        return Guess(profiles.get(rig.name, PROFILE), (), (), nats=nats[rig.name]), table

    monkeypatch.setattr(rigs, "proposed", proposed)
    monkeypatch.setattr(rigs, "flown", lambda guessed, _table, _rig: guessed)


TABLES = [Table("a.csv", {}), Table("b.csv", {})]


def test_without_a_rig_the_nearest_is_taken_and_named(monkeypatch: pytest.MonkeyPatch) -> None:
    told(
        monkeypatch,
        {"makki2024": 10.0, "makki2024-identified": 0.0, "quanser-course": 50.0},
        {"quanser-course": OTHER},
    )
    found = guess_by_rigs(TABLES)
    assert found.rig.name == "quanser-course"
    assert all(one.sure and one.profile == OTHER for one in found.guesses)
    # Two files of 50 nats each, and of 10.
    assert (
        "held against quanser-course; makki2024's numbers fit by 80 nats worse"
        in found.guesses[0].evidence[0]
    )


def test_two_rigs_that_fit_alike_are_a_doubt_only_if_they_say_other_things(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    nats = {"makki2024": 49.0, "makki2024-identified": 0.0, "quanser-course": 50.0}
    told(monkeypatch, nats, {"quanser-course": OTHER})
    assert [doubt.what for one in guess_by_rigs(TABLES).guesses for doubt in one.doubts] == ["the rig"] * 2
    told(monkeypatch, nats, {})
    assert all(one.sure for one in guess_by_rigs(TABLES).guesses)


def test_a_rig_that_was_given_is_kept_and_a_better_one_is_a_doubt(monkeypatch: pytest.MonkeyPatch) -> None:
    given = load_rig("makki2024")
    nats = {"makki2024": 10.0, "makki2024-identified": 0.0, "quanser-course": 50.0}
    told(monkeypatch, nats, {"quanser-course": OTHER})
    found = guess_by_rigs(TABLES, given)
    assert found.rig.name == "makki2024"
    (doubt,) = found.guesses[0].doubts
    assert "--rig quanser-course" in doubt.sentence()
    told(monkeypatch, nats | {"makki2024": 49.0}, {"quanser-course": OTHER})
    assert all(one.sure for one in guess_by_rigs(TABLES, given).guesses)
