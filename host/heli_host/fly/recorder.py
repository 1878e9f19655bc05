"""Writes everything that comes over a session into a log: ticks, events, counters."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import fields
from datetime import UTC, datetime
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import TYPE_CHECKING

from heli_host.board.parameters import controller_name
from heli_host.data.log.blind import blind_notes, hide
from heli_host.data.log.disk import check_free_space
from heli_host.data.log.schema import LEVEL_ERROR, LEVEL_INFO, LEVEL_WARNING
from heli_host.data.log.writer import LogCounters, LogWriter
from heli_host.data.response import PHASE_EVENT
from heli_host.declaration import LINK_HASH, LINK_VERSION, StatusMessage
from heli_host.errors import HeliError, LogError
from heli_host.link.channels import rad_per_count
from heli_host.link.events import BOARD_RESTARTED, LAW_SIGNAL_NAMES, LINK_LOST, LINK_SILENT, LinkEvent
from heli_host.link.installation import installed_version
from heli_host.link.transport import transport_recipe

if TYPE_CHECKING:
    from heli_host.board.heli import Heli
    from heli_host.fly.plan import Plan
    from heli_host.link.telemetry import LinkCounters, Ticks

_LEVELS = {
    "fault": LEVEL_ERROR,
    LINK_LOST: LEVEL_ERROR,
    BOARD_RESTARTED: LEVEL_ERROR,
    LINK_SILENT: LEVEL_WARNING,
    "setpoint_stale": LEVEL_WARNING,
    "setpoint_rejected": LEVEL_WARNING,
}
SIMULATION = "simulation"
"""Name of the log's record that repeats a simulated flight."""
_URGENT = frozenset((LINK_LOST, LINK_SILENT, BOARD_RESTARTED, "fault"))


