"""Doubts name the other value of what a file does not decide; entries that the user knows stay."""

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from heli_host.data.arrays import Floats
from heli_host.data.tables import Angle, Column, Profile, Table, Voltage
from heli_lab.setup.guess import Ambiguity, Guess, guess_by_rigs
from heli_lab.setup.guess.columns import prepare_file
from heli_lab.setup.guess.motion import (
    Assignment,
    Reference,
    RegressionFit,
    VoltageLimits,
    lag_ambiguities,
    pooled_fits,
    reference_of,
)
from heli_lab.setup.guess.names import AXES
from heli_lab.setup.guess.propose import ProposedGuess
from heli_lab.setup.guess.result import NOTHING_KNOWN, read_known
from heli_lab.setup.guess.signs import SignChanges, fewest_sign_changes, prefers_mirror, travel_torque_nats
from heli_lab.setup.guess.units import RestElevation, elevation_zero, limited, one_way_nats
from heli_sim.rig import Rig, load_rig

from tests.guess.test_columns import REFERENCE, flight_table

ASSIGNMENT = Assignment({role: role for role in (*AXES, "front", "back")})
REVERSING = Reference({}, {}, 6.0, -25.0, 1.0, {}, 12.0, reverses=True)
ONE_WAY = replace(REVERSING, reverses=False)
PROFILE = Profile(
    {axis: Angle(axis) for axis in AXES}, {"front": Voltage("front"), "back": Voltage("back")}, "t"
)


def fits(elevation_s: float, range_s: tuple[float, float], pitch_s: float = 0.1) -> dict[str, RegressionFit]:
    return {
        "elevation": RegressionFit(40.0, 1.0, elevation_s, range_s),
        "pitch": RegressionFit(40.0, 1.0, pitch_s, (pitch_s, pitch_s)),
        "travel": RegressionFit(40.0, 1.0, 0.0, (-0.02, 0.02)),
    }


def subjects(regressions: dict[str, RegressionFit]) -> list[str]:
    return [ambiguity.subject for ambiguity in lag_ambiguities(regressions)]


def test_a_short_delay_of_elevation_is_doubted_if_the_motion_excludes_the_lag_of_pitch() -> None:
    assert subjects(fits(0.18, (0.16, 0.20))) == ["elevation's time"]
    assert subjects(fits(0.18, (0.04, 0.30))) == []
    assert subjects(fits(0.16, (0.14, 0.18))) == []
    assert subjects(fits(0.02, (0.0, 0.04))) == []


def test_a_flight_that_stays_near_its_beginning_has_a_doubtful_zero() -> None:
    low = RestElevation(deg=-1.5, median_deg=5.0, begins_lowest=True)
    (ambiguity,) = elevation_zero(low, REVERSING)[1]
    assert ambiguity.subject == "the elevation's zero"
    assert elevation_zero(replace(low, median_deg=22.0), REVERSING) == (pytest.approx(-23.5), [])


def test_a_rest_beyond_the_tolerance_of_the_table_is_doubted() -> None:
    for rest_deg, is_doubted in ((-25.0, False), (-23.7, False), (-23.0, True), (-27.0, True)):
        rest = RestElevation(deg=rest_deg, median_deg=2.0, begins_lowest=True)
        offset_deg, ambiguities = elevation_zero(rest, REVERSING)
        assert (offset_deg, bool(ambiguities)) == (0.0, is_doubted), rest_deg


def test_a_doubt_of_a_weakly_excited_elevation_names_the_possible_delays() -> None:
    (ambiguity,) = lag_ambiguities(fits(0.22, (0.06, 0.40)))
    assert ambiguity.alternative == "0.12 s later than pitch (-0.04 to 0.30 s are possible)"
    (ambiguity,) = lag_ambiguities(fits(0.24, (0.22, 0.26)))
    assert ambiguity.alternative == "0.14 s later than pitch"


def test_voltages_that_act_without_any_lag_were_logged_late() -> None:
    (ambiguity,) = lag_ambiguities(fits(0.0, (0.0, 0.0), pitch_s=0.0))
    assert ambiguity.alternative == "late by about 0.10 s relative to the angles"
    assert "as only a simulation without rotor lag does" in ambiguity.reason
    assert subjects(fits(0.04, (0.04, 0.04), pitch_s=0.04)) == []


