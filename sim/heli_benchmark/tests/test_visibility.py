"""Disturbances, and the visibility of a cause in standard deviations of the disturbances."""

from collections import Counter
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from heli_host.data.arrays import Floats
from heli_host.data.flight import Flight
from heli_sim.rig import load_rig
from heli_sim.rig.rig import count_rad

from heli_benchmark.cases.clean import clean_cases
from heli_benchmark.cases.disturbed import QUANSER_RIG, SIZES, DisturbedCase, RATES_Hz, disturbed_cases
from heli_benchmark.effects.disturbances import (
    CORRELATION_TIMES_s,
    DisturbanceModel,
    DisturbanceTorques,
    STRENGTHS_Nm,
)
from heli_benchmark.effects.listed import LISTED, MEASURED_EFFECTS, MORE_LISTED
from heli_benchmark.effects.unlisted import DISTURBED
from heli_benchmark.plant import STEP_S, Moment, TrueTrajectory
from heli_benchmark.visibility import (
    FINE,
    CauseContribution,
    Forces,
    LinearisedRig,
    ReplayedRig,
    acts_by_itself,
    imitators,
    inertia_kg_m2,
    residual_norm,
    steps,
    visibility,
)
from tests.running.long import samples

CASES = {case.name: case for case in disturbed_cases()}
LAW = "w-off-pitch_by_elevation"
DURATION_s = 10.0


@cache
def flown(name: str) -> tuple[DisturbedCase, TrueTrajectory]:
    return CASES[name], CASES[name].fly(0, DURATION_s)[1]


def chance(case: DisturbedCase, trajectory: TrueTrajectory) -> CauseContribution:
    """The gusts as they blew, and errors of as many counts as the encoders have, each by itself."""
    case_without_causes = replace(case, effects=(), unlisted=(), makers=())
    rig = case.rig().replace(torque_elevation=0.0, torque_pitch=0.0, torque_travel=0.0)
    torque = ReplayedRig(rig, case_without_causes.hidden(0)).forces(trajectory).torque_Nm
    errors = np.random.default_rng(1).uniform(-0.5, 0.5, (steps(trajectory), 3)) * count_rad(rig)
    return CauseContribution(torque.reshape(-1, FINE, 3).mean(axis=1), errors)


@pytest.mark.slow
@pytest.mark.parametrize("on_course", [False, True][: samples(2, 1)])
def test_disturbances_leave_white_innovations_of_unit_variance(on_course: bool) -> None:
    name = next(
        name
        for name, case in CASES.items()
        if case.kind == "nothing" and (case.rig_name == QUANSER_RIG) is on_course
    )
    case = CASES[name]
    trajectory = case.fly(0, 2.0 * DURATION_s)[1]
    white = LinearisedRig(trajectory, case.rig(), case.disturbances).innovations([chance(case, trajectory)])[
        :, 0
    ]
    by_axis = white.reshape(-1, 3)[25:]
    # 975 innovations an axis: variances to 4.5 %, correlations to 0.032; four of those.
    np.testing.assert_allclose(by_axis.var(axis=0), 1.0, atol=0.18)
    for lag in (1, 2, 5, 25):
        correlation = (by_axis[lag:] * by_axis[:-lag]).mean(axis=0)
        np.testing.assert_allclose(correlation, 0.0, atol=0.13)


@pytest.mark.slow
def test_visibility_is_the_ratio_of_the_size_to_the_disturbances() -> None:
    case, trajectory = flown(LAW)
    rig, forces = case.rig(), ReplayedRig(case.rig(), case.hidden(0)).forces(trajectory)
    torque: Floats = np.zeros((steps(trajectory), 3))
    torque[:, 1] = case.unlisted[0][1] * trajectory.angles_rad[20::40, 0]
    nothing = np.zeros_like(torque)
    elevation, pitch, travel = case.disturbances.gusts_Nm
    strong = replace(case.disturbances, gusts_Nm=(2.0 * elevation, 2.0 * pitch, 2.0 * travel))
    visibilities = []
    for size, disturbances in ((1.0, case.disturbances), (2.0, case.disturbances), (1.0, strong)):
        line = LinearisedRig(trajectory, rig, disturbances)
        white = line.innovations(
            [CauseContribution(size * torque, nothing), *imitators(rig, trajectory, forces, line)]
        )
        visibilities.append(residual_norm(white, 0, 1))
    assert visibilities[1] == pytest.approx(2.0 * visibilities[0], rel=1e-6)
    assert 0.45 * visibilities[0] < visibilities[2] < 0.75 * visibilities[0]
    assert visibility(case, DURATION_s)["off-pitch_by_elevation"] == pytest.approx(visibilities[0], rel=0.01)