class Recorder:
    """Records a session into a log, from construction until `close`, with or without a plan.

    It queues what the session's reading thread delivers, and a separate thread writes it: a disk that blocks
    does not delay the flight. If the disk is full, it stops writing, keeps what is written, and sets `error`,
    which the end of a ``with`` block raises. The motors are not affected.

    Parameters
    ----------
    path : str or Path
        Log to create.
    rig_name : str
        Name of the rig, for the log.
    plans : sequence of Plan
        Plans that will be flown; their text goes into the log.
    board_name : str
        Description of the board for the log; empty to use the description that the board sent.
    duration_s : float
        Duration of the flight, for the check of free disk space; 0 if it is unknown [s].
    overwrite : bool
        Write over a file that is there; otherwise it is refused.
    seal_digest : str
        Seal of a flight whose cause is hidden, see `heli_host.data.log.blind`: the log has it in the place of
        address, rig, seed and boot id. Empty for any other flight.
    setup : Mapping of str to str
        Settings of the board before the flight, for `heli_host.ui.cli.flight`; empty if unknown.

    Raises
    ------
    LogWriteError
        If the log is there already, cannot be created, or may not find room on the disk.
    """

    def __init__(
        self,
        heli: Heli,
        path: str | Path,
        *,
        rig_name: str = "",
        plans: Sequence[Plan] = (),
        board_name: str = "",
        duration_s: float = 0.0,
        overwrite: bool = False,
        seal_digest: str = "",
        setup: Mapping[str, str] = MappingProxyType({}),
    ) -> None:
        self._seal_digest = seal_digest
        self.path = Path(path)
        self.error: LogError | None = None
        self._heli = heli
        self._closed = False
        parameters = dict(heli.params)
        self._parameters = parameters
        check_free_space(self.path, duration_s)
        self._writer = LogWriter(
            self.path,
            start_wall_ns=heli.session.transport.wall_ns(),
            metadata={
                **({} if seal_digest else _simulation_record(heli, setup)),
                "session": self._without_hidden_rig(self._session_record(heli, rig_name, plans, board_name)),
                "parameters": {name: repr(value) for name, value in parameters.items()},
                "plan": plan_texts(plans),
            },
            rad_per_count=rad_per_count(parameters),
            # A real board does not wait for the disk; a simulation in lockstep does.
            background=not heli.session.lockstep,
            overwrite=overwrite,
        )
        self._last_wall_ns = 0
        self._law_signals: dict[str, str] = {}
        for event in heli.session.events:
            self._note_signal_names(event)
        self._unsubscribe = (
            heli.session.subscribe_ticks(self._take_ticks),
            heli.session.subscribe_events(self._take_event),
            heli.session.subscribe_status(self._take_status),
        )

    def __enter__(self) -> Recorder:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
        if kind is None:
            self.check()

    @property
    def counters(self) -> LogCounters:
        """Counters of the rows and events that the log has accepted so far."""
        return self._writer.counters

    def mark_phase(self, tick: int, phase: str) -> None:
        """Record the beginning of a phase of the flight.

        Parameters
        ----------
        tick : int
            Device tick at which it begins.
        phase : str
            ``take-off``, the name of a plan, or ``landing``.
        """
        with self._keep_first_failure():
            self._writer.write_event(tick & 0xFFFFFFFF, PHASE_EVENT, phase)

    def note(self, name: str, text: str, level: int = LEVEL_INFO) -> None:
        """Record an event of the host, at the newest tick.

        Parameters
        ----------
        name : str
            Kind of event.
        text : str
            Event and its cause, for people.
        level : int
            Severity as in ``foxglove.Log``.
        """
        newest = self._heli.session.latest
        with self._keep_first_failure():
            tick = (newest.tick if newest else 0) & 0xFFFFFFFF
            self._writer.write_event(tick, name, self._text_for_log(text), level)

    def check(self) -> None:
        """Raise the error that stopped the writing, if there is one.

        Raises
        ------
        LogWriteError
            The disk is full, nearly full, or not accessible.
        """
        if self.error is not None:
            raise self.error

    def close(self, outcome: str = "recorded") -> None:
        """Write the last counters and the outcome, and close the log; a second call does nothing.

        Parameters
        ----------
        outcome : str
            ``completed``, or in one line what ended the flight.
        """
        if self._closed:
            return
        self._closed = True
        for unsubscribe in self._unsubscribe:
            unsubscribe()
        log_counters = self._writer.counters
        counters = _counts_by_name(self._heli.counters)
        last_metadata = {
            "counters": {name: str(value) for name, value in counters.items()},
            "result": {
                "outcome": self._text_for_log(outcome),
                "ticks_logged": str(log_counters.ticks_logged),
                "ticks_lost": str(log_counters.ticks_lost),
                "ticks_dropped": str(log_counters.ticks_dropped),
                "events_logged": str(log_counters.events_logged),
            },
        }
        changed_parameters = {
            name: repr(value)
            for name, value in self._present_parameters().items()
            if self._parameters.get(name) != value
        }
        if changed_parameters:
            last_metadata["parameters_changed"] = changed_parameters
        with self._keep_first_failure():
            self._writer.close(last_metadata)

    def _without_hidden_rig(self, session_record: dict[str, str]) -> dict[str, str]:
        """Return the record of a session; that of a blind flight without what reveals its rig."""
        return blind_notes(session_record, self._seal_digest) if self._seal_digest else session_record

    def _text_for_log(self, text: str) -> str:
        return hide(text) if self._seal_digest else text

    def _present_parameters(self) -> dict[str, float]:
        # A board that has restarted would be asked again, and may be gone.
        with contextlib.suppress(HeliError):
            return dict(self._heli.params)
        return {}

    def _take_ticks(self, ticks: Ticks) -> None:
        """Write new samples into the log."""
        if not len(ticks):
            return
        self._last_wall_ns = self._heli.session.transport.wall_ns()
        with self._keep_first_failure():
            self._writer.write_ticks(ticks.tick, ticks.raw)

    def _take_event(self, event: LinkEvent) -> None:
        """Write an event of the link; an urgent one immediately to the disk. A restart of the board begins a
        new stretch of device time.
        """
        with self._keep_first_failure():
            if event.kind == BOARD_RESTARTED:
                self._writer.skip(
                    max(0, event.wall_ns - self._last_wall_ns) / 1e9 if self._last_wall_ns else 0.0
                )
            level = _LEVELS.get(event.kind, LEVEL_INFO)
            self._writer.write_event(
                event.tick & 0xFFFFFFFF, event.kind, self._text_for_log(event.text), level
            )
            if event.kind in _URGENT:
                # What follows may be silence: nothing should wait in memory for a chunk to fill.
                self._writer.flush()
            self._note_signal_names(event)

    def _note_signal_names(self, event: LinkEvent) -> None:
        """Keep the names of a law's signals; a channel that two laws name differently keeps its own."""
        if event.kind != LAW_SIGNAL_NAMES:
            return
        for number, name in enumerate(event.names, 1):
            channel = f"signal_{number}"
            self._law_signals[channel] = name if self._law_signals.get(channel, name) == name else channel
        self._law_signals["law"] = event.text
        with self._keep_first_failure():
            self._writer.write_metadata("law", self._law_signals)

    def _take_status(self, status: StatusMessage) -> None:
        with self._keep_first_failure():
            self._writer.write_link(status.tick, _counts_by_name(self._heli.counters))

    @contextlib.contextmanager
    def _keep_first_failure(self) -> Iterator[None]:
        """Keep the first failure and go on without a log: an error must not reach the reading thread."""
        try:
            yield
        except LogError as error:
            self.error = self.error or error
        else:
            # Little space is an error too, while the log can still be completed.
            self.error = self.error or self._writer.space_error

    @staticmethod
    def _session_record(heli: Heli, rig_name: str, plans: Sequence[Plan], board_name: str) -> dict[str, str]:
        """Return the record `session` of the log: rig, board, versions, address and start."""
        info = heli.info
        wall_ns = heli.session.transport.wall_ns()
        return {
            "rig": rig_name,
            "board": board_name or info.board,
            "firmware": info.firmware_version,
            "link": info.link_version,
            "link_hash": f"{info.link_hash:08x}",
            "host": installed_version(),
            "host_link": LINK_VERSION,
            "host_link_hash": f"{LINK_HASH:08x}",
            "url": heli.session.transport.url,
            "start": datetime.fromtimestamp(wall_ns / 1e9, UTC).isoformat(timespec="milliseconds"),
            "boot_id": str(info.boot_id),
            "reset": info.reset,
            "boot_fault": info.boot_fault,
            "params_source": info.params_source,
            "controller": _controller_name(heli),
            "axes": " ".join(plans[0].axes) if plans else "",
        }


