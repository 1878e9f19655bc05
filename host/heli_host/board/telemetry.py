"""The reading part of a helicopter: samples in units, events, and waiting for them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from heli_host.board.parameters import Parameters
from heli_host.board.samples import Sample, SampleRing, Samples, Scales
from heli_host.declaration import ParamsSource, Reset
from heli_host.errors import LinkError, WaitTimeout, fault_text
from heli_host.link.clock import TICK_S, check_duration
from heli_host.link.events import BOARD_RESTARTED, LinkEvent
from heli_host.link.session import Session, Unsubscribe
from heli_host.link.telemetry import Ticks

_FIRST_SAMPLE_TIMEOUT_S = 5.0
_BOARDS = {0: "native", 1: "Arduino Due"}


@dataclass(frozen=True)
class BoardInfo:
    """Description that the board sent when it welcomed this session."""

    board: str  # ``"native"`` (simulated) or ``"Arduino Due"``
    firmware_version: str
    """firmware_version, link_version: Versions of the flight code and of the link's declaration."""
    link_version: str
    link_hash: int  # Hash of that declaration
    reset: str  # Cause of the board's last start: ``power_up``, ``user``, ``watchdog`` or ``software``
    boot_fault: str  # Fault recorded before that start, and how to fix it; empty for none
    boot_id: int  # Number that changes with every start
    params_source: str
    """Origin of its parameters: ``defaults``, ``stored``, ``fallback``, ``corrupt`` or ``migrated``."""


class Telemetry:
    """Samples of a session in units, and its parameters; it sends no commands that act."""

    def __init__(self, session: Session, history_s: float) -> None:
        self.session = session
        self.params = Parameters(session)
        self._ring = SampleRing(max(round(history_s / TICK_S), 1))
        self.params.refresh()
        self._scales, self._scales_revision = Scales(self.params), self.params.revision
        session.subscribe_events(self._take_event)
        session.subscribe_ticks(self._ring.append)
        if not session.wait_for(lambda: session.latest is not None, _FIRST_SAMPLE_TIMEOUT_S):
            raise WaitTimeout("the board answers but sends no samples", "reset it, then connect again")

    @property
    def info(self) -> BoardInfo:
        """Description that the board sent when it welcomed this session."""
        welcome = self.session.welcome
        return BoardInfo(
            board=_BOARDS.get(welcome.board, f"board {welcome.board}"),
            firmware_version=f"{welcome.firmware_major}.{welcome.firmware_minor}.{welcome.firmware_patch}",
            link_version=f"{welcome.link_major}.{welcome.link_minor}",
            link_hash=welcome.link_hash,
            reset=Reset(welcome.reset).name.lower(),
            boot_fault=fault_text(welcome.boot_fault) if welcome.boot_fault else "",
            boot_id=welcome.boot_id,
            params_source=ParamsSource(welcome.params_source).name.lower(),
        )

    @property
    def latest(self) -> Sample:
        """Newest sample; LinkError if none has come since the board started."""
        newest = self.session.latest
        if newest is None:
            raise LinkError("no sample has come from the board yet", "wait a moment, then try again")
        return self._current_scales().sample(*newest)

    def samples(self, last_s: float | None = None) -> Samples:
        """Return copies of the samples of the last `last_s`, or of the whole history, oldest first."""
        if last_s is None:
            return self._in_units(self._ring.newest())
        check_duration(last_s, "a history")
        return self._in_units(self._ring.newest(round(last_s / TICK_S)))

    def on_ticks(self, callback: Callable[[Samples], None]) -> Unsubscribe:
        """Register a callback for new samples, and return a function that cancels the subscription."""
        return self.session.subscribe_ticks(lambda ticks: callback(self._in_units(ticks)))

    def pace(self, step_s: float, duration_s: float | None) -> Iterator[float]:
        """Yield the device time that has passed [s], first 0 and then after each step."""
        start_s, passed_s = self.latest.t_s, 0.0
        while duration_s is None or passed_s < duration_s:
            yield passed_s
            self.session.wait(step_s if duration_s is None else min(step_s, duration_s - passed_s))
            passed_s = self.latest.t_s - start_s

    def wait_until(self, predicate: Callable[[Sample], bool], timeout_s: float) -> Sample:
        """Wait until the newest sample of a reading meets a condition, for `timeout_s` of device time."""
        first = self.latest
        end_tick = first.tick + timeout_s / TICK_S
        matching: list[Sample] = []

        def is_over() -> bool:
            """Whether the newest sample fulfils the condition, or the time has passed."""
            if self.session.latest is None:
                return False
            sample = self.latest
            if predicate(sample):
                matching.append(sample)
            # After a restart, the board counts from tick 0 again.
            return bool(matching) or sample.tick >= end_tick or sample.tick < first.tick

        self.session.wait_for(is_over)
        if not matching:
            raise WaitTimeout(
                f"the expected change did not happen within {timeout_s:g} s",
                "read heli.events for the reason",
            )
        return matching[0]

    def _in_units(self, ticks: Ticks) -> Samples:
        return self._current_scales().samples(self.session.ticks_counted_on(ticks), ticks.raw)

    def _current_scales(self) -> Scales:
        if self._scales_revision != self.params.revision:
            self._scales, self._scales_revision = Scales(self.params), self.params.revision
        return self._scales

    def _take_event(self, event: LinkEvent) -> None:
        if event.kind == BOARD_RESTARTED:
            self._ring.clear()
