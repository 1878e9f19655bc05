"""Commands that need no closed loop: streamed voltages, excitation, encoder zeros, clearing of faults."""

from __future__ import annotations

from functools import reduce
from operator import or_

from heli_host.board.setpoints import check_voltages
from heli_host.board.telemetry_view import TelemetryView
from heli_host.declaration import (
    Axes,
    ClearFaultMessage,
    Excitation,
    ExciteMessage,
    ExciteStopMessage,
    State,
    StreamMessage,
    VoltagesMessage,
    ZeroMessage,
)
from heli_host.errors import ParameterError

ALL_AXES = reduce(or_, Axes)

_STATE_TIMEOUT_S = 1.0


class OpenLoopCommands(TelemetryView):
    """Commands that act on motors and encoders directly, without a control loop of the board.

    Parameters
    ----------
    session : Session
        Connected session.
    history_s : float
        Length of the history that `samples` can return [s].
    """

    def stream(self) -> None:
        """Let this program set the motor voltages by `voltages`.

        The first voltages must follow within ``setpoint_hold_s``, a parameter of the board in seconds;
        otherwise the board holds level.

        Raises
        ------
        CommandRefused
            The board is not armed.
        """
        self.session.keep_alive(None)
        self.session.command(StreamMessage(0))
        self._wait_for_state(State.STREAMED)

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
        check_voltages(front_V, back_V, self.params)
        valid_ms = min(max(round(valid_s * 1e3), 1), 0xFFFF)
        self.session.stream(VoltagesMessage(front_V, back_V, valid_ms))

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
        if isinstance(kind, str):
            if kind.upper() not in Excitation.__members__:
                names = ", ".join(member.name.lower() for member in Excitation if member)
                raise ParameterError(f"unknown excitation {kind}", f"choose from {names}")
            kind = Excitation[kind.upper()]
        message = ExciteMessage(0, int(kind), front_V, back_V, start_Hz, stop_Hz, duration_s, seed)
        self.session.command(message)

    def excite_stop(self) -> None:
        """End the excitation; the motors keep their other voltages."""
        self.session.command(ExciteStopMessage(0))

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
        self.session.command(ZeroMessage(0, int(axes)))

    def clear_fault(self) -> None:
        """Leave the fault state for idle; the motors stay off. Remove the cause first.

        Raises
        ------
        CommandRefused
            The board is not in the fault state.
        """
        self.session.command(ClearFaultMessage(0))
        self._wait_for_state(State.IDLE)

    def _wait_for_state(self, *states: State) -> None:
        # The ack has come; telemetry shows the state some batches later. A state that has already gone on,
        # into a fault for example, is for the caller to see.
        self.session.wait_for(lambda: self.session.state in states, _STATE_TIMEOUT_S)