def test_the_possible_lags_of_several_files_are_averaged_by_their_weight() -> None:
    weak, strong = (
        {axis: RegressionFit(nats, 1.0, 0.1, (0.1 - half_s, 0.1 + half_s)) for axis in AXES}
        for nats, half_s in ((10.0, 0.08), (30.0, 0.04))
    )
    assert pooled_fits([weak, strong])["elevation"].lag_range_s == pytest.approx((0.05, 0.15))


def table(front_V: float, back_V: float) -> Table:
    """Rows that have these voltages in every tenth row, and 3 V in all others."""
    rows: Floats = np.arange(200, dtype=np.float64)
    columns = {name: Column(np.sin(0.01 * rows)) for name in AXES}
    for name, volts_V in (("front", front_V), ("back", back_V)):
        values: Floats = np.full(rows.size, 3.0)
        values[::10] = volts_V
        columns[name] = Column(values)
    return Table("x.csv", {"t": Column(0.01 * rows, "s"), **columns})


@pytest.mark.parametrize(
    ("nats", "reverses", "clip_V", "chosen"),
    [
        (1.0, True, None, None),
        (7.0, True, None, "as logged, down to -4.0 V"),
        (-1.0, False, (0.0, 12.0), "clipped to 0 V"),
        (-7.0, False, None, None),
    ],
)
def test_commands_below_zero_are_limited_as_the_motion_and_the_rig_say(
    nats: float, reverses: bool, clip_V: tuple[float, float] | None, chosen: str | None
) -> None:
    reference = REVERSING if reverses else ONE_WAY
    profile, ambiguities = limited([table(-4.0, 5.0)], PROFILE, reference, lambda: nats)
    assert profile.clip_V == clip_V
    assert [ambiguity.chosen for ambiguity in ambiguities] == ([chosen] if chosen else [])
    for ambiguity in ambiguities:
        assert {ambiguity.chosen, ambiguity.alternative} == {"clipped to 0 V", "as logged, down to -4.0 V"}
        assert "set clip_V to [0, 12]" in ambiguity.reason


def test_motors_that_seem_to_push_down_most_of_the_time_raise_no_question_of_limits() -> None:
    assert limited([table(-4.0, -5.0)], PROFILE, ONE_WAY, lambda: 0.0)[1] != []
    upside_down = {role: replace(voltage, sign=-1.0) for role, voltage in PROFILE.voltages.items()}
    assert limited([table(0.0, 5.0)], replace(PROFILE, voltages=upside_down), ONE_WAY, lambda: 0.0)[1] == []


def test_a_log_without_commands_below_zero_asks_no_question() -> None:
    def unused() -> float:
        raise AssertionError

    assert limited([table(0.0, 5.0)], PROFILE, ONE_WAY, unused) == (PROFILE, [])


def test_commands_below_zero_keep_the_limit_of_the_supply() -> None:
    profile, ambiguities = limited([table(-4.0, 15.0)], PROFILE, ONE_WAY, lambda: 7.0)
    assert profile.clip_V == (0.0, 12.0)
    assert [ambiguity.subject for ambiguity in ambiguities] == [
        "the voltages' limit",
        "the voltages' lower limit",
    ]


def test_the_better_explained_axes_decide_whether_motors_reverse() -> None:
    def regress(limits: VoltageLimits) -> Mapping[str, RegressionFit]:
        nats = 30.0 if limits.low == 0.0 else 20.0
        return {"elevation": RegressionFit(nats, 1.0), "pitch": RegressionFit(2.0 * nats, 1.0)}

    assert one_way_nats(regress, VoltageLimits(-5.0, 5.0)) == 30.0


@pytest.mark.medium
def test_the_travel_torque_weighs_mirror_images_against_each_other() -> None:
    file = prepare_file(flight_table(), REFERENCE, None)
    rad = dict.fromkeys(AXES, 1.0)
    nats, image = (travel_torque_nats(file.signals, ASSIGNMENT, REFERENCE, rad, sign) for sign in (1.0, -1.0))
    # Never as sure as a decision: one rig in ten pulls the other way.
    assert 0.0 < nats <= math.log(9.0)
    assert image == pytest.approx(-nats)
    without = reference_of(load_rig("makki2024"))
    assert travel_torque_nats(file.signals, ASSIGNMENT, without, rad, 1.0) == 0.0


def test_the_torque_decides_between_images_with_similarly_many_changes_of_sign() -> None:
    upright, turned = SignChanges(1.0, 1.0, 1.0, False), SignChanges(1.0, 1.0, -1.0, False)
    assert not prefers_mirror(upright, -2.2)
    assert prefers_mirror(turned, -2.0)
    assert not prefers_mirror(turned, -0.5)