@pytest.mark.slow
def test_what_another_number_of_the_rig_can_be_does_not_stand_out() -> None:
    case, trajectory = flown(LAW)
    rig, forces = case.rig(), ReplayedRig(case.rig(), case.hidden(0)).forces(trajectory)
    line = LinearisedRig(trajectory, rig, case.disturbances)
    others = imitators(rig, trajectory, forces, line)
    # Thrust a tenth stronger, which the rig's file allows.
    stronger = Forces(1.1 * forces.thrust_N, forces.torque_Nm, forces.encoder_rad)
    plain = ReplayedRig(rig, ())
    change = plain.accelerations(trajectory, stronger) - plain.accelerations(trajectory, forces)
    gain = CauseContribution(line.torque(change, FINE), np.zeros((steps(trajectory), 3)))
    norm_alone = np.linalg.norm(line.innovations([gain]))
    assert norm_alone > 30.0
    assert residual_norm(line.innovations([gain, *others]), 0, 1) < 3.0


@pytest.mark.medium
def test_without_a_cause_nothing_is_asked() -> None:
    assert visibility(CASES["w-nothing-0"]) == {}


@pytest.mark.medium
def test_inertias_are_those_of_the_masses() -> None:
    rig = CASES["w-nothing-0"].rig()
    v = {name: rig[name].value for name in rig}
    inertia = inertia_kg_m2(rig, np.zeros((1, 3)))[0]
    carried_kg = v["M_f"] + v["M_b"] + v["M_h"]
    along = carried_kg * v["L_a"] ** 2 + v["M_l"] * v["L_x"] ** 2 + v["M_w"] * v["L_b"] ** 2
    below = carried_kg * (v["L_theta"] + v["L_phi"]) ** 2 + (v["M_l"] + v["M_w"]) * v["L_theta"] ** 2
    assert inertia[0, 0] == pytest.approx(along + below, rel=1e-3)
    np.testing.assert_allclose(inertia, inertia.T, atol=1e-9)


@pytest.mark.medium
@pytest.mark.parametrize(
    ("name", "asks"),
    [("coulomb_friction.pitch", False), ("inflow_damping", True), ("zero_offset.pitch", True)],
)
def test_only_what_acts_by_itself_asks_for_its_forces_again(name: str, asks: bool) -> None:
    assert acts_by_itself(CASES[f"w-lag+{name}"].hidden(0)[1]) is asks


@cache
def disturbances_flown(name: str) -> tuple[Flight, TrueTrajectory]:
    return CASES[name].fly(0, 3.0)


def torques(disturbances: DisturbanceModel, seed: int, duration_s: float) -> Floats:
    """Torques of the disturbances on a rig at rest, shape (n, 3)."""
    air = DisturbanceTorques(disturbances, np.random.default_rng(seed))
    rows = []
    for k in range(0, round(duration_s / STEP_S), 20):
        at = Moment(0.0, k * STEP_S, np.zeros(2), np.zeros(2), np.zeros(3), np.zeros(3))
        air.torque(at)
        rows.append(at.torque_Nm)
    return np.array(rows)


def test_half_of_all_cases_have_disturbances_and_names_and_seeds_are_unique() -> None:
    clean = clean_cases()
    both = [*clean, *CASES.values()]
    assert 0.5 <= len(CASES) / len(both) <= 0.55
    assert len({case.name for case in both}) == len({case.seed for case in both}) == len(both)
    assert len(disturbed_cases()) == len(CASES)


def test_forty_rigs_and_more_have_disturbances_and_nothing_else() -> None:
    assert sum(case.kind == "nothing" for case in CASES.values()) >= 40


def test_most_that_have_a_cause_have_a_lag_of_about_a_tenth_of_a_second() -> None:
    some = [case for case in CASES.values() if case.kind != "nothing"]
    lags = [size for case in some for name, size in case.effects if name in ("rotor_lag", "rotor_speed_lag")]
    assert len(lags) > 0.6 * len(some)
    assert 0.08 <= min(lags) <= max(lags) <= 0.145


@pytest.mark.parametrize("on_course", [False, True])
def test_strengths_memories_rates_and_controllers_occur_on_both_rigs(on_course: bool) -> None:
    some = [case for case in CASES.values() if (case.rig_name == QUANSER_RIG) is on_course]
    assert {case.disturbances.gusts_Nm for case in some} == set(STRENGTHS_Nm)
    assert {case.disturbances.correlation_time_s for case in some} == set(CORRELATION_TIMES_s)
    assert {case.rate_Hz for case in some} == set(RATES_Hz)
    assert len({case.controller for case in some}) == 3
    assert (
        {case.gentle for case in some}
        == {any(case.disturbances.slow_std_Nm) for case in some}
        == {True, False}
    )