def _simulation_record(heli: Heli, setup: Mapping[str, str]) -> dict[str, dict[str, str]]:
    """Return the record that repeats a simulated flight; none for hardware."""
    recipe = transport_recipe(heli.session.transport)
    return {SIMULATION: {**recipe, **setup}} if recipe else {}


def _controller_name(heli: Heli) -> str:
    """Return the controller's name; for the default row, the board is not asked."""
    selected = heli.params["controller"]
    return controller_name(heli.session, selected) if selected in range(1, 8) else "default"


def plan_texts(plans: Sequence[Plan]) -> dict[str, str]:
    """Return the plans' texts by name; a plan flown twice is named twice.

    Parameters
    ----------
    plans : sequence of Plan
        In the order of the flight.
    """
    texts: dict[str, str] = {}
    for plan in plans:
        name, number = plan.name, 2
        while name in texts:
            name, number = f"{plan.name} ({number})", number + 1
        texts[name] = plan.text
    return texts


def _counts_by_name(counters: LinkCounters) -> dict[str, float]:
    """Return the counters of the host, and those of the board with the prefix ``board_``, by name."""
    counts: dict[str, float] = {}
    for entry in fields(counters):
        value = getattr(counters, entry.name)
        if isinstance(value, int):
            counts[entry.name] = value
    board = counters.board
    if board is not None:
        for entry in fields(board):
            if entry.name not in ("request", "tick"):
                counts[f"board_{entry.name}"] = getattr(board, entry.name)
    return counts
