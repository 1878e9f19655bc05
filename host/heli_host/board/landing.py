"""The end of every flight: the arm comes down from any state, and rests at the angles it had before."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from functools import partial
from typing import Final

import numpy as np

from heli_host.board.flying import MOTORS_OFF, Flying
from heli_host.board.interrupts import Interrupts, name_of
from heli_host.board.samples import Sample, Samples
from heli_host.declaration import Axes, Fault, LandMessage, State, StopMessage, Trigger
from heli_host.errors import CommandRefused, FlightAborted, HeliError, LinkLost, announce, fault_text
from heli_host.link.clock import TICK_S
from heli_host.link.engine import UNNUMBERED
from heli_host.link.events import BOARD_RESTARTED

STOP_TRIES: Final = 3
"""Attempts of a stop or of a landing: a failed callback raises its error in the next command, once."""
_LOOK_S = 0.05
_DESCENDING = (State.LANDING, State.EMERGENCY_LANDING)
_LANDED_BY = (Trigger.LAND, Trigger.STALE_LAND)
"""Triggers in the samples of an idle board whose arm has touched down."""
_TABLE_DEG = 3.0
"""Distance of elevation from its rest angle up to which an arm in open loop is on the table [deg]: twice the
distance at which the board takes a landing for finished."""
_LANDING_TIMES = 3.0
"""Longest wait for a landing, as a multiple of ``landing_timeout_s``. The board ends each of at most two
landings, an ordinary one and an emergency landing that follows it, within one."""
_FLOAT_LOOK_S = 1.0
_TURNING_DEG_S = 5.0
"""Rate of travel above which an arm is stopped before its landing [deg/s]. Below it the tilt of the landing
stays so small that the arm comes down."""
_STOPPED_DEG_S = 2.0
_LEVEL_DEG = 5.0
_BRAKING_S = 1.5
_BRAKING_TIMEOUT_S = 8.0
_RATE_S = 0.2
_REST_LOOK_S = 0.2


class Landing:
    """The landing part of a helicopter; whatever ends a flight in the air ends here."""

    def __init__(self, flying: Flying) -> None:
        self._flying = flying
        self._telemetry = flying.telemetry
        self._session = flying.session
        self._params = flying.params

    @property
    def is_in_the_air(self) -> bool:
        """Whether the motors run, and the arm would fall without them."""
        state = self._session.state
        if state is None or state in MOTORS_OFF or state is State.ARMED:
            return False
        if state is not State.OPEN_LOOP:
            return True
        # On a bench, open-loop voltages drive a motor while the arm rests on the table.
        return self._telemetry.latest.elevation_deg > self._params["elevation_rest_deg"] + _TABLE_DEG

    def land(self, *, wait: bool) -> None:
        """Let the board descend and switch the motors off on the table; on an idle board, do nothing."""
        if self._telemetry.latest.state is State.IDLE:
            return
        if not wait:
            self._flying.forget_target()
            self._session.command(LandMessage(UNNUMBERED))
        elif trouble := self.bring_down():
            raise FlightAborted(trouble)

    def bring_down(
        self, on_landing: Callable[[], object] | None = None, on_wait: Callable[[], object] | None = None
    ) -> str:
        """Bring the arm onto the table from any state, and return what went wrong; empty for nothing."""
        restarts_before = self._session.counters.restarts
        for remaining_tries in reversed(range(STOP_TRIES)):
            try:
                self._descend(restarts_before, on_landing, on_wait)
                break
            except LinkLost:
                raise  # no command reaches the board, which lands by itself
            except HeliError:
                if not remaining_tries:
                    raise
        if self._session.counters.restarts != restarts_before:
            return self.restart_text()
        sample = self._telemetry.latest
        # A log ends with the arm at rest.
        self._session.wait(_REST_LOOK_S)
        if sample.state is State.FAULT:
            return self._text_of_fault(sample.fault)
        if sample.state is not State.IDLE:
            limit_s = _LANDING_TIMES * self._params["landing_timeout_s"]
            return f"the board did not land within {limit_s:g} s, and still tries; switch its supply off"
        return self._shift_at_rest(sample)

    def land_after(self, error: BaseException | None) -> str:
        """Land after an error, or at the end of a program, and return what went wrong meanwhile."""
        if error is not None:
            cause = name_of(error) if isinstance(error, KeyboardInterrupt) else type(error).__name__
            announce(f"{cause}: the board lands; Ctrl-C now switches the motors off")
        with Interrupts() as interrupts:
            try:
                trouble = self.bring_down()
            except KeyboardInterrupt as interrupt:
                interrupts.allow_no_more()
                trouble = self.cut_motors(f"{name_of(interrupt)} while landing")
            except HeliError as failure:
                announce(f"{failure.cause}; without a host the board lands by itself")
                trouble = ""
            else:
                # Further interrupts are only recorded: the arm is down.
                interrupts.allow_no_more()
                if error is not None:
                    announce(trouble or "landed")
        if error is not None and trouble:
            error.add_note(trouble)
        return trouble

    def restart_text(self) -> str:
        """Return the newest restart of the board with its reason, and what to do."""
        texts = (event.text for event in reversed(self._session.events) if event.kind == BOARD_RESTARTED)
        text = next(texts, "the board restarted")
        return f"{text} in flight, motors off; check its supply and the log's last events"

    def cut_motors(self, cause: str) -> str:
        """Switch the motors off in the air, say so on standard error, and return one line for the outcome."""
        # A pending error of a callback must not delay the stop.
        for _ in range(STOP_TRIES):
            with contextlib.suppress(HeliError):
                self._flying.stop()
                text = f"{cause}, motors stopped in the air"
                break
        else:
            text = f"{cause}, and the board did not confirm the stop: use the rig's own stop switch"
        announce(text)
        return text

    def _descend(
        self,
        restarts_before: int,
        on_landing: Callable[[], object] | None,
        on_wait: Callable[[], object] | None,
    ) -> None:
        """Land, and return when the motors are off, the board has restarted, or the time is over."""
        session = self._session
        self._flying.forget_target()
        limit_ticks = round(_LANDING_TIMES * self._params["landing_timeout_s"] / TICK_S)
        begin_tick = None

        def state_if_running() -> State | None:
            """Return the state of a board whose motors run; None if they are off, as after a restart."""
            state = session.state
            is_over = session.counters.restarts != restarts_before or state in MOTORS_OFF
            return None if is_over else state

        def has_left(earlier: State) -> bool:
            return state_if_running() is not earlier

        while (state := state_if_running()) is not None:
            if begin_tick is None:
                begin_tick = self._telemetry.latest.tick
                # An armed board has not taken off yet.
                if on_landing is not None and state is not State.ARMED:
                    on_landing()
            if self._telemetry.latest.tick - begin_tick > limit_ticks:
                return
            if state not in _DESCENDING:
                self._begin_descent(state)
            if on_wait is not None:
                on_wait()
            session.wait_for(partial(has_left, state), _LOOK_S)

    def _begin_descent(self, state: State) -> None:
        """Let the board land, or stop the motors if the arm is on the table, and wait until telemetry shows
        it.
        """
        try:
            if self.is_in_the_air:
                self._stop_turning(state)
                self._session.command(LandMessage(UNNUMBERED))
            else:
                self._session.command(StopMessage(UNNUMBERED))
        except CommandRefused:
            # The board has left the state meanwhile, which the next sample shows.
            self._session.wait_for(lambda: self._session.state is not state, _LOOK_S)
            if self._session.state is state:
                raise
        else:
            self._session.wait_for(lambda: self._session.state is not state, 1.0)

    def _text_of_fault(self, fault: Fault) -> str:
        """Return the fault of a landing, with its reason if the host knows it better."""
        floating = ""
        if fault is Fault.LANDING_TIMEOUT:
            floating = _float_text(self._telemetry.samples(2.0 * _FLOAT_LOOK_S), self._params)
        return floating or f"fault {fault_text(fault)}"

    def _stop_turning(self, state: State) -> None:
        """Let the board brake an arm that turns, at the height of the flight."""
        # A landing closes the loop of travel. If that loop was open, the board then brakes with a large tilt,
        # in which the rotors carry the arm badly, and it may lose the fall that brings it onto the table.
        is_open = not self._flying.axes & Axes.TRAVEL
        is_free = state is State.STREAMED or (state is State.CLOSED_LOOP and is_open)
        if not is_free or abs(self._turning_deg_s()) < _TURNING_DEG_S:
            return
        self._flying.control()
        # The arm needs this way to stop; a setpoint behind it would look like a following error.
        ahead_deg = self._telemetry.latest.travel_deg + _BRAKING_S * self._turning_deg_s()
        limits_deg = self._flying.setpoint_limits_deg()["travel"]
        self._flying.setpoint({"travel": float(np.clip(ahead_deg, *limits_deg))})
        end_tick = self._telemetry.latest.tick + round(_BRAKING_TIMEOUT_S / TICK_S)
        while self._telemetry.latest.state is State.CLOSED_LOOP and self._telemetry.latest.tick < end_tick:
            if (
                abs(self._turning_deg_s()) < _STOPPED_DEG_S
                and abs(self._telemetry.latest.pitch_deg) < _LEVEL_DEG
            ):
                break
            self._session.wait(_LOOK_S)
        self._flying.forget_target()

    def _turning_deg_s(self) -> float:
        """Return the mean rate of travel of the newest samples [deg/s]; 0 of fewer than two."""
        recent = self._telemetry.samples(_RATE_S)
        if len(recent) < 2:
            return 0.0
        turned_deg = float(np.degrees(recent.travel_rad[-1] - recent.travel_rad[0]))
        return turned_deg / (float(recent.tick[-1] - recent.tick[0]) * TICK_S)

    def _shift_at_rest(self, sample: Sample) -> str:
        """Return the axes whose angles at rest differ from those before the take-off; empty if none does, or
        if this program saw no take-off or no landing.
        """
        before, self._flying.at_rest = self._flying.at_rest, None
        if before is None or sample.trigger not in _LANDED_BY:
            return ""
        while self._telemetry.latest.state is State.IDLE:
            since_landing = self._telemetry.samples((self._telemetry.latest.tick - sample.tick) * TICK_S)
            shift = before.shift_after(since_landing)
            if shift is not None:
                return shift
            self._session.wait(_REST_LOOK_S)
        return ""


def _float_text(descent: Samples, parameters: Mapping[str, float]) -> str:
    """Explain a landing that took too long although the motors gave no thrust; empty if they gave some."""
    rows = np.flatnonzero(np.isin(descent.state, _DESCENDING))[-round(_FLOAT_LOOK_S / TICK_S) :]
    if not len(rows):
        return ""
    volts_V = max(float(descent.front_V[rows].mean()), float(descent.back_V[rows].mean()))
    if volts_V > parameters["dead_zone_V"]:
        return ""
    elevation_deg = float(np.degrees(descent.elevation_rad[rows]).mean())
    return (
        f"fault {Fault.LANDING_TIMEOUT}: the arm stayed at {elevation_deg:.1f} degrees, above the table at "
        f"{parameters['elevation_rest_deg']:g}, although the motors gave no thrust: it floats; make the "
        "counterweight lighter, or check what holds the arm"
    )
