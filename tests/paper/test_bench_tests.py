"""The paper's bench tests find what the rig is made of, and say of the rest that they cannot.

An arm whose masses balance above its table is held there while the motors are off, and no other arm is.
"""

import casadi as ca
import numpy as np
import pytest
from heli_host.board.heli import Heli
from heli_host.link.session import Session
from heli_lab.apps.paper.experiments import (
    PITCH_RELEASES,
    BenchTest,
    check_rig,
    read_thrust,
    record_of,
    run_bench_test,
)
from heli_lab.apps.paper.tables import TESTS_OF_TABLE, Table, TableRow, fit_rig, fit_table
from heli_lab.errors import IdentifyError
from heli_lab.fit.records import Record
from heli_sim.model import Model, MultibodyModel, Operands, PaperModel
from heli_sim.model.effects import RotorLag
from heli_sim.model.plant import Plant
from heli_sim.rig import load_rig
from heli_sim.sil.inprocess import InProcessTransport
from heli_sim.sil.options import SilOptions
from heli_sim.sil.world import SilWorld

pytestmark = pytest.mark.slow

RIG = load_rig("makki2024")


def records(plant: Plant, number: int) -> list[Record]:
    return [record_of(test, run_bench_test(test, plant), plant.rig) for test in TESTS_OF_TABLE[number]]


def tables(model: Model) -> dict[int, Table]:
    plant = Plant(model, RIG)
    return {number: fit_table(number, RIG, records(plant, number)) for number in TESTS_OF_TABLE}


@pytest.fixture(scope="module")
def by_paper() -> dict[int, Table]:
    return tables(PaperModel())


@pytest.fixture(scope="module")
def by_multibody() -> dict[int, Table]:
    return tables(MultibodyModel())


def rows(table: Table) -> dict[str, TableRow]:
    return {row.name: row for row in table.rows}


def test_on_a_rig_that_obeys_30_its_coefficients_are_found_within_three_standard_errors(
    by_paper: dict[int, Table],
) -> None:
    estimated = [row for table in by_paper.values() for row in table.rows if row.estimate is not None]
    assert len(estimated) == 16
    for row in estimated:
        assert row.estimate == pytest.approx(row.analytic, abs=1.5 * (row.half or 0.0)), row.name
    assert all(table.normalised <= 1.05 for table in by_paper.values())


def test_a_parameter_that_the_papers_tests_cannot_show_gets_no_value(by_paper: dict[int, Table]) -> None:
    without_estimate = {row.name for table in by_paper.values() for row in table.rows if row.estimate is None}
    assert without_estimate == {"P_11", "P_1", "P_5", "P_15", "P_17", "P_18"}


def test_the_short_arm_below_the_pitch_axis_makes_P_3_a_third_larger_than_16_has_it(
    by_multibody: dict[int, Table],
) -> None:
    row = rows(by_multibody[4])["P_3"]
    assert row.analytic == pytest.approx(-73.0, abs=0.05)
    assert row.estimate == pytest.approx(-96.3, abs=0.3)


def test_30_cannot_predict_a_multibody_rig_whose_pitch_and_travel_move_together(
    by_multibody: dict[int, Table],
) -> None:
    assert by_multibody[3].normalised <= 1.05
    assert by_multibody[4].normalised <= 1.05
    assert by_multibody[5].normalised > 5.0


def test_the_multibody_model_explains_every_bench_test_down_to_the_encoder() -> None:
    plant = Plant(MultibodyModel(), RIG)
    rig_table = fit_rig(
        RIG, {number: records(plant, number) for number in TESTS_OF_TABLE}, read_thrust(plant).line()
    )
    assert all(value <= 1.05 for value in rig_table.normalised.values())
    estimated = {row.name: row for row in rig_table.rows if row.estimate is not None}
    assert set(estimated) >= {
        "thrust_gain",
        "dead_zone",
        "L_theta",
        "L_phi",
        "friction_elevation",
        "friction_pitch",
    }
    for name, row in estimated.items():
        assert row.estimate == pytest.approx(RIG[name].value, abs=1.5 * (row.half or 0.0)), name


def test_the_thrust_stand_finds_the_line_through_the_drivers_dead_band_and_a_lag() -> None:
    curve = read_thrust(Plant(MultibodyModel((RotorLag(0.1),)), RIG.replace(thrust_gain=0.5, dead_zone=1.2)))
    line = curve.line()
    assert line.gain_N_per_V == pytest.approx(0.5, abs=line.gain_half)
    assert line.dead_zone_V == pytest.approx(1.2, abs=line.dead_zone_half)
    assert np.all(curve.thrust_N[curve.volts_V < 1.2] == 0.0)


