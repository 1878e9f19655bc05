"""Flying a control law that is not the board's: in Python on this computer, or uploaded to the board.

A law in Python is called on device time, its voltages are streamed, and its timing is measured. The latency
from a sample to its voltage is measured without comparing clocks. Telemetry gives the voltage that acted in
each tick, so the tick of a voltage is known if it differs from the voltage before. While an uploaded law
flies, the board's own law runs in parallel and can take over.
"""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, Literal, NamedTuple, Protocol, get_args, runtime_checkable

import numpy as np
import numpy.typing as npt

from heli_host.board.law_program import LawProgram, check_number
from heli_host.board.samples import Sample
from heli_host.declaration import (
    AXES,
    PARAMS,
    Channel,
    Event,
    Flags,
    FollowingMessage,
    LawBeginMessage,
    LawEndMessage,
    LawFlyMessage,
    LawMessage,
    LawPartMessage,
    LawReadMessage,
    LawSetMessage,
    LawState,
    Param,
    State,
    Takeover,
)
from heli_host.errors import BadLaw, ControllerError, FlightAborted, HeliError, check_choice, fault_text
from heli_host.link.channels import physical
from heli_host.link.clock import TICK_S
from heli_host.link.engine import UNNUMBERED
from heli_host.link.events import LAW_SIGNAL_NAMES
from heli_host.link.telemetry import Ticks

if TYPE_CHECKING:
    from heli_host.board.parameters import Parameters
    from heli_host.link.events import LinkEvent
    from heli_host.link.session import Session


ControlLaw = Callable[[Sample], tuple[float, float]]
AfterLaw = Literal["hold", "land", "stop"]
"""Action of the board when a control law of the host, or an uploaded one, has ended."""
AFTER_LAW: Final = get_args(AfterLaw)


class Vehicle(Protocol):
    """The part of a helicopter's interface that flights of laws need; see `heli_host.Heli`."""

    session: Session
    params: Parameters

    @property
    def latest(self) -> Sample:
        """Newest sample."""
        ...

    @property
    def motors_may_run(self) -> bool:
        """False only if the newest sample shows a state with the motors off."""
        ...

    def control(self) -> None:
        """Close the board's control loops at the arm's present position."""
        ...

    def land(self) -> None:
        """Land, and wait until the motors are off."""
        ...

    def stop(self) -> None:
        """Switch the motors off."""
        ...

    def stream(self) -> None:
        """Let this program set the motor voltages."""
        ...

    def voltages(self, front_V: float, back_V: float, valid_s: float = 0.05) -> None:
        """Send motor voltages."""
        ...

    def wait(self, duration_s: float) -> None:
        """Wait for a duration of device time."""
        ...

    def wait_until(self, predicate: Callable[[Sample], bool], timeout_s: float) -> Sample:
        """Wait until a sample meets a condition."""
        ...


@runtime_checkable
class Following(Protocol):
    """A control law that publishes its setpoints, so that the log contains its tracking error."""

    setpoints_rad: Mapping[str, float]
    """Angle of each axis that it follows, by the axis' name, at its last call [rad]."""


_READ_INTERVAL_S = 0.001
_MIN_PERIOD_TICKS = int(PARAMS[Param.TELEMETRY_BATCH_TICKS].min)
_MAX_BATCH_TICKS = int(PARAMS[Param.TELEMETRY_BATCH_TICKS].max)
_MAX_TAKEOVERS = 5
# A duty of 1/2100 of a supply of at most 24 V, and the rounding of telemetry.
_SAME_V = 0.02
_DIFFERENT_V = 0.05
_LOOK_TICKS = 200


