"""The core flies the controller that is selected, through the interface alone, and trusts none."""

import math
from collections.abc import Callable

import pytest
from heli_host import declaration as d
from heli_host.declaration import Result, State
from heli_test_native.flight import ToldLaw

from tests.flight.harness import REST_DEG, Harness

STEPS_PER_V = 2100 / 12
MOTOR_MAX_V = 10.0


def flown(front_V: float = 0.0, back_V: float = 0.0, **parameters: float) -> tuple[Harness, ToldLaw]:
    """A core in closed loop under a law that asks for these voltages."""
    law = ToldLaw()
    law.front_V, law.back_V = front_V, back_V
    harness = Harness(law=law)
    for name, value in parameters.items():
        assert harness.set(name, value).result == Result.OK
    harness.fly()
    harness.keep_flying(5, elevation_deg=REST_DEG)
    return harness, law


def test_the_voltages_of_any_law_reach_the_motors() -> None:
    harness, law = flown(2.0, 3.0)
    assert harness.motors == (2.0 * STEPS_PER_V, 3.0 * STEPS_PER_V, True)
    law.front_V = 4.0
    harness.tick()
    assert harness.motors[0] == 4.0 * STEPS_PER_V


def test_a_law_is_asked_once_a_tick() -> None:
    harness, law = flown()
    before = law.updates
    harness.tick(7)
    assert law.updates == before + 7


def test_a_law_is_given_the_measured_state_the_setpoints_and_the_axes() -> None:
    # At these rates the test may move the arm in one tick.
    rates = {
        "elevation_rate_max_deg_s": 1000.0,
        "pitch_rate_max_deg_s": 2000.0,
        "travel_rate_max_deg_s": 1000.0,
    }
    harness, law = flown(elevation_slew_deg_s=45.0, elevation_acceleration_deg_s2=200.0, **rates)
    harness.keep_flying(3000, elevation_deg=-20.0, travel_deg=3.0)
    assert law.setpoint_rad == pytest.approx([math.radians(-20.0), 0.0, math.radians(3.0)], abs=1e-5)
    harness.glide(0, -20.0, 60.0)
    harness.move(elevation_deg=-21.0, pitch_deg=4.0, travel_deg=-2.0)
    harness.tick()
    # A count is 1.5e-3 rad, and the rest is a whole number of them too.
    assert law.angle_rad == pytest.approx([math.radians(x) for x in (-21.0, 4.0, -2.0)], abs=1.6e-3)
    assert [rate > 0.0 for rate in law.rate_rad_s] == [True, True, False]
    assert law.axes == 7
    assert harness.close_loops(3).result == Result.OK
    assert law.axes == 3


def test_a_law_starts_again_whenever_the_motors_were_off() -> None:
    law = ToldLaw()
    harness = Harness(law=law)
    harness.tick(10)
    assert law.inits > 10
    assert law.updates == 0
    assert harness.arm().result == Result.OK
    armed = law.inits
    harness.tick(10)
    assert law.inits == armed + 10
    assert harness.close_loops().result == Result.OK
    closed = law.inits
    harness.tick(10)
    assert law.inits == closed
    assert law.updates > 10
    assert harness.ask(d.StopMessage(0)).result == Result.OK
    harness.tick(10)
    assert law.inits > closed + 9


@pytest.mark.parametrize(
    ("told_V", "sign", "acted_V"),
    [(50.0, 1.0, MOTOR_MAX_V), (-50.0, 1.0, -6.0), (50.0, -1.0, -MOTOR_MAX_V), (-50.0, -1.0, 6.0)],
)
def test_no_law_gets_beyond_the_limits_of_the_motors(told_V: float, sign: float, acted_V: float) -> None:
    signs = {"motor_front_sign": sign, "motor_back_sign": sign}
    harness, _ = flown(told_V, told_V, motor_min_V=-6.0, motor_max_V=MOTOR_MAX_V, **signs)
    assert harness.motors[:2] == (acted_V * STEPS_PER_V, acted_V * STEPS_PER_V)