def test_pinned_axes_stay_where_they_are_and_the_free_one_is_released_from_its_angle() -> None:
    test = PITCH_RELEASES[0]
    flight = run_bench_test(test, Plant(MultibodyModel(), RIG))
    angles_deg = np.rad2deg(flight.angles_rad)
    assert angles_deg[0, 1] == pytest.approx(13.0, abs=0.1)
    assert np.all(angles_deg[:, [0, 2]] == angles_deg[0, [0, 2]])
    assert angles_deg[:, 1].min() < -5.0
    assert np.all(flight.voltages_V == 0.0)


def test_a_test_that_runs_into_a_stop_is_refused_by_name() -> None:
    hard = BenchTest(
        "much too hard",
        17,
        "(a)",
        (False, True, True),
        elevation_deg=-25.0,
        front_V=4.0,
        back_V=4.0,
        duration_s=5.0,
    )
    plant = Plant(MultibodyModel(), RIG)
    with pytest.raises(IdentifyError, match=r"much too hard.*stop"):
        record_of(hard, run_bench_test(hard, plant), RIG)


@pytest.mark.parametrize("name", ["makki2024-identified", "quanser-course"])
def test_a_rig_that_hovers_at_other_voltages_is_refused_with_its_own(name: str) -> None:
    with pytest.raises(IdentifyError, match=rf"'{name}' hovers at \d\.\d\d"):
        check_rig(load_rig(name))
    check_rig(RIG)


class WithoutCentrifugalForce(MultibodyModel):
    """Travel's inertia as at 7.5 degrees of pitch, whatever the pitch: nothing drives pitch back to level."""

    def _inertia_kg_m2(self, at: Operands, q: ca.SX) -> ca.SX:
        inertia = super()._inertia_kg_m2(at, q)
        inertia[2, 2] = super()._inertia_kg_m2(at, ca.vertcat(q[0], 0.13, q[2]))[2, 2]
        return inertia


class WithoutCouplingEither(WithoutCentrifugalForce):
    """Nor do pitch and travel accelerate each other."""

    def _inertia_kg_m2(self, at: Operands, q: ca.SX) -> ca.SX:
        inertia = super()._inertia_kg_m2(at, q)
        inertia[1, 2] = inertia[2, 1] = 0.0
        return inertia


def test_what_30_lacks_in_the_travel_test_is_centrifugal_force_then_the_coupling_of_pitch_and_travel(
    by_multibody: dict[int, Table],
) -> None:
    less, none = (
        fit_table(5, RIG, records(Plant(model, RIG), 5)).normalised
        for model in (WithoutCentrifugalForce(), WithoutCouplingEither())
    )
    assert by_multibody[5].normalised == pytest.approx(15.9, abs=0.5)
    assert less == pytest.approx(1.8, abs=0.1)
    assert none == pytest.approx(1.0, abs=0.05)


TABLE_RAD = np.deg2rad(-25.0)


def world_of(model: Model) -> SilWorld:
    return SilWorld(SilOptions(), Plant(model, RIG))


def test_table_2_as_point_masses_balances_at_minus_22_degrees() -> None:
    plant = Plant(MultibodyModel(), RIG.replace(friction_elevation=2.0))
    ticks, still = 10_000, np.zeros(3)
    seconds = plant.function.mapaccum(ticks)
    state = plant.rest_state()
    for _ in range(4):
        after, _ = seconds(state, np.zeros((2, ticks)), still, plant.parameters)
        state = np.asarray(after)[:, -1]
    assert np.rad2deg(state[0]) == pytest.approx(-22.08, abs=0.01)


def test_the_arm_of_the_multibody_rig_stays_on_its_table_until_somebody_flies_it() -> None:
    world = world_of(MultibodyModel())
    session = Session(InProcessTransport(world))
    session.connect()
    with Heli(session) as heli:
        heli.wait(8.0)
        assert world.state[0] == TABLE_RAD
        heli.take_off()
        assert heli.latest.elevation_deg == pytest.approx(0.0, abs=2.5)
        heli.land()
        heli.wait(8.0)
        assert world.state[0] == pytest.approx(TABLE_RAD, abs=np.deg2rad(0.3))
        heli.take_off()


def test_the_hand_lets_go_within_milliseconds_of_the_first_voltage() -> None:
    world = world_of(MultibodyModel())
    session = Session(InProcessTransport(world))
    session.connect()
    with Heli(session) as heli:
        heli.arm()
        assert world.native.locked == [True, False, False]
        heli.control()
        heli.setpoint(elevation_deg=0.0)
        heli.wait(0.2)
        assert world.native.locked == [False, False, False]


def test_an_arm_that_rests_by_itself_and_pins_of_others_are_left_alone() -> None:
    heavy = world_of(PaperModel())
    heavy.advance(100)
    assert heavy.native.locked == [False, False, False]
    locked = world_of(MultibodyModel())
    locked.native.locked = [False, True, True]
    locked.advance(2000)
    assert locked.native.locked == [False, True, True]
    assert locked.state[0] > TABLE_RAD + np.deg2rad(1.0)