@dataclass(frozen=True)
class ControllerReport:
    """Timing of a control law in Python.

    Parameters
    ----------
    calls : int
        Times that the law was called.
    rate_Hz : float
        Achieved rate, on device time [Hz].
    misses : int
        Periods in which it was not called, because samples came late or the law took too long.
    takeovers : int
        Number of times that the board held level itself because voltages came too late.
    clipped : int
        Calls whose voltages were clipped to the board's limits.
    latency_p50_ms, latency_p95_ms, latency_max_ms : float
        Time from the tick of a sample to the tick in which its voltage acted, device time [ms]; nan if no
        voltage was recognised in telemetry.
    latency_count : int
        Number of calls from which the latency was measured: their voltages differ enough from the previous
        ones.
    law_p50_ms, law_p95_ms, law_max_ms : float
        Time that the law itself took on this computer [ms].
    """

    calls: int
    rate_Hz: float
    misses: int
    takeovers: int
    clipped: int
    latency_p50_ms: float
    latency_p95_ms: float
    latency_max_ms: float
    latency_count: int
    law_p50_ms: float
    law_p95_ms: float
    law_max_ms: float

    def __str__(self) -> str:
        return (
            f"{self.calls} calls at {self.rate_Hz:.1f} Hz, {self.misses} missed, {self.takeovers} takeovers; "
            f"sample to voltage {self.latency_p50_ms:.1f} ms (95 %: {self.latency_p95_ms:.1f}, "
            f"most: {self.latency_max_ms:.1f}); law {self.law_p50_ms:.2f} ms (95 %: {self.law_p95_ms:.2f})"
        )


@dataclass
class _Run:
    """Record of a control law in flight, with one entry per call in each list."""

    period_ticks: int
    duration_ticks: int
    valid_s: float
    tick: list[int] = field(default_factory=list)
    front_V: list[float] = field(default_factory=list)
    back_V: list[float] = field(default_factory=list)
    law_s: list[float] = field(default_factory=list)
    misses: int = 0
    takeovers: int = 0
    clipped: int = 0


def run_controller(
    heli: Vehicle,
    law: ControlLaw,
    *,
    rate_Hz: float = 200.0,
    duration_s: float,
    valid_s: float = 0.05,
    after: AfterLaw = "hold",
) -> ControllerReport:
    """Fly a control law over streamed voltages.

    The board must be armed or flying. While the law flies, telemetry comes in batches of one period and the
    port is read every millisecond; both are restored afterwards. Whatever ends it early, the on-board loops
    take over first.

    Parameters
    ----------
    law, rate_Hz, duration_s, valid_s, after
        As in `heli_host.Heli.run_controller`, which calls this; so are errors.
    """
    check_choice("after", after, AFTER_LAW)
    # A rate that is not positive gives a period of 0, which is refused like a rate that is too high.
    period_ticks = round(1.0 / (rate_Hz * TICK_S)) if rate_Hz > 0.0 else 0
    if period_ticks < _MIN_PERIOD_TICKS:
        most_Hz = 1.0 / (_MIN_PERIOD_TICKS * TICK_S)
        raise ControllerError(f"a control law cannot run at {rate_Hz:g} Hz", f"give at most {most_Hz:g} Hz")
    session, params = heli.session, heli.params
    batch_before, read_interval_before_s = params["telemetry_batch_ticks"], session.read_interval_s
    telemetry: list[Ticks] = []
    run = _Run(period_ticks, duration_ticks=round(duration_s / TICK_S), valid_s=valid_s)
    unsubscribe = session.subscribe_ticks(telemetry.append)
    try:
        params["telemetry_batch_ticks"] = min(period_ticks, _MAX_BATCH_TICKS)
        session.read_interval_s = _READ_INTERVAL_S
        _run_law_at_rate(heli, law, run)
    except BaseException:
        # Also after an interrupt; the first error is the one that matters.
        with contextlib.suppress(HeliError):
            if heli.motors_may_run:
                heli.control()
        raise
    finally:
        unsubscribe()
        session.read_interval_s = read_interval_before_s
        with contextlib.suppress(HeliError):
            params["telemetry_batch_ticks"] = batch_before
    if after == "hold":
        heli.control()  # streamed voltages have no law of the board in parallel; an uploaded law has
    _end_law(heli, after)
    return _summary_of_run(run, telemetry, session.ticks_counted_on)