def stop_by_command(harness: Harness) -> None:
    harness.ask(d.StopMessage(0))


def stop_by_input(harness: Harness) -> None:
    harness.core.stop_input(True)
    harness.tick()


def stop_by_limit(harness: Harness) -> None:
    harness.move(pitch_deg=80.0)
    harness.tick()


@pytest.mark.parametrize("stop", [stop_by_command, stop_by_input, stop_by_limit])
def test_no_law_can_keep_the_motors_on(stop: Callable[[Harness], None]) -> None:
    harness, law = flown(5.0, 5.0)
    stop(harness)
    assert harness.motors_off
    updates = law.updates
    harness.tick(5)
    assert harness.motors_off
    assert law.updates == updates


def test_a_silent_host_lands_any_law() -> None:
    harness, _ = flown(2.0, 2.0)
    harness.tick(6000)
    assert harness.state in (State.LANDING, State.IDLE)


def test_a_tick_in_the_middle_of_a_change_sees_nothing_of_it() -> None:
    harness, law = flown(hover_V=2.0)
    # Both banks have held other values before.
    harness.set("hover_V", 3.0)
    harness.set("hover_V", 4.0)
    harness.tick()
    assert law.hover_V_of_update == 4.0
    observed = []

    def interrupt() -> None:
        harness.core.interrupt()
        observed.append(law.hover_V_of_update)

    law.while_deriving = interrupt
    harness.set("hover_V", 5.0)
    law.while_deriving = None
    assert observed == [4.0]
    harness.tick()
    assert law.hover_V_of_update == 5.0


def two_controllers() -> tuple[Harness, ToldLaw, ToldLaw]:
    """A board whose first controller asks for 2 V and whose second asks for 3 V."""
    first, second = ToldLaw(), ToldLaw()
    first.front_V, second.front_V = 2.0, 3.0
    return Harness(law=first, other=second), first, second


def test_the_selected_controller_flies_and_no_other() -> None:
    harness, first, second = two_controllers()
    assert harness.set("controller", 1.0).result == Result.OK
    harness.fly()
    harness.keep_flying(5, elevation_deg=REST_DEG)
    assert harness.motors[0] == 3.0 * STEPS_PER_V
    assert (first.updates, second.updates > 0) == (0, True)
    harness.ask(d.StopMessage(0))
    assert harness.set("controller", 0.0).result == Result.OK
    harness.fly()
    harness.keep_flying(5, elevation_deg=REST_DEG)
    assert harness.motors[0] == 2.0 * STEPS_PER_V


def test_a_controller_that_is_selected_begins_without_a_past() -> None:
    harness, _, second = two_controllers()
    harness.set("controller", 1.0)
    before = second.inits
    harness.tick(10)
    assert second.inits == before + 10


@pytest.mark.parametrize("state", [State.ARMED, State.CLOSED_LOOP, State.HOLD, State.LANDING])
def test_no_controller_is_replaced_while_the_motors_may_run(state: State) -> None:
    harness, first, second = two_controllers()
    assert harness.arm().result == Result.OK
    if state is not State.ARMED:
        assert harness.close_loops().result == Result.OK
        harness.tick(10)
    if state is State.HOLD:
        harness.tick(700)
    if state is State.LANDING:
        harness.ask(d.LandMessage(0))
    assert harness.state == state
    assert harness.set("controller", 1.0).result == Result.UNSAFE_NOW
    updates = first.updates
    harness.tick(5)
    assert first.updates == updates + (0 if state is State.ARMED else 5)
    assert (second.updates, second.inits) == (0, 0)


def test_a_row_that_the_board_does_not_have_is_refused() -> None:
    harness, first, second = two_controllers()
    assert harness.set("controller", 2.0).result == Result.OUT_OF_RANGE
    harness.fly()
    harness.keep_flying(5, elevation_deg=REST_DEG)
    assert (first.updates > 0, second.updates) == (True, 0)
