"""Commands that need no closed loop: excitation, streamed voltages, zeros, faults."""

from __future__ import annotations

from functools import reduce
from operator import or_

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
from heli_host.setpoints import check_voltages
from heli_host.telemetry_view import TelemetryView

ALL_AXES = reduce(or_, Axes)

_STATE_TIMEOUT_S = 1.0


class OpenLoopCommands(TelemetryView):
    """Commands that concern motors and encoders, not flight.

    Parameters
    ----------
    session : Session
        Connected.
    history_s : float
        How much `samples` keeps [s].
    """

    def stream(self) -> None:
        """Hand the motor voltages to `voltages`; the first must follow within ``setpoint_hold_s``.

        Raises
        ------
        CommandRefused
            Not armed.
        """
        self.session.keep_alive(None)
        self.session.command(StreamMessage(0))
        self._wait_for_state(State.STREAMED)

    def voltages(self, front_V: float, back_V: float, valid_s: float = 0.05) -> None:
        """Stream motor voltages.

        Parameters
        ----------
        front_V, back_V : float
            Voltages [V], between ``motor_min_V`` and ``motor_max_V``.
        valid_s : float
            How long they may act without others following [s]; then the board holds level by itself.

        Raises
        ------
        SetpointError
            A voltage outside the board's limits; nothing was sent.
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
        """Add an excitation, generated on the board, to whatever drives the motors.

        Parameters
        ----------
        kind : Excitation or str
            ``step``, ``doublet``, ``chirp``, ``multisine`` or ``prbs``.
        front_V, back_V : float
            Amplitudes on the motors [V].
        start_Hz, stop_Hz : float
            Lowest and highest frequency (chirp, multisine); ``stop_Hz`` is the switching rate of prbs [Hz].
        duration_s : float
            Length [s]; then it ends by itself.
        seed : int
            Seed of prbs, not 0.

        Raises
        ------
        ParameterError
            There is no such excitation.
        CommandRefused
            A value out of range, or the motors are off.
        """
        if isinstance(kind, str):
            if kind.upper() not in Excitation.__members__:
                names = ", ".join(one.name.lower() for one in Excitation if one)
                raise ParameterError(f"unknown excitation {kind}", f"choose from {names}")
            kind = Excitation[kind.upper()]
        message = ExciteMessage(0, int(kind), front_V, back_V, start_Hz, stop_Hz, duration_s, seed)
        self.session.command(message)

    def excite_stop(self) -> None:
        """End a running excitation."""
        self.session.command(ExciteStopMessage(0))

    def zero(self, axes: Axes = ALL_AXES) -> None:
        """Take the present position as rest (elevation) or zero (pitch, travel); only while idle.

        Parameters
        ----------
        axes : Axes
            Axes to zero.

        Raises
        ------
        CommandRefused
            The board is not idle.
        """
        self.session.command(ZeroMessage(0, int(axes)))

    def clear_fault(self) -> None:
        """Leave the fault state for idle, once the cause is removed.

        Raises
        ------
        CommandRefused
            The board is in no fault.
        """
        self.session.command(ClearFaultMessage(0))
        self._wait_for_state(State.IDLE)

    def _wait_for_state(self, *states: State) -> None:
        # The ack has come; telemetry shows the state some batches later. A state that has already gone on,
        # into a fault for example, is for the caller to see.
        self.session.wait_for(lambda: self.session.state in states, _STATE_TIMEOUT_S)