def _run_law_at_rate(heli: Vehicle, law: ControlLaw, run: _Run) -> None:
    """Call a control law at its rate, and send its voltages, until the duration has passed. A takeover by the
    board is retried a few times, if it then holds level.
    """
    session = heli.session
    low_V, high_V = heli.params["motor_min_V"], heli.params["motor_max_V"]
    heli.stream()
    first_tick = due_tick = heli.latest.tick + 1

    def is_due_or_taken_over() -> bool:
        newest = session.latest
        return newest is not None and (newest.tick >= due_tick or session.state is not State.STREAMED)

    while True:
        session.wait_for(is_due_or_taken_over, step_s=TICK_S)
        sample = heli.latest
        if sample.state is State.FAULT:
            raise FlightAborted(f"the board switched the motors off: {fault_text(sample.fault)}")
        if sample.tick - first_tick >= run.duration_ticks:
            return
        if sample.state is not State.STREAMED:
            run.takeovers += 1
            if run.takeovers > _MAX_TAKEOVERS or sample.state is not State.HOLD:
                raise ControllerError(
                    f"the board took over ({sample.state.name.lower()}): voltages came too late",
                    "make the law faster, lower rate_Hz, or raise valid_s and voltage_valid_max_ms",
                )
            heli.stream()
            continue
        # Missed calls are not made up for: the next call stays on the grid of periods.
        missed_periods = max(sample.tick - due_tick, 0) // run.period_ticks
        run.misses += missed_periods
        due_tick += (1 + missed_periods) * run.period_ticks
        began_s = time.perf_counter()
        front_V, back_V = _checked_voltages(law, sample)
        run.law_s.append(time.perf_counter() - began_s)
        if isinstance(law, Following):
            session.stream(FollowingMessage(*(law.setpoints_rad[axis] for axis in AXES)))
        sent_front_V = min(max(front_V, low_V), high_V)
        sent_back_V = min(max(back_V, low_V), high_V)
        if sent_front_V != front_V or sent_back_V != back_V:
            run.clipped += 1
        heli.voltages(sent_front_V, sent_back_V, run.valid_s)
        run.tick.append(sample.tick)
        run.front_V.append(sent_front_V)
        run.back_V.append(sent_back_V)


def _checked_voltages(law: ControlLaw, sample: Sample) -> tuple[float, float]:
    """Call a control law, and check that it returns two finite voltages."""
    try:
        front_V, back_V = (float(value) for value in law(sample))
    except Exception as error:
        raise ControllerError(
            f"the control law failed: {type(error).__name__}: {error}",
            "return (front_V, back_V) for every sample",
        ) from error
    if not (math.isfinite(front_V) and math.isfinite(back_V)):
        raise ControllerError(
            f"the control law returned {front_V:g} and {back_V:g} V",
            "return two finite voltages, front and back",
        )
    return front_V, back_V


def _summary_of_run(
    run: _Run, telemetry: list[Ticks], unwrapped_ticks: Callable[[Ticks], npt.NDArray[np.int64]]
) -> ControllerReport:
    """Summarise a run: calls, misses, and percentiles of latency and of the law's computing time.

    `telemetry` has the voltages that acted during the run, and `unwrapped_ticks` returns its ticks without
    overflow.
    """
    latencies_ticks = np.empty(0)
    if telemetry and run.tick:
        tick = np.concatenate([unwrapped_ticks(ticks) for ticks in telemetry])
        raw = np.concatenate([ticks.raw for ticks in telemetry])
        acting_V = np.column_stack([physical(raw, motor) for motor in (Channel.FRONT, Channel.BACK)])
        latencies_ticks = _latencies_ticks(run, tick, acting_V)
    latency_p50_ms, latency_p95_ms, latency_max_ms = _percentiles(latencies_ticks * (TICK_S * 1e3))
    law_p50_ms, law_p95_ms, law_max_ms = _percentiles(np.array(run.law_s) * 1e3)
    span_s = (run.tick[-1] - run.tick[0]) * TICK_S if len(run.tick) > 1 else 0.0
    return ControllerReport(
        calls=len(run.tick),
        rate_Hz=(len(run.tick) - 1) / span_s if span_s > 0.0 else 0.0,
        misses=run.misses,
        takeovers=run.takeovers,
        clipped=run.clipped,
        latency_p50_ms=latency_p50_ms,
        latency_p95_ms=latency_p95_ms,
        latency_max_ms=latency_max_ms,
        latency_count=len(latencies_ticks),
        law_p50_ms=law_p50_ms,
        law_p95_ms=law_p95_ms,
        law_max_ms=law_max_ms,
    )


