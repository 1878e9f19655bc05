"""The helicopter as users program it."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Protocol, Self

from heli_host.board.bench import Bench
from heli_host.board.flying import ALL_AXES, LEAD_S, MOTORS_OFF, Flying
from heli_host.board.landing import STOP_TRIES, Landing
from heli_host.board.law_flight import (
    AfterLaw,
    ControlLaw,
    ControllerReport,
    LawReport,
    fly_law,
    run_controller,
    set_parameter,
    upload,
)
from heli_host.board.law_program import LawLike, LawProgram, program_of
from heli_host.board.rig_check import check_rig
from heli_host.board.samples import Sample, Samples
from heli_host.board.telemetry import BoardInfo, Telemetry
from heli_host.declaration import Axes, Excitation, Fault, State
from heli_host.errors import FlightAborted, HeliError, PlanError
from heli_host.link.clock import ClockEstimate
from heli_host.link.events import LinkEvent
from heli_host.link.session import EventCallback, Session, Unsubscribe
from heli_host.link.telemetry import LinkCounters
from heli_host.link.transport import transport_label, transport_rig, transport_rig_parameters

if TYPE_CHECKING:
    from heli_host.data.log.summary import FlightSummary

HISTORY_S = 120.0


class FlightPlan(Protocol):
    """A flight plan, as `heli_host.fly.Plan` is one."""

    @property
    def name(self) -> str:
        """Name of the plan."""
        ...

    @property
    def text(self) -> str:
        """The plan as TOML."""
        ...


AnyPlan = FlightPlan | str | Path


class Heli:
    """A connected helicopter; `connect` makes one.

    Leaving its ``with`` block, or `close`, lands an arm that is in the air, whatever ended the block. A
    Ctrl-C during this landing switches the motors off. A line on standard error reports both.

    A method that changes the board's state returns when telemetry shows the new state. Methods may be called
    from any thread; `stop` waits for a command of another thread, `Session.stop_now` does not. Callbacks run
    in the session's reading thread: they may read samples and send setpoints, but must not wait.

    Parameters
    ----------
    session : Session
        Connected session; `close` ends it.
    keep_alive : bool
        True repeats the last setpoint ten times per second, so that the board keeps flying while the program
        pauses, such as between two cells of a notebook. False: without a new setpoint the board holds level
        after ``setpoint_hold_s`` and lands after ``setpoint_land_s``.
    land_on_exit : bool
        False switches the motors off at an end without an error, instead of landing: an arm in the air falls.
        After an error the arm lands in any case.
    history_s : float
        Length of the history that `samples` can return [s].
    fly_plans : callable, optional
        Function that `fly` calls, `heli_host.fly.runner.fly`; `connect` gives it.

    Attributes
    ----------
    session : Session
        The session, for functions that this class does not offer.
    params : Parameters
        The board's parameters.
    land_on_exit : bool
        As above; may be changed at any time.
    telemetry, flying, landing, bench
        The parts that the methods below call.

    Raises
    ------
    WaitTimeout
        The board sends no samples.
    """

    def __init__(
        self,
        session: Session,
        *,
        keep_alive: bool = True,
        land_on_exit: bool = True,
        history_s: float = HISTORY_S,
        fly_plans: Callable[..., FlightSummary] | None = None,
    ) -> None:
        self.session = session
        self.land_on_exit = land_on_exit
        self.telemetry = Telemetry(session, history_s)
        self.params = self.telemetry.params
        self.flying = Flying(self.telemetry, keep_alive=keep_alive)
        self.landing = Landing(self.flying)
        self.bench = Bench(session, self.params)
        self._fly_plans = fly_plans
        self._program: LawProgram | None = None
        self._program_restarts = 0
        self._closed = False

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end(error)

    def __repr__(self) -> str:
        transport = self.session.transport
        board_text = transport_label(transport) or self.info.board
        rig = transport_rig(transport)
        newest = repr(self.latest).strip("<>") if self.session.latest is not None else "no sample yet"
        return f"<Heli on {transport.url} ({board_text}{', rig ' + rig if rig else ''}): {newest}>"

    def close(self) -> None:
        """Land if the arm is in the air, switch the motors off, and end the session; a second call does
        nothing.

        Raises
        ------
        FlightAborted
            The landing failed, or the arm rests at other angles than before the take-off.
        """
        self._end(None)

    def leave_flying(self) -> None:
        """End the session, but not the flight: the board holds level, and lands unless another program takes
        over.
        """
        self._closed = True
        self.session.close()

    @property
    def info(self) -> BoardInfo:
        """Description that the board sent when it welcomed this session."""
        return self.telemetry.info

    @property
    def latest(self) -> Sample:
        """Newest sample.

        Raises
        ------
        LinkError
            No sample has come since the board started.
        """
        return self.telemetry.latest

    @property
    def state(self) -> State:
        """Supervisor state in the newest sample."""
        return self.latest.state

    @property
    def fault(self) -> Fault:
        """Fault in the newest sample, ``Fault.NONE`` for none."""
        return self.latest.fault

    @property
    def motors_may_run(self) -> bool:
        """False only if the newest sample shows a state with the motors off; True also without a sample."""
        return self.session.state not in MOTORS_OFF

    @property
    def counters(self) -> LinkCounters:
        """Counters of frames, ticks, retries and reconnects."""
        return self.session.counters

    @property
    def clock(self) -> ClockEstimate | None:
        """Estimated relation of device time to host time; None before the first sample."""
        return self.session.clock

    @property
    def events(self) -> tuple[LinkEvent, ...]:
        """The last thousand events of board and link, oldest first."""
        return self.session.events

    def samples(self, last_s: float | None = None) -> Samples:
        """Return copies of the newest samples as arrays, oldest first.

        Parameters
        ----------
        last_s : float or None
            Length of the history in device time [s]; None for all.
        """
        return self.telemetry.samples(last_s)

    def on_ticks(self, callback: Callable[[Samples], None]) -> Unsubscribe:
        """Register a callback for new samples, and return a function that cancels the subscription.

        Parameters
        ----------
        callback : callable taking Samples
            Called in the session's reading thread with the samples of some milliseconds. It must not block.
            If it raises, its subscription ends, and the next call of this object raises that error.
        """
        return self.telemetry.on_ticks(callback)

    def on_event(self, callback: EventCallback) -> Unsubscribe:
        """Register a callback for events, and return a function that cancels the subscription.

        Parameters
        ----------
        callback : callable taking LinkEvent
            Called once per event; threads and errors as in `on_ticks`.
        """
        return self.session.subscribe_events(callback)

    def wait(self, duration_s: float) -> None:
        """Wait for `duration_s` of device time, at any speed of a simulation; for at least one tick.

        Parameters
        ----------
        duration_s : float
            Device time [s].

        Raises
        ------
        ParameterError
            The time is negative, or not a finite number.
        LinkLost
            The board restarted, or could not be reached within the reconnect timeout.
        """
        self.session.wait(duration_s)

    def pace(self, step_s: float, duration_s: float | None = None) -> Iterator[float]:
        """Yield the device time that has passed [s], first 0 and then after each step, until a duration has
        passed.

        Parameters
        ----------
        step_s : float
            Device time between two yields [s]; the last step is shorter.
        duration_s : float or None
            Device time until the end [s]; None for no end.

        Raises
        ------
        LinkLost
            As `wait`.
        """
        return self.telemetry.pace(step_s, duration_s)

    def wait_until(self, predicate: Callable[[Sample], bool], timeout_s: float) -> Sample:
        """Wait until a sample meets a condition. Only the newest sample of each reading is tested.

        Parameters
        ----------
        predicate : callable taking Sample, returning bool
            The condition.
        timeout_s : float
            Longest wait in device time [s].

        Raises
        ------
        WaitTimeout
            If no sample meets the condition in time.
        LinkLost
            If the board cannot be reached any more.
        """
        return self.telemetry.wait_until(predicate, timeout_s)

    @property
    def keep_alive(self) -> bool:
        """Whether the last setpoint is repeated ten times per second; may be set."""
        return self.flying.keep_alive

    @keep_alive.setter
    def keep_alive(self, on: bool) -> None:
        self.flying.keep_alive = on

    @property
    def is_in_the_air(self) -> bool:
        """Whether the motors run, and the arm would fall without them."""
        return self.landing.is_in_the_air

    def arm(self) -> None:
        """Let the board run its pre-flight checks and enable the motor drivers, at 0 V.

        A board that was reset gets its last law again first. If pitch has changed since the connection, up to
        2 s pass before that, to distinguish a drift from a rest. If an axis seems to move, the command is
        repeated for half a second: a single count may look like a motion.

        Raises
        ------
        RigMismatch
            The board is simulated, and its encoder counts or directions contradict its rig.
        CommandRefused
            A check failed, or the board is not idle; the message names the check and the fix. The motors stay
            off.
        """
        check_rig(transport_rig_parameters(self.session.transport), self.params, simulated=True)
        if self._program is not None and self.session.counters.restarts != self._program_restarts:
            self.load_law(self._program)
        self.flying.arm()

    def take_off(
        self, elevation_deg: float = 0.0, *, axes: Axes = ALL_AXES, timeout_s: float | None = None
    ) -> Sample:
        """Arm if idle, close the loops, climb, and wait until the elevation is reached.

        Parameters
        ----------
        elevation_deg : float
            Target [deg]; 0 is level.
        axes : Axes
            Axes whose loops are closed.
        timeout_s : float or None
            Longest climb in device time [s]; None takes the time that the setpoint needs at
            ``elevation_slew_deg_s``, plus 20 s.

        Returns
        -------
        Sample
            First sample after the elevation has been within 2 degrees of the target for 0.3 s.

        Raises
        ------
        SetpointError
            The elevation is outside the limits that the board's parameters set. The motors stay off.
        CommandRefused
            A pre-flight check failed. The motors stay off.
        FlightAborted
            A fault switched the motors off.
        WaitTimeout
            The elevation was not reached in time. The motors keep running: call `land`. The end of the
            ``with`` block lands, too.
        """
        return self.flying.climb(elevation_deg, self.arm, axes, timeout_s)

    def control(self, axes: Axes = ALL_AXES, front_V: float = 0.0, back_V: float = 0.0) -> None:
        """Close the board's control loops with the arm's present position as the setpoint.

        The motors may turn from now on, but the arm stays where it is until a setpoint moves it.

        Parameters
        ----------
        axes : Axes
            Axes whose loops are closed; travel needs pitch. ``Axes(0)`` drives the motors in open loop.
        front_V, back_V : float
            Motor voltages for the axes that are not closed [V].

        Raises
        ------
        CommandRefused
            The board is not armed, or a value is out of range.
        """
        self.flying.control(axes, front_V, back_V)

    def setpoint(
        self,
        *,
        elevation_deg: float | None = None,
        travel_deg: float | None = None,
        pitch_deg: float | None = None,
        lead_s: float = LEAD_S,
    ) -> None:
        """Send a setpoint, without waiting for an answer or for the motion.

        Parameters
        ----------
        elevation_deg, travel_deg : float or None
            Targets [deg]; None leaves a target unchanged.
        pitch_deg : float or None
            Target [deg]; it has an effect only if the loop of travel is open.
        lead_s : float
            Device time from now in which the board moves the setpoint to the targets, within its slew limits
            [s]; 0 to 0.5.

        Raises
        ------
        SetpointError
            A target is outside the limits that the board's parameters set, or no loop is closed. Nothing was
            sent.
        """
        options_deg = {"elevation": elevation_deg, "pitch": pitch_deg, "travel": travel_deg}
        targets_deg = {axis: value for axis, value in options_deg.items() if value is not None}
        self.flying.setpoint(targets_deg, lead_s)

    def setpoint_limits_deg(self) -> dict[str, tuple[float, float]]:
        """Return the lowest and the highest setpoint [deg] that the board accepts, for ``elevation``,
        ``pitch`` and ``travel``.
        """
        return self.flying.setpoint_limits_deg()

    def hold(self) -> None:
        """Make the arm's present position the setpoint, limited to the setpoints that the board accepts."""
        self.flying.hold()

    def land(self, *, wait: bool = True) -> None:
        """Let the board descend under control and switch the motors off on the table; on an idle board, do
        nothing.

        Parameters
        ----------
        wait : bool
            True returns when the motors are off; False returns when the board has accepted the command.

        Raises
        ------
        FlightAborted
            A fault switched the motors off before the table was reached, or the arm rests at other angles
            than before the take-off.
        """
        self.landing.land(wait=wait)

    def stop(self) -> None:
        """Switch both motors off immediately, in any state, and wait until telemetry shows it. An arm in the
        air falls.

        Raises
        ------
        LinkError
            The board did not answer. Use the rig's own stop switch.
        """
        self.flying.stop()

    def bring_down(
        self, on_landing: Callable[[], object] | None = None, on_wait: Callable[[], object] | None = None
    ) -> str:
        """Bring the arm onto the table from any state, and wait until the board reports that the motors are
        off.

        This is the end of every flight. A landing that the board has begun by itself is not interrupted. The
        motors of an arm that rests on the table are switched off.

        Parameters
        ----------
        on_landing, on_wait : callable, optional
            Called when the landing begins, and about twenty times per second until it ends.

        Returns
        -------
        str
            The fault that ended the flight, the restart of the board, or the axes whose angles at rest differ
            from those before the take-off; empty after an ordinary landing.

        Raises
        ------
        LinkLost
            The board cannot be reached; it lands by itself.
        HeliError
            The board refuses to land.
        KeyboardInterrupt
            An interrupt came. The landing continues.
        """
        return self.landing.bring_down(on_landing, on_wait)

    @contextlib.contextmanager
    def landing_on_error(self) -> Iterator[None]:
        """Land if any error, or an interrupt, ends a ``with`` block while the arm is in the air; the error
        then goes on, with a note if the landing failed.
        """
        try:
            yield
        except BaseException as error:
            if self.is_in_the_air:
                self.landing.land_after(error)
            raise

    def restart_text(self) -> str:
        """Return the newest restart of the board with its reason, and what to do."""
        return self.landing.restart_text()

    def cut_motors(self, cause: str) -> str:
        """Switch the motors off in the air, because a landing is impossible or not wanted, and say so on
        standard error.

        Parameters
        ----------
        cause : str
            Reason for which the landing was ended.

        Returns
        -------
        str
            One line for the outcome.
        """
        return self.landing.cut_motors(cause)

    def stream(self) -> None:
        """Let this program set the motor voltages by `voltages`.

        The first voltages must follow within ``setpoint_hold_s``, a parameter of the board in seconds;
        otherwise the board holds level.

        Raises
        ------
        CommandRefused
            The board is not armed.
        """
        self.bench.stream()

    def voltages(self, front_V: float, back_V: float, valid_s: float = 0.05) -> None:
        """Send motor voltages, without waiting for an answer; `stream` must come first.

        Parameters
        ----------
        front_V, back_V : float
            Voltages [V], between the board's parameters ``motor_min_V`` and ``motor_max_V``.
        valid_s : float
            Time for which the board applies them without newer ones [s]; then it holds level by itself.

        Raises
        ------
        SetpointError
            A voltage is outside the board's limits. Nothing was sent.
        """
        self.bench.voltages(front_V, back_V, valid_s)

    def excite(
        self,
        kind: Excitation | str,
        front_V: float = 0.0,
        back_V: float = 0.0,
        *,
        start_Hz: float = 0.1,
        stop_Hz: float = 2.0,
        duration_s: float = 10.0,
        seed: int = 1,
    ) -> None:
        """Let the board generate a test signal and add it to the motor voltages.

        Parameters
        ----------
        kind : Excitation or str
            ``step``, ``doublet``, ``chirp``, ``multisine`` or ``prbs``.
        front_V, back_V : float
            Amplitudes on the motors [V].
        start_Hz, stop_Hz : float
            Lowest and highest frequency (chirp, multisine); ``stop_Hz`` is the switching rate of prbs [Hz].
        duration_s : float
            Length [s]; the signal ends by itself.
        seed : int
            Seed of prbs, not 0.

        Raises
        ------
        ParameterError
            If the excitation is unknown.
        CommandRefused
            If a value is out of range, or the motors are off.
        """
        self.bench.excite(
            kind, front_V, back_V, start_Hz=start_Hz, stop_Hz=stop_Hz, duration_s=duration_s, seed=seed
        )

    def excite_stop(self) -> None:
        """End the excitation; the motors keep their other voltages."""
        self.bench.excite_stop()

    def zero(self, axes: Axes = ALL_AXES) -> None:
        """Make the present position the rest angle (elevation) or the zero (pitch, travel) of the encoders.

        Parameters
        ----------
        axes : Axes
            Axes whose encoders are referenced.

        Raises
        ------
        CommandRefused
            The board is not idle.
        """
        self.bench.zero(axes)

    def clear_fault(self) -> None:
        """Leave the fault state for idle; the motors stay off. Remove the cause first.

        Raises
        ------
        CommandRefused
            The board is not in the fault state.
        """
        self.bench.clear_fault()

    def run_controller(
        self,
        law: ControlLaw,
        *,
        rate_Hz: float = 200.0,
        duration_s: float,
        valid_s: float = 0.05,
        after: AfterLaw = "hold",
    ) -> ControllerReport:
        """Fly a control law written in Python, over streamed voltages; see `heli_host.fly.run_controller`.

        Parameters
        ----------
        law : callable taking Sample, returning (front_V, back_V)
            The control law, called in the caller's thread. Its voltages are limited to the board's range. If
            it has an attribute ``setpoints_rad``, a mapping by axis [rad], the log gets those as setpoints.
        rate_Hz : float
            Rate of the calls on device time [Hz]; at most 250.
        duration_s : float
            Length of the flight in device time [s].
        valid_s : float
            Time for which the board applies voltages without newer ones [s]. After it the board holds level.
        after : {"hold", "land", "stop"}
            What follows: the board's own law holds the position, or the board lands, or the motors are
            switched off and an arm in the air falls.

        Returns
        -------
        ControllerReport
            Rate, misses and latencies.

        Raises
        ------
        ControllerError
            The link cannot reach the rate, or the law raised or did not return two finite voltages. The board
            holds its position.
        FlightAborted
            A fault switched the motors off.
        """
        return run_controller(self, law, rate_Hz=rate_Hz, duration_s=duration_s, valid_s=valid_s, after=after)

    def load_law(self, law: LawProgram | LawLike) -> None:
        """Upload a control law to the board, which verifies it. The law does not fly yet: see `fly_law`.

        A board forgets the law at a reset; `arm` uploads it again.

        Parameters
        ----------
        law : LawProgram or LawLike
            The result of `@control_law` or `from_gain`, or its program.

        Raises
        ------
        BadLaw
            The object is not a law, or no board could run it.
        CommandRefused
            The board refused the law; the message gives its reason.
        """
        program = program_of(law)
        upload(self.session, program)
        self._program, self._program_restarts = program, self.session.counters.restarts

    def fly_law(
        self,
        law: LawProgram | LawLike,
        *,
        duration_s: float,
        after: AfterLaw = "hold",
        parameters: Mapping[str, float] | None = None,
    ) -> LawReport:
        """Let the board run a control law at up to 1 kHz, with its own law in parallel as a fallback.

        The board must hover under its own law. The law follows the setpoints of `setpoint`. The board's own
        law takes over when the law fails its checks; that ends this call, and the report gives the reason.

        Parameters
        ----------
        law : LawProgram or LawLike
            The result of `@control_law` or `from_gain`, or its program. It is uploaded unless the board
            holds it already.
        duration_s : float
            Length of the flight in device time [s].
        after : {"hold", "land", "stop"}
            What follows: the board's own law holds the position, or the board lands, or the motors are
            switched off and an arm in the air falls.
        parameters : mapping of str to float, optional
            Values of the law's parameters that differ from its defaults.

        Returns
        -------
        LawReport
            Length of the flight, and what ended it.

        Raises
        ------
        BadLaw
            The object is not a law, or no board could run it.
        CommandRefused
            The board refused the law, or does not hover.
        FlightAborted
            A fault switched the motors off, or the board's own law took over immediately.
        """
        program = program_of(law)
        self.load_law(program)
        return fly_law(self, program, duration_s=duration_s, after=after, parameters=parameters)

    def set_law_parameter(self, law: LawProgram | LawLike, name: str, value: float) -> float:
        """Change a parameter of the uploaded law, also in flight.

        Parameters
        ----------
        law : LawProgram or LawLike
            The law that the board holds.
        name : str
            Name of the parameter.
        value : float
            New value.

        Returns
        -------
        float
            Value in force: `value` rounded to single precision.

        Raises
        ------
        BadLaw
            The law has no parameter of this name.
        """
        return set_parameter(self.session, program_of(law), name, value)

    def fly(
        self, plans: AnyPlan | Sequence[AnyPlan], log: str | Path | None = None, *, overwrite: bool = False
    ) -> FlightSummary:
        """Take off, fly plans one after the other, land; `heli_host.fly.runner.fly` has more options.

        Blocks until the motors are off. Ctrl-C lands; a second Ctrl-C switches the motors off.

        Parameters
        ----------
        plans : Plan, str or Path, or a sequence of them
            Plans, names of built-in plans, or TOML files.
        log : str or Path or None
            Log file to write; its folder is created.
        overwrite : bool
            True replaces an existing log; False refuses to fly if there is one.

        Returns
        -------
        FlightSummary
            Outcome, tracking errors and counters; in simulation also contradictions to the rig.

        Raises
        ------
        PlanError
            A plan cannot be flown on this board. The motors stay off.
        LogWriteError
            The log exists already, or cannot be created. The motors stay off.
        """
        if self._fly_plans is None:
            raise PlanError(
                "a Heli that is made from a session cannot fly plans",
                "connect with heli_host.connect, or give fly_plans=heli_host.fly.runner.fly",
            )
        rig = transport_rig(self.session.transport)
        return self._fly_plans(self, plans, log_path=log, overwrite=overwrite, rig=rig)

    def _end(self, error: BaseException | None) -> None:
        """End the session, after a landing if the arm is in the air; `error` ended the block."""
        if self._closed:
            return
        self._closed = True
        trouble = ""
        try:
            if self.is_in_the_air and (self.land_on_exit or error is not None):
                trouble = self.landing.land_after(error)
            else:
                # The motors of an arm on the table, or of one that the program wants to fall.
                for _ in range(STOP_TRIES):
                    if not self.motors_may_run:
                        break
                    with contextlib.suppress(HeliError):
                        self.stop()
        finally:
            self.session.close()
        if trouble and error is None:
            raise FlightAborted(trouble)
