"""A log is compared with the given rig, and a better one is reported; without one, the best rig is used."""

from __future__ import annotations

from dataclasses import replace

import pytest
from heli_host.data.tables import Angle, Profile, Table, Voltage
from heli_lab.setup.guess import Guess, guess_by_rigs, rigs
from heli_sim.rig import Rig, load_rig

PROFILE = Profile(
    {axis: Angle(axis) for axis in ("elevation", "pitch", "travel")},
    {"front": Voltage("f"), "back": Voltage("b")},
    "t",
)
OTHER = replace(PROFILE, mirrored=True)


def patch_proposals(
    monkeypatch: pytest.MonkeyPatch, nats: dict[str, float], profiles: dict[str, Profile]
) -> None:
    def propose(tables: list[Table], rig: Rig, *_: object) -> tuple[Guess, list[Table]]:
        return Guess(profiles.get(rig.name, PROFILE), (), (), log_likelihood=nats[rig.name]), tables

    monkeypatch.setattr(rigs, "propose", propose)
    monkeypatch.setattr(rigs, "check_by_simulation", lambda guessed, tables, _rig: [guessed for _ in tables])


TABLES = [Table("a.csv", {}), Table("b.csv", {})]


def test_without_a_rig_the_nearest_is_taken_and_named(monkeypatch: pytest.MonkeyPatch) -> None:
    patch_proposals(
        monkeypatch,
        {"makki2024": 10.0, "makki2024-identified": 0.0, "quanser-course": 50.0},
        {"quanser-course": OTHER},
    )
    guess_result = guess_by_rigs(TABLES)
    assert guess_result.rig.name == "quanser-course"
    assert all(item.sure and item.profile == OTHER for item in guess_result.guesses)
    assert "compared with quanser-course; makki2024 fits 40 nats worse" in guess_result.guesses[0].evidence[0]


def test_two_rigs_that_fit_alike_are_a_doubt_only_if_they_say_other_things(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    nats = {"makki2024": 49.0, "makki2024-identified": 0.0, "quanser-course": 50.0}
    patch_proposals(monkeypatch, nats, {"quanser-course": OTHER})
    assert [
        ambiguity.subject for item in guess_by_rigs(TABLES).guesses for ambiguity in item.ambiguities
    ] == ["the rig"] * 2
    patch_proposals(monkeypatch, nats, {})
    assert all(item.sure for item in guess_by_rigs(TABLES).guesses)


def test_a_rig_that_was_given_is_kept_and_a_better_one_is_a_doubt(monkeypatch: pytest.MonkeyPatch) -> None:
    given = load_rig("makki2024")
    nats = {"makki2024": 10.0, "makki2024-identified": 0.0, "quanser-course": 50.0}
    patch_proposals(monkeypatch, nats, {"quanser-course": OTHER})
    guess_result = guess_by_rigs(TABLES, given)
    assert guess_result.rig.name == "makki2024"
    (ambiguity,) = guess_result.guesses[0].ambiguities
    assert "--rig quanser-course" in ambiguity.sentence()
    patch_proposals(monkeypatch, nats | {"makki2024": 49.0}, {"quanser-course": OTHER})
    assert all(item.sure for item in guess_by_rigs(TABLES, given).guesses)
