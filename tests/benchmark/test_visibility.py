"""Visibility is in standard deviations of the disturbances, and proportional to the size of the cause."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from heli_benchmark.cases.disturbed import disturbed_cases
from heli_benchmark.cases.disturbed_case import QUANSER_RIG, DisturbedCase
from heli_benchmark.engine.true_trajectory import TrueTrajectory
from heli_benchmark.reference.replay import FINE, Forces, ReplayedRig, acts_by_itself, inertia_kg_m2, steps
from heli_benchmark.reference.visibility import (
    CauseContribution,
    LinearisedRig,
    imitators,
    residual_norm,
    visibility,
)
from heli_host.data.arrays import Floats
from heli_sim.rig.encoders import count_rad

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
