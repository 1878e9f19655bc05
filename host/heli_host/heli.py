"""The helicopter as a person programs it: a vehicle that flies plans and control laws, and `connect`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from heli_host.controller import After, ControlLaw, ControllerReport, run_controller
from heli_host.declaration import BAUD
from heli_host.fly.runner import PlanLike, fly
from heli_host.guest_law import LawReport, fly_law, set_parameter, upload
from heli_host.law_program import LawLike, LawProgram, program_of
from heli_host.link.session import HANDSHAKE_TIMEOUT_S, RECONNECT_TIMEOUT_S, Session
from heli_host.link.transport import (
    open_transport,
    transport_label,
    transport_rig,
    transport_rig_parameters,
)
from heli_host.log.summary import FlightSummary
from heli_host.rig_check import check_rig
from heli_host.telemetry_view import HISTORY_S
from heli_host.vehicle import Vehicle


class Heli(Vehicle):
    """A helicopter behind an open session; `connect` makes one.

    What it takes and does beyond plans and control laws is told at `heli_host.vehicle.Vehicle`: motors off at
    the end of a ``with`` block, setpoints kept alive, methods that return when telemetry shows their effect.
    """

    _program: LawProgram | None = None
    _program_restarts = 0

    def __repr__(self) -> str:
        transport = self.session.transport
        what = transport_label(transport) or self.info.board
        rig = transport_rig(transport)
        newest = repr(self.latest).strip("<>") if self.session.latest is not None else "no sample yet"
        return f"<Heli on {transport.url} ({what}{', rig ' + rig if rig else ''}): {newest}>"

    def arm(self) -> None:
        """As `heli_host.vehicle.Vehicle.arm`; a board that was reset gets the law again that it had.

        Raises
        ------
        RigMismatch
            The board is simulated, and its counts or directions contradict its rig.
        CommandRefused
            As for a vehicle.
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
        after: After = "hold",
    ) -> ControllerReport:
        """Fly a control law written in Python, over streamed voltages; see `heli_host.controller`.

        Parameters
        ----------
        law : callable taking Sample, returning (front_V, back_V)
            The control law; voltages beyond the board's limits are brought back to them. Where it has an
            attribute ``setpoints_rad``, a mapping by axis [rad], those are logged as the setpoints.
        rate_Hz : float
            How often it is called, on device time [Hz]; at most 250.
        duration_s : float
            How long, in device time [s].
        valid_s : float
            How long voltages may act when no others follow [s].
        after : {"hold", "land", "stop"}
            What follows: the on-board loops hold the position, or it lands, or the motors go off.

        Returns
        -------
        ControllerReport
            Rate, misses and latencies.

        Raises
        ------
        ControllerError
            The rate cannot be had, the law raised or returned no two finite voltages; the board holds its
            position.
        FlightAborted
            A fault switched the motors off.
        """
        return run_controller(self, law, rate_Hz=rate_Hz, duration_s=duration_s, valid_s=valid_s, after=after)

    def load_law(self, law: LawProgram | LawLike) -> None:
        """Bring a control law to the board, which verifies it.

        A board forgets it at a reset, and gets it again from here when it is next armed.

        Parameters
        ----------
        law : LawProgram or LawLike
            A law of the laboratory, or its program.

        Raises
        ------
        BadLaw
            It is no law, or one that no board could run.
        CommandRefused
            The board does not take it, and says why.
        """
        program = program_of(law)
        upload(self.session, program)
        self._program, self._program_restarts = program, self.session.counters.restarts

    def fly_law(
        self,
        law: LawProgram | LawLike,
        *,
        duration_s: float,
        after: After = "hold",
        parameters: Mapping[str, float] | None = None,
    ) -> LawReport:
        """Have the board itself fly a law, at up to 1 kHz, with its own law in the shadow.

        Setpoints go on as ever: the law follows `setpoint`. Whatever makes the board's own law take over ends
        the flight of this one; the report says why.

        Parameters
        ----------
        law : LawProgram or LawLike
            A law of the laboratory, or its program; sent when the board has another one, or was reset.
        duration_s : float
            How long, in device time [s].
        after : {"hold", "land", "stop"}
            What follows: the board's own law goes on, or it lands, or the motors go off.
        parameters : mapping of str to float, optional
            Parameters of the law that differ from its own values.

        Returns
        -------
        LawReport
            How long it flew, and what ended it.

        Raises
        ------
        BadLaw
            It is no law, or one that no board could run.
        CommandRefused
            The board does not take the law, or does not hover.
        FlightAborted
            A fault switched the motors off, or the law was taken over at once.
        """
        program = program_of(law)
        self.load_law(program)
        return fly_law(self, program, duration_s=duration_s, after=after, parameters=parameters)

    def set_law_parameter(self, law: LawProgram | LawLike, name: str, value: float) -> float:
        """Change a parameter of the law on the board, in flight too.

        Parameters
        ----------
        law : LawProgram or LawLike
            The law that the board has.
        name : str
            Which parameter.
        value : float
            Its new value.

        Returns
        -------
        float
            The value in force: the nearest of single precision.

        Raises
        ------
        BadLaw
            The law has no such parameter.
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

        Parameters
        ----------
        plans : Plan, str or Path, or a sequence of them
            Plans, names of built-in ones, or TOML files.
        log : str or Path or None
            Log to write; its folder is made.
        overwrite : bool
            Write over a log that is there, so that a cell of a notebook can run again; otherwise it is
            refused.

        Returns
        -------
        FlightSummary
            What was flown, how well, and what ended it; in simulation also what contradicts the rig.

        Raises
        ------
        PlanError
            A plan cannot be flown on this board; nothing has moved.
        LogWriteError
            The log is there already, or cannot be created; nothing has moved.
        """
        return fly(self, plans, log_path=log, overwrite=overwrite, rig=transport_rig(self.session.transport))


def connect(
    url: str = "sil://",
    *,
    baud: int = BAUD,
    reset_board: bool = False,
    keep_alive: bool = True,
    land_on_exit: bool = False,
    history_s: float = HISTORY_S,
    handshake_timeout_s: float = HANDSHAKE_TIMEOUT_S,
    reconnect_timeout_s: float = RECONNECT_TIMEOUT_S,
    session_number: int | None = None,
) -> Heli:
    """Open a board, on hardware or in simulation, and greet it.

    Parameters
    ----------
    url : str
        ``/dev/ttyACM0``, ``COM3``, ``socket://host:port``, or ``sil://?rig=makki2024&seed=1&speed=max``.
    baud : int
        Rate of a serial port [baud].
    reset_board : bool
        Reset a Due after opening its port.
    keep_alive : bool
        Send the last setpoint again ten times a second; see `Heli`.
    land_on_exit : bool
        Land, instead of switching off in the air, when a ``with`` block ends.
    history_s : float
        How much `Heli.samples` keeps [s].
    handshake_timeout_s : float
        Longest wait for the board's welcome [s].
    reconnect_timeout_s : float
        How long a lost board is looked for [s].
    session_number : int or None
        Tells this session from others. None: random over a port, 1 in lockstep.

    Returns
    -------
    Heli
        Connected; use it in a ``with`` block.

    Raises
    ------
    LinkError
        The board cannot be reached: one of `PortError`, `BadBaud`, `HandshakeTimeout`, `WrongDevice`,
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
