"""Commands without a control loop: streamed voltages, excitation, encoder zeros, clearing of faults."""

from __future__ import annotations

from heli_host.board.flying import check_voltages
from heli_host.board.parameters import Parameters
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
from heli_host.link.engine import UNNUMBERED
from heli_host.link.session import Session


class Bench:
    """The bench part of a helicopter: commands that act on motors and encoders directly."""

    def __init__(self, session: Session, params: Parameters) -> None:
        self._session = session
        self._params = params

    def stream(self) -> None:
        """Let this program set the motor voltages."""
        self._session.keep_alive(None)
        self._session.command(StreamMessage(UNNUMBERED))
        self._session.wait_for_state(State.STREAMED)

    def voltages(self, front_V: float, back_V: float, valid_s: float) -> None:
        """Send motor voltages, which the board applies for `valid_s` without newer ones."""
        check_voltages(front_V, back_V, self._params)
        valid_ms = min(max(round(valid_s * 1e3), 1), 0xFFFF)
        self._session.stream(VoltagesMessage(front_V, back_V, valid_ms))

    def excite(
        self,
        kind: Excitation | str,
        front_V: float,
        back_V: float,
        *,
        start_Hz: float,
        stop_Hz: float,
        duration_s: float,
        seed: int,
    ) -> None:
        """Let the board generate a test signal and add it to the motor voltages."""
        if isinstance(kind, str):
            if kind.upper() not in Excitation.__members__:
                # NONE, whose value is 0, is not offered.
                names = ", ".join(member.name.lower() for member in Excitation if member)
                raise ParameterError(f"unknown excitation {kind}", f"choose from {names}")
            kind = Excitation[kind.upper()]
        message = ExciteMessage(
            request=UNNUMBERED,
            kind=int(kind),
            front_V=front_V,
            back_V=back_V,
            start_Hz=start_Hz,
            stop_Hz=stop_Hz,
            duration_s=duration_s,
            seed=seed,
        )
        self._session.command(message)

    def excite_stop(self) -> None:
        """End the excitation."""
        self._session.command(ExciteStopMessage(UNNUMBERED))

    def zero(self, axes: Axes) -> None:
        """Make the present position the rest angle or the zero of the encoders of these axes."""
        self._session.command(ZeroMessage(UNNUMBERED, int(axes)))

    def clear_fault(self) -> None:
        """Leave the fault state for idle."""
        self._session.command(ClearFaultMessage(UNNUMBERED))
        self._session.wait_for_state(State.IDLE)
