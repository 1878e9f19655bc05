"""Whatever ends a program while the arm is in the air: it lands, and the motors are not cut."""

from __future__ import annotations

import signal
from collections.abc import Callable

import heli_host
import pytest
from heli_host.board.heli import Heli
from heli_host.board.samples import Samples
from heli_host.declaration import State, Trigger
from heli_host.errors import HeliError, WaitTimeout
from heli_sim.sil.inprocess import InProcessTransport

pytestmark = pytest.mark.medium


class Witness:
    """The states of the board in a flight, and its height when the motors went off."""

    def __init__(self, heli: Heli) -> None:
        transport = heli.session.transport
        assert isinstance(transport, InProcessTransport)
        self.world = transport.world
        self.states: list[State] = []
        self.last_trigger = Trigger.START
        heli.on_ticks(self._take)

    def _take(self, samples: Samples) -> None:
        for state, trigger in zip(samples.state.tolist(), samples.trigger.tolist(), strict=True):
            if not self.states or self.states[-1] != state:
                self.states.append(State(state))
            self.last_trigger = Trigger(trigger)

    def assert_landed(self) -> None:
        assert self.states[-2:] == [State.LANDING, State.IDLE]
        assert self.last_trigger is Trigger.LAND
        assert not any(self.world.native.volts_V)


def time_out(heli: Heli) -> None:
    heli.wait_until(lambda _: False, 0.5)


def fail_in_a_callback(heli: Heli) -> None:
    def fail(_: Samples) -> None:
        raise ValueError("full")

    heli.on_ticks(fail)
    heli.wait(1.0)


def raising(error: BaseException) -> Callable[[Heli], None]:
    def raise_it(_: Heli) -> None:
        raise error

    return raise_it


@pytest.mark.parametrize(
    ("end", "error"),
    [
        (time_out, WaitTimeout),
        (fail_in_a_callback, HeliError),
        (raising(ValueError("bug")), ValueError),
        (raising(KeyboardInterrupt()), KeyboardInterrupt),
        (raising(SystemExit(1)), SystemExit),
    ],
)
def test_an_error_in_the_block_lands_the_arm(
    end: Callable[[Heli], None], error: type[BaseException], capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(error), heli_host.connect("sil://?seed=2") as heli:
        witness = Witness(heli)
        heli.take_off()
        end(heli)
    witness.assert_landed()
    assert capsys.readouterr().err.endswith(": the board lands; Ctrl-C now switches the motors off\nlanded\n")


@pytest.mark.parametrize("after", ["stream", "hold", "open_loop"])
def test_the_arm_lands_from_every_state_in_the_air(after: str) -> None:
    with heli_host.connect("sil://?seed=2") as heli:
        witness = Witness(heli)
        heli.take_off()
        if after == "stream":
            heli.stream()
        elif after == "hold":
            heli.keep_alive = False
            heli.wait(1.0)
            assert heli.state is State.HOLD
        else:
            sample = heli.latest
            heli.control(heli_host.Axes(0), sample.front_V, sample.back_V)
    witness.assert_landed()


def test_a_closed_vehicle_has_landed() -> None:
    heli = heli_host.connect("sil://?seed=2")
    witness = Witness(heli)
    heli.take_off()
    heli.close()
    witness.assert_landed()


def test_an_interrupt_during_the_landing_stops_the_motors_and_says_so(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(ValueError), heli_host.connect("sil://?seed=2") as heli:
        heli.take_off()
        heli.on_ticks(
            lambda samples: (
                signal.raise_signal(signal.SIGINT) if State.LANDING in samples.state.tolist() else None
            )
        )
        raise ValueError("bug")
    assert "Ctrl-C while landing, motors stopped in the air" in capsys.readouterr().err


def test_a_motor_on_the_bench_is_switched_off_and_not_landed() -> None:
    with heli_host.connect("sil://?seed=2") as heli:
        witness = Witness(heli)
        heli.arm()
        heli.control(heli_host.Axes(0), 0.5, 0.5)
        heli.wait(0.2)
    assert State.LANDING not in witness.states


def test_the_climb_of_a_slow_setpoint_is_waited_for() -> None:
    with heli_host.connect("sil://?seed=2") as heli:
        heli.params["elevation_slew_deg_s"] = 1.0
        sample = heli.take_off()
        assert abs(sample.elevation_deg) < 2.0


def test_no_wait_is_of_zero_ticks() -> None:
    with heli_host.connect("sil://?seed=2") as heli:
        for duration_s in (0.0, 1e-9, 4e-4, 0.3, 0.0125):
            tick = heli.latest.tick
            heli.wait(duration_s)
            assert heli.latest.tick > tick
        for duration_s in (-1.0, float("nan"), float("inf")):
            with pytest.raises(HeliError, match="give a number of seconds"):
                heli.wait(duration_s)


@pytest.mark.parametrize("duration_s", [0.1, 0.3, 0.6, 0.7, 0.9, 1.1, 1.3, 0.0301])
def test_a_paced_loop_ends_in_time(duration_s: float) -> None:
    with heli_host.connect("sil://?seed=2") as heli:
        start_s = heli.latest.t_s
        looks = list(heli.pace(0.1, duration_s))
        assert 0.0 <= heli.latest.t_s - start_s - duration_s < 0.1
        assert len(looks) <= duration_s / 0.1 + 2
