"""Columns, limits and mirror images are weighed by all evidence, and what the user knows stays."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from heli_host.data.arrays import Floats
from heli_host.data.tables import Angle, Column, Profile, Table, Voltage
from heli_host.errors import FlightDataError
from heli_lab.setup.guess import merge_tables
from heli_lab.setup.guess.ambiguities import SignChanges
from heli_lab.setup.guess.evidence import pooled_fits, prepare_file, rank
from heli_lab.setup.guess.known import NOTHING_KNOWN, read_known
from heli_lab.setup.guess.mirror import prefers_mirror, travel_torque_nats
from heli_lab.setup.guess.refusals import too_few_columns
from heli_lab.setup.guess.regression.acceleration_fit import RegressionFit
from heli_lab.setup.guess.regression.assignment import ColumnAssignment
from heli_lab.setup.guess.regression.candidates import candidates
from heli_lab.setup.guess.regression.reference import reference_of
from heli_lab.setup.guess.regression.scales import AXES, scales
from heli_lab.setup.guess.result import Ambiguity
from heli_lab.setup.guess.run import fewest_sign_changes
from heli_lab.setup.guess.times import longest_run
from heli_sim.rig import load_rig

from tests.guess.pilots import piloted

RIG = load_rig("quanser-course")
REFERENCE = reference_of(RIG)
ASSIGNMENT = ColumnAssignment("e", "p", "l", ("f", "b"), False, (1.0, 1.0), 0.0, 0.0)
PROFILE = Profile({axis: Angle(axis) for axis in AXES}, {"front": Voltage("f"), "back": Voltage("b")}, "t")


def table_of(pilot: str, seed: int = 3, commands: bool = False) -> Table:
    source = piloted("quanser-course", pilot, seed, 25.0)
    flight, every = source.flight, slice(None, None, 5)
    volts = source.commands_V if commands else flight.voltages_V
    named = {"e": flight.elevation_rad, "p": flight.pitch_rad, "l": flight.travel_rad}
    named |= {"f": volts[:, 0], "b": volts[:, 1], "edot": source.rates_rad_s[:, 0]}
    return Table("x.csv", {"t": Column(flight.t_s[every])} | {n: Column(v[every]) for n, v in named.items()})


@pytest.mark.medium
@pytest.mark.parametrize("gain", [1.0, 0.05], ids=["volts", "the size of the rate"])
def test_a_sum_that_follows_the_rate_of_elevation_is_no_duplicate(gain: float) -> None:
    table = table_of("hands off")
    total = table.columns["f"].values + table.columns["b"].values
    columns = {**table.columns, "u1": Column(gain * (total - total.mean()))}
    file = prepare_file(Table("x.csv", columns), REFERENCE, None)
    kept, dropped = candidates(file.signals, file.encoders)
    assert "u1" in kept
    assert dropped["edot"] == "the rate of e"


@pytest.mark.medium
def test_commands_beyond_the_supply_are_limited_before_their_unit_is_found() -> None:
    file = prepare_file(table_of("manual", commands=True), REFERENCE, None)
    ranked, (motion,) = rank([file], ["e", "p", "l", "f", "b"], REFERENCE, NOTHING_KNOWN)
    assert ranked[0].same_as(ASSIGNMENT)
    limited, as_logged = (scales(m, REFERENCE) for m in (motion, replace(motion, limited={})))
    assert limited[0].voltage == "V"
    margin, before = (
        each[0].log_likelihood - next(s for s in each if s.voltage != "V").log_likelihood
        for each in (limited, as_logged)
    )
    assert margin > before


@pytest.mark.medium
def test_the_travel_torque_weighs_mirror_images_against_each_other() -> None:
    file = prepare_file(table_of("travel"), REFERENCE, None)
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


@pytest.mark.medium
def test_a_known_column_keeps_its_role_against_all_evidence(tmp_path: Path) -> None:
    path = tmp_path / "known.toml"
    path.write_text('[front]\ncolumn = "b"\n')
    file = prepare_file(table_of("travel"), REFERENCE, None)
    ranked, _ = rank([file], ["e", "p", "l", "f", "b"], REFERENCE, read_known(path))
    assert ranked[0].voltages == ("b", "f")


def test_doubts_are_ranked_by_danger() -> None:
    subjects = ["the voltages' limit", "the columns", "which rotor is the front one", "travel's sign"]
    ranked = sorted((Ambiguity(subject, "", "", "") for subject in subjects), key=lambda doubt: doubt.danger)
    assert [doubt.entry for doubt in ranked] == [
        *("elevation.column", "travel.sign", "mirrored", "voltages.clip_V")
    ]


def test_files_of_equal_length_are_merged_row_by_row_and_the_notes_state_it() -> None:
    t_s: Floats = np.arange(50, dtype=np.float64) * 0.01
    x = Table("a/x.mat", {"t": Column(t_s, "s"), "p": Column(np.sin(t_s))})
    u = Table("a/u.mat", {"f": Column(np.cos(9.0 * t_s))})
    merged = merge_tables([x, u])
    assert list(merged.columns) == ["1: p", "2: f"]
    assert merged.columns["2: f"].t_s == pytest.approx(t_s)
    assert merged.notes == "u.mat was merged row by row with x.mat"
    with pytest.raises(FlightDataError, match=r"u.mat: it has no times, and no other .* its 40 rows"):
        merge_tables([x, Table("a/u.mat", {"f": Column(np.cos(9.0 * t_s[:40]))})])


def test_a_file_without_voltages_is_refused_with_that_reason_and_a_fix() -> None:
    named = too_few_columns("x.mat", ["elevation", "pitch", "travel"], {"pitch_dot": "the rate of pitch"})
    assert named.cause == "x.mat: no column is a motor voltage; left out: pitch_dot (the rate of pitch)"
    assert "--one-flight" in named.remedy
    unnamed = too_few_columns("x.mat", ["x[1]", "x[2]"], {})
    assert unnamed.cause == "x.mat: fewer than five columns can be an angle or a voltage: x[1], x[2]"


@pytest.mark.parametrize("jump", [0.0, math.radians(21.0)])
def test_a_jump_of_an_encoder_ends_the_part_that_is_guessed(jump: float) -> None:
    step = 2.0 * math.pi / 4096.0
    t_s: Floats = np.arange(1000, dtype=np.float64) * 0.01
    angle: Floats = np.round(0.4 * np.sin(t_s) / step) * step + np.where(t_s > 6.0, jump, 0.0)
    voltage: Floats = 3.0 + 0.3 * np.sin(7.0 * t_s) + np.where(t_s > 3.0, 4.0, 0.0)
    part, _ = longest_run(Table("x", {"p": Column(angle), "u": Column(voltage)}), t_s)
    assert len(part) == (601 if jump else 1000)
