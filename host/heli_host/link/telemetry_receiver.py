"""From telemetry batches to accepted samples: decoded, checked, counted, and compared with the events."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from heli_host.declaration import Channel, EventMessage, State
from heli_host.link.accounting import TickAccount
from heli_host.link.channels import MODES, declared
from heli_host.link.clock import ClockFit
from heli_host.link.missed_events import MissedEvents
from heli_host.link.telemetry import EMPTY_TICKS, TelemetryDecoder, Ticks

_HELD_BATCHES = 500


@dataclass(frozen=True)
class AcceptedTelemetry:
    """Contents of the batches that were held."""

    ticks: Ticks  # Accepted samples, in order
    missed: list[EventMessage]  # Events that the samples imply and that have not arrived, in order of time
    jumped_back: bool  # True if the tick number fell, because the board restarted


class TelemetryReceiver:
    """Telemetry of one session. Part of an `Engine`: its callers serialise all calls. `latest_raw` has shape
    (channels,).

    It owns the newest sample, the count of ticks, and the clock that relates device time to host time.
    """

    def __init__(self) -> None:
        self.account = TickAccount()
        self.clock = ClockFit()
        self.latest_raw: npt.NDArray[np.int32] | None = None
        self._missed = MissedEvents()
        self._decoder = TelemetryDecoder()
        self._waiting_payloads: list[bytes] = []
        self._undeclared = 0

    @property
    def malformed(self) -> int:
        """Number of frames that passed their CRC and are no telemetry of this declaration."""
        return self._undeclared + self._decoder.malformed

    @property
    def state(self) -> State | None:
        """Supervisor state in the newest sample; None before the first, and for one unknown to this host."""
        if self.latest_raw is None:
            return None
        state = State._value2member_map_.get(int(self.latest_raw[Channel.STATE]))
        return state if isinstance(state, State) else None

    @property
    def speed(self) -> float:
        """Device seconds per host second, at least 1; a fast simulation shortens all intervals."""
        estimate = self.clock.estimate()
        return 1.0 if estimate is None else max(estimate.rate, 1.0)

    def is_behind(self, tick: int) -> bool:
        """Whether a tick from the board is lower than the newest one accepted."""
        return self.account.last is not None and self.account.unwrap(tick) < self.account.last

    def hold(self, payload: bytes) -> None:
        """Hold one batch until `accept_held`."""
        self._waiting_payloads.append(payload)

    def shorten_held(self) -> None:
        """Keep only the newest batches while no session is open.

        After a reconnect these become samples, once the welcome has said that it is the same start.
        """
        del self._waiting_payloads[:-_HELD_BATCHES]

    def discard_held(self) -> None:
        """Discard the held batches, because they are older than the session."""
        self._waiting_payloads.clear()

    def restart(self) -> None:
        """Begin again with the next sample, because the board has restarted."""
        self._waiting_payloads.clear()
        self.account.restart()
        self._missed.restart()
        self.clock.reset()
        self.latest_raw = None

    def take_event(self, message: EventMessage) -> None:
        """Record an event that arrived, so that it is not reconstructed from samples."""
        self._missed.take_event(message)

    def accept_held(self, now_s: float) -> AcceptedTelemetry | None:
        """Turn the held batches into samples; None if there are no batches."""
        if not self._waiting_payloads:
            return None
        ticks = self._decoder.decode(self._waiting_payloads)
        self._waiting_payloads.clear()
        if self.latest_raw is None or (ticks.raw[:, MODES] != self.latest_raw[MODES]).any():
            ticks = self._without_undeclared(ticks)
        accepted, jumped_back = self.account.take(ticks)
        if not len(accepted):
            return AcceptedTelemetry(EMPTY_TICKS, [], jumped_back)
        self.latest_raw = accepted.raw[-1]
        self.clock.observe(self.account.last or 0, now_s)
        return AcceptedTelemetry(accepted, self._missed.take_ticks(accepted), jumped_back)

    def _without_undeclared(self, ticks: Ticks) -> Ticks:
        """Return the samples whose enumerations have declared values only.

        Other samples were corrupted on the board before their CRC was computed. Each run of such samples
        counts as one malformed frame.
        """
        is_declared = declared(ticks.raw)
        if is_declared.all():
            return ticks
        self._undeclared += int(np.count_nonzero(np.diff(is_declared.view(np.int8), prepend=np.int8(1)) < 0))
        return Ticks(ticks.tick[is_declared], ticks.raw[is_declared])