def test_one_to_four_causes_are_hidden_and_each_visible_effect_occurs() -> None:
    counts = Counter(len(case.effects) for case in CASES.values() if case.kind in ("one", "several"))
    assert set(counts) == {1, 2, 3, 4}
    hidden = {name for case in CASES.values() for name, _ in case.effects}
    assert hidden <= {*LISTED, *MORE_LISTED, *MEASURED_EFFECTS}
    remaining = {name for name in SIZES if name not in hidden}
    assert {name.partition(".")[0] for name in remaining} == {"random_torque", "encoder_eccentricity"}
    assert {name for case in CASES.values() for name, _ in case.unlisted} == set(DISTURBED)


@pytest.mark.medium
def test_true_numbers_stay_within_what_is_said_of_them() -> None:
    for case in CASES.values():
        rig, nominal = case.rig(), load_rig(case.rig_name)
        assert abs(rig["thrust_gain"].value / nominal["thrust_gain"].value - 1.0) <= 0.15
        for mass in ("M_f", "M_b", "M_w"):
            assert abs(rig[mass].value / nominal[mass].value - 1.0) <= 0.007
        for axis in ("elevation", "pitch", "travel"):
            assert 0.5 <= rig[f"friction_{axis}"].value / nominal[f"friction_{axis}"].value <= 2.0
        if case.rig_name == QUANSER_RIG:
            # Uncertain parameters are drawn within the tolerances of the rig file.
            for name in (
                "dead_zone",
                "L_theta",
                "L_phi",
                "torque_elevation",
                "torque_travel",
                "offset_pitch",
            ):
                assert abs(rig[name].value - nominal[name].value) <= nominal[name].tolerance
        else:
            assert abs(rig["dead_zone"].value / nominal["dead_zone"].value - 1.0) <= 0.1


@pytest.mark.medium
def test_gusts_have_their_strength_and_memory_about_each_axis_and_are_independent() -> None:
    disturbances = DisturbanceModel((0.02, 0.006, 0.012), 0.3)
    gusts_Nm = np.concatenate([torques(disturbances, seed, 120.0) for seed in range(8)])
    # 960 s of a memory of 0.3 s are 1600 draws: standard deviations to 1.8 %, correlations to 0.025.
    np.testing.assert_allclose(gusts_Nm.std(axis=0), disturbances.gusts_Nm, rtol=0.06)
    # Correlation of each axis with each axis 30 rows, 0.3 s, later.
    correlation = np.corrcoef(gusts_Nm[:-30].T, gusts_Nm[30:].T)[:3, 3:]
    of_same_axis = np.diag(correlation)
    np.testing.assert_allclose(of_same_axis, np.exp(-1.0), atol=0.07)
    np.testing.assert_allclose(correlation - np.diag(of_same_axis), 0.0, atol=0.08)


@pytest.mark.medium
def test_a_drift_is_slow() -> None:
    drift = torques(DisturbanceModel((0.0, 0.0, 0.0), 0.3, (0.01, 0.01, 0.01), 30.0), 1, 100.0)
    assert 0.003 < drift.std() < 0.02
    assert np.abs(np.diff(drift[::100], axis=0)).max() < 0.5 * np.ptp(drift)


def test_no_gust_comes_twice_and_all_else_does() -> None:
    case = CASES["w-lag+coulomb_friction.pitch"]
    (*first, air), (*second, other) = case.hidden(0), case.hidden(1)
    assert [case.truth for case in first] == [case.truth for case in second]
    at = [Moment(0.0, 1.0, np.zeros(2), np.zeros(2), np.zeros(3), np.zeros(3)) for _ in range(2)]
    air.torque(at[0])
    other.torque(at[1])
    assert not np.allclose(at[0].torque_Nm, at[1].torque_Nm)


@pytest.mark.medium
@pytest.mark.parametrize("name", ["w-nothing-0", "w-rotor_speed_lag"])
def test_a_log_holds_whole_counts_and_the_voltages_that_acted(name: str) -> None:
    case = CASES[name]
    log, trajectory = disturbances_flown(name)
    assert len(log) == round(3.0 * case.rate_Hz)
    counts = log.angles_rad / count_rad(load_rig(case.rig_name))
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)
    halves = round(1.0 / case.rate_Hz / STEP_S)
    np.testing.assert_array_equal(trajectory.volts_V, np.repeat(log.voltages_V, halves, axis=0))


@pytest.mark.medium
def test_a_seed_gives_the_whole_flight_and_another_case_another() -> None:
    case = CASES["w-nothing-0"]
    # Another flight in between: what is disturbances_flown last is remembered.
    first, other = case.fly(0, 1.0)[0], case.fly(1, 1.0)[0]
    np.testing.assert_array_equal(case.fly(0, 1.0)[0].angles_rad, first.angles_rad)
    assert not np.array_equal(other.angles_rad, first.angles_rad)