def _percentiles(values: npt.NDArray[np.float64]) -> tuple[float, float, float]:
    """Return the median, the 95th percentile and the maximum; nan without values."""
    if not values.size:
        return math.nan, math.nan, math.nan
    p50, p95, largest = (float(value) for value in np.percentile(values, (50, 95, 100)))
    return p50, p95, largest


def _latencies_ticks(
    run: _Run, tick: npt.NDArray[np.int64], volts: npt.NDArray[np.float64]
) -> npt.NDArray[np.float64]:
    """Return the ticks from each sample to the first tick in which its voltages acted. Shapes: `tick, volts`
    (n,).
    """
    # Calls whose voltages hardly differ from the previous ones are skipped, because their tick is ambiguous.
    sent_V = np.column_stack([run.front_V, run.back_V])  # (calls, 2)
    latencies = []
    for call in range(1, len(sent_V)):
        if np.abs(sent_V[call] - sent_V[call - 1]).max() < _DIFFERENT_V:
            continue
        start = int(np.searchsorted(tick, run.tick[call], side="right"))
        is_same = np.abs(volts[start : start + _LOOK_TICKS] - sent_V[call]).max(axis=1) < _SAME_V
        if is_same.any():
            latencies.append(float(tick[start + int(np.argmax(is_same))] - run.tick[call]))
    return np.array(latencies)


PART_WORDS: Final = sum(name.startswith("word_") for name in LawPartMessage.__slots__)
_ENGAGED_TIMEOUT_S: Final = 1.0
_ENGAGED_TICKS: Final = 200
"""Time within which telemetry shows that a law flies; the timeout is for a link without samples."""
_LAW_END_SPARE_S: Final = 10.0
"""Wait for the last sample of a flight beyond its duration, in case telemetry is lost [s]."""
_EVENT_LAG_S: Final = 0.1
"""Time by which the event of a takeover may follow its telemetry [s]."""


def loaded(session: Session) -> LawMessage:
    """Ask the board which law it has."""
    return LawMessage.unpack(session.request(LawReadMessage(UNNUMBERED)).payload)


def upload(session: Session, program: LawProgram) -> LawMessage:
    """Upload a law to the board, unless the board has it already; the board verifies it."""
    board_law = loaded(session)
    words = program.words
    if board_law.hash == program.hash and board_law.state in (LawState.READY, LawState.FLYING):
        return board_law
    session.command(LawBeginMessage(UNNUMBERED, program.hash, len(words)))
    for first in range(0, len(words), PART_WORDS):
        part = words[first : first + PART_WORDS]
        session.command(LawPartMessage(UNNUMBERED, first, *part, *([0] * (PART_WORDS - len(part)))))
    session.command(LawEndMessage(UNNUMBERED))
    return loaded(session)


def set_parameter(session: Session, program: LawProgram, name: str, value: float) -> float:
    """Change a parameter of the law on the board, in flight too."""
    names = [parameter_name for parameter_name, _ in program.parameters]
    if name not in names:
        known = ", ".join(names) or "none"
        raise BadLaw(f"control law {program.name} has no parameter {name}", f"choose from: {known}")
    check_number(f"parameter {name}", value)
    return session.command(LawSetMessage(UNNUMBERED, names.index(name), value)).value


@dataclass(frozen=True)
class LawReport:
    """Result of the flight of a law."""

    name: str  # Name of the law
    hash: int  # Hash of the law's program
    flown_s: float  # Time during which the law's voltages acted [s]
    taken_over: str = ""  # Reason for which the board's own law took over; empty if a command requested it
    value: float = 0.0  # Value that caused the takeover; the reason defines its meaning

    def __str__(self) -> str:
        end = f"; taken over: {self.taken_over} ({self.value:.4g})" if self.taken_over else ""
        return f"{self.name} flew for {self.flown_s:.1f} s on the board{end}"