def test_files_with_opposite_signs_weaken_each_other() -> None:
    def fits(nats: float, gain: float) -> dict[str, RegressionFit]:
        return {axis: RegressionFit(nats, gain, 0.1) for axis in AXES}

    agreeing, opposed = (
        pooled_fits([fits(4.0, 2.0), fits(5.0, 2.0)]),
        pooled_fits([fits(4.0, 2.0), fits(5.0, -2.0)]),
    )
    assert (agreeing["pitch"].log_likelihood_ratio, agreeing["pitch"].gain) == (9.0, 2.0)
    assert (opposed["pitch"].log_likelihood_ratio, opposed["pitch"].gain) == (1.0, -2.0)


def test_under_feedback_a_weak_elevation_has_the_sign_of_a_stable_loop() -> None:
    explained = {axis: RegressionFit(3.0, 1.0) for axis in AXES}
    assert fewest_sign_changes(explained, -1.0, NOTHING_KNOWN).elevation == 1.0
    assert fewest_sign_changes(explained, 1.0, NOTHING_KNOWN).elevation == -1.0


def test_known_entries_stay_and_their_doubts_vanish(tmp_path: Path) -> None:
    path = tmp_path / "known.toml"
    path.write_text('mirrored = true\n[pitch]\nsign = -1\n[voltages]\nunit = "percent"\nsupply_V = 9.0\n')
    known = read_known(path)
    applied = known.applied(PROFILE)
    assert applied.mirrored
    assert applied.angles["pitch"] == replace(PROFILE.angles["pitch"], sign=-1.0)
    assert applied.angles["travel"] == PROFILE.angles["travel"]
    assert {(v.unit, v.supply_V) for v in applied.voltages.values()} == {("percent", 9.0)}
    assert known.states(Ambiguity("the voltages' unit", "", "", ""))
    assert known.states(Ambiguity("which rotor is the front one", "", "", ""))
    assert not known.states(Ambiguity("travel's sign", "", "", ""))
    explained = {axis: RegressionFit(30.0, 1.0) for axis in AXES}
    assert fewest_sign_changes(explained, 0.0, known) == SignChanges(1.0, -1.0, -1.0, True)


def test_doubts_are_ranked_by_danger() -> None:
    subjects = ["the voltages' limit", "the columns", "which rotor is the front one", "travel's sign"]
    ranked = sorted((Ambiguity(subject, "", "", "") for subject in subjects), key=lambda doubt: doubt.danger)
    assert [doubt.entry for doubt in ranked] == [
        *("elevation.column", "travel.sign", "mirrored", "voltages.clip_V")
    ]


OTHER = replace(PROFILE, mirrored=True)


def patch_proposals(
    monkeypatch: pytest.MonkeyPatch, nats: dict[str, float], profiles: dict[str, Profile]
) -> None:
    def propose(tables: list[Table], rig: Rig, *_: object) -> ProposedGuess:
        guess = Guess(profiles.get(rig.name, PROFILE), (), (), log_likelihood=nats[rig.name])
        return ProposedGuess(guess, tables)

    monkeypatch.setattr("heli_lab.setup.guess.propose.propose", propose)
    monkeypatch.setattr(
        "heli_lab.setup.guess.propose.check_by_simulation",
        lambda proposal, _rig: [proposal.guess for _ in proposal.longest_parts],
    )


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


@pytest.mark.parametrize(
    ("axis", "angle", "sentence"),
    [
        ("travel", Angle("travel", "count", 8192.0), "travel 8192, or others"),
        ("elevation", Angle("elevation", "deg", offset_deg=-30.0), "-30 deg added"),
    ],
)
def test_numbers_of_a_rig_that_the_user_has_not_named_are_a_doubt(
    axis: str, angle: Angle, sentence: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    nats = {"makki2024": 10.0, "makki2024-identified": 0.0, "quanser-course": 50.0}
    from_rig = replace(PROFILE, angles={**PROFILE.angles, axis: angle})
    patch_proposals(monkeypatch, nats, {"quanser-course": from_rig})
    assert sentence in guess_by_rigs(TABLES).guesses[0].ambiguities[-1].sentence()
    assert all(item.sure for item in guess_by_rigs(TABLES, load_rig("quanser-course")).guesses)
