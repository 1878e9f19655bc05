"""The helicopter as users program it: `connect`, and a vehicle that flies plans and control laws."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from heli_host.board.law_program import LawLike, LawProgram, program_of
from heli_host.board.rig_check import check_rig
from heli_host.board.telemetry_view import HISTORY_S
from heli_host.board.vehicle import AfterLaw, Vehicle
from heli_host.data.log.summary import FlightSummary
from heli_host.declaration import BAUD
from heli_host.fly.controller import ControlLaw, ControllerReport, run_controller
from heli_host.fly.guest_law import LawReport, fly_law, set_parameter, upload
from heli_host.fly.runner import PlanLike, fly
from heli_host.link.session import HANDSHAKE_TIMEOUT_S, RECONNECT_TIMEOUT_S, Session
from heli_host.link.transport import (
    open_transport,
    transport_label,
    transport_rig,
    transport_rig_parameters,
)


class Heli(Vehicle):
    """A connected helicopter; `connect` makes one.

    `board.vehicle.Vehicle` documents its parameters and what happens to the motors: an arm in the air
    lands at the end of the ``with`` block. This class adds flights of plans and of control laws.
    """

    _program: LawProgram | None = None
    _program_restarts = 0

    def __repr__(self) -> str:
        transport = self.session.transport
        board_text = transport_label(transport) or self.info.board
        rig = transport_rig(transport)
        newest = repr(self.latest).strip("<>") if self.session.latest is not None else "no sample yet"
        return f"<Heli on {transport.url} ({board_text}{', rig ' + rig if rig else ''}): {newest}>"

    def arm(self) -> None:
        """Enable the motor drivers at 0 V; see `heli_host.board.vehicle.Vehicle.arm`.

        A board that was reset gets its last law again first.

        Raises
        ------
        RigMismatch
            The board is simulated, and its encoder counts or directions contradict its rig.
        CommandRefused
            A pre-flight check failed, or the board is not idle. The motors stay off.
        """
        check_rig(transport_rig_parameters(self.session.transport), self.params, simulated=True)
        if self._program is not None and self.session.counters.restarts != self._program_restarts:
            self.load_law(self._program)
        super().arm()

    def run_controller(
        self,
        law: ControlLaw,
        *,
        rate_Hz: float = 200.0,
        duration_s: float,
        valid_s: float = 0.05,
        after: AfterLaw = "hold",
    ) -> ControllerReport:
        """Fly a control law written in Python, over streamed voltages; see `heli_host.fly.controller`.

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
        """Let the board run a control law at up to 1 kHz, with its own law running along as a fallback.

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
        self,
        plans: PlanLike | Sequence[PlanLike],
        log: str | Path | None = None,
        *,
        overwrite: bool = False,
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
        return fly(self, plans, log_path=log, overwrite=overwrite, rig=transport_rig(self.session.transport))


def connect(
    url: str = "sil://",
    *,
    baud: int = BAUD,
    reset_board: bool = False,
    keep_alive: bool = True,
    land_on_exit: bool = True,
    history_s: float = HISTORY_S,
    handshake_timeout_s: float = HANDSHAKE_TIMEOUT_S,
    reconnect_timeout_s: float = RECONNECT_TIMEOUT_S,
    session_number: int | None = None,
) -> Heli:
    """Connect to a board, physical or simulated. The motors are not touched.

    Parameters
    ----------
    url : str
        ``/dev/ttyACM0``, ``COM3``, ``socket://host:port``, or ``sil://?rig=makki2024&seed=1&speed=max``.
    baud : int
        Rate of a serial port [baud].
    reset_board : bool
        True resets a Due after opening its port: running motors go off, an arm in the air falls.
    keep_alive : bool
        True repeats the last setpoint ten times per second; see `heli_host.board.vehicle.Vehicle`.
    land_on_exit : bool
        False switches the motors off at the end of a ``with`` block without an error, instead of landing.
    history_s : float
        Length of the history that `Heli.samples` can return [s].
    handshake_timeout_s : float
        Longest wait for the board's welcome [s].
    reconnect_timeout_s : float
        Time for which a lost board is searched [s].
    session_number : int or None
        Number by which the board distinguishes this session. None: random over a port, 1 in lockstep.

    Returns
    -------
    Heli
        Connected; use it in a ``with`` block.

    Raises
    ------
    LinkError
        The board cannot be reached; one of `PortError`, `BadBaud`, `HandshakeTimeout`, `WrongDevice`,
        `LinkVersionMismatch`, `LinkLost`.

    Examples
    --------
    >>> import heli_host
    >>> with heli_host.connect("sil://") as heli:
    ...     heli.take_off(elevation_deg=0.0)
    ...     heli.setpoint(travel_deg=20.0)
    ...     heli.wait(8.0)
    ...     heli.land()
    ...     flown = heli.samples()
    """
    session = Session(
        open_transport(url, baud=baud, reset_board=reset_board),
        session_number=session_number,
        handshake_timeout_s=handshake_timeout_s,
        reconnect_timeout_s=reconnect_timeout_s,
    )
    try:
        session.connect()
        return Heli(session, keep_alive=keep_alive, land_on_exit=land_on_exit, history_s=history_s)
    except BaseException:
        session.close()
        raise