class TakeoverReason(NamedTuple):
    """Why the board's built-in law took over, and the value that was judged."""

    name: str
    value: float


def takeover_reason(event: LinkEvent) -> TakeoverReason | None:
    """Return the reason for which the board's built-in law took over, from an event."""
    message = event.message
    if message is None or message.kind != Event.LAW_TAKEN_OVER:
        return None
    is_known = message.detail in Takeover._value2member_map_
    name = Takeover(message.detail).name.lower() if is_known else f"reason {message.detail}"
    return TakeoverReason(name, message.value)


def takeover_since(heli: Vehicle, tick: int) -> TakeoverReason | None:
    """Return the reason of the board's newest takeover from a tick on; None without such an event."""
    # An event may arrive late: an older one would give the reason for which an earlier law was taken over.
    events = [event for event in heli.session.events if event.tick >= tick]
    reasons = [reason for event in events if (reason := takeover_reason(event))]
    return reasons[-1] if reasons else None


def engage(heli: Vehicle, program: LawProgram, parameters: Mapping[str, float] | None = None) -> int:
    """Start a law on the board from the next tick on; the board must hover under its own law."""
    upload(heli.session, program)
    signal_names = ", ".join(program.signal_names) or "none"
    # The log gets the names: telemetry only has the signals' values.
    heli.session.tell(
        LAW_SIGNAL_NAMES,
        f"law {program.name} ({program.hash:08x}); its signals: {signal_names}",
        program.signal_names,
    )
    for name, value in (parameters or {}).items():
        set_parameter(heli.session, program, name, value)
    start_tick = heli.latest.tick
    heli.session.command(LawFlyMessage(UNNUMBERED, on=1))
    first_law_tick: int | None = None

    def has_engaged_or_failed(sample: Sample) -> bool:
        nonlocal first_law_tick
        if first_law_tick is None and sample.flags & Flags.LAW:
            first_law_tick = sample.tick
        return first_law_tick is not None or sample.tick > start_tick + _ENGAGED_TICKS

    heli.wait_until(has_engaged_or_failed, _ENGAGED_TIMEOUT_S)
    if first_law_tick is None:
        takeover = takeover_since(heli, start_tick)
        reason = f": {takeover.name} ({takeover.value:.4g})" if takeover else ""
        raise FlightAborted(
            f"control law {program.name} was taken over immediately{reason}",
            "simulate it first with heli-host law check",
        )
    return first_law_tick


def fly_law(
    heli: Vehicle,
    program: LawProgram,
    *,
    duration_s: float,
    after: AfterLaw = "hold",
    parameters: Mapping[str, float] | None = None,
) -> LawReport:
    """Fly a law on the board for a while."""
    check_choice("after", after, AFTER_LAW)
    first_tick = engage(heli, program, parameters)
    end_tick = first_tick + round(duration_s / TICK_S)

    def has_ended(sample: Sample) -> bool:
        return sample.tick >= end_tick or not sample.flags & Flags.LAW

    last = heli.wait_until(has_ended, duration_s + _LAW_END_SPARE_S)
    takeover = TakeoverReason("", 0.0)
    if last.flags & Flags.LAW:
        heli.session.command(LawFlyMessage(UNNUMBERED, on=0))
    else:
        # The board took over. Telemetry shows this slightly before the event with the reason arrives.
        heli.wait(_EVENT_LAG_S)
        takeover = takeover_since(heli, first_tick) or TakeoverReason("unknown", 0.0)
    report = LawReport(
        program.name,
        program.hash,
        flown_s=(last.tick - first_tick) * TICK_S,
        taken_over=takeover.name,
        value=takeover.value,
    )
    if heli.latest.state is State.FAULT:
        raise FlightAborted(f"the board switched the motors off: {fault_text(heli.latest.fault)}")
    _end_law(heli, after)
    return report


def _end_law(heli: Vehicle, after: AfterLaw) -> None:
    """Land or stop; after ``hold`` the board's own law goes on."""
    if after == "land":
        heli.land()
    elif after == "stop":
        heli.stop()
