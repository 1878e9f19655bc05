"""Upload a control law to the board and fly it; the board's own law runs in parallel and can take over."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from heli_host.board.law_program import LawProgram, check_number
from heli_host.board.samples import Sample
from heli_host.board.vehicle import AFTER_LAW
from heli_host.declaration import (
    Event,
    Flags,
    LawBeginMessage,
    LawEndMessage,
    LawFlyMessage,
    LawMessage,
    LawPartMessage,
    LawReadMessage,
    LawSetMessage,
    LawState,
    State,
    Takeover,
)
from heli_host.errors import BadLaw, FlightAborted, check_choice, fault_text
from heli_host.link.events import LAW_SIGNAL_NAMES

if TYPE_CHECKING:
    from heli_host.board.vehicle import AfterLaw, Vehicle
    from heli_host.link.events import LinkEvent
    from heli_host.link.session import Session

PART_WORDS: Final = sum(name.startswith("word_") for name in LawPartMessage.__slots__)
_ENGAGED_TIMEOUT_S: Final = 1.0


def loaded(session: Session) -> LawMessage:
    """Ask the board which law it has."""
    return LawMessage.unpack(session.request(LawReadMessage(0)).payload)


def upload(session: Session, program: LawProgram) -> LawMessage:
    """Upload a law to the board, unless the board has it already; the board verifies it."""
    board_law = loaded(session)
    words = program.words
    if board_law.hash == program.hash and board_law.state in (LawState.READY, LawState.FLYING):
        return board_law
    session.command(LawBeginMessage(0, program.hash, len(words)))
    for first in range(0, len(words), PART_WORDS):
        part = words[first : first + PART_WORDS]
        session.command(LawPartMessage(0, first, *part, *([0] * (PART_WORDS - len(part)))))
    session.command(LawEndMessage(0))
    return loaded(session)


def set_parameter(session: Session, program: LawProgram, name: str, value: float) -> float:
    """Change a parameter of the law on the board, in flight too."""
    names = [parameter_name for parameter_name, _ in program.parameters]
    if name not in names:
        known = ", ".join(names) or "none"
        raise BadLaw(f"control law {program.name} has no parameter {name}", f"choose from: {known}")
    check_number(f"parameter {name}", value)
    return session.command(LawSetMessage(0, names.index(name), value)).value


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


def takeover_text(event: LinkEvent) -> tuple[str, float] | None:
    """Return the reason for which the board's built-in law took over, from an event."""
    message = event.message
    if message is None or message.kind != Event.LAW_TAKEN_OVER:
        return None
    known = message.detail in Takeover._value2member_map_
    return (Takeover(message.detail).name.lower() if known else f"reason {message.detail}"), message.value


def engage(heli: Vehicle, program: LawProgram, parameters: Mapping[str, float] | None = None) -> int:
    """Start a law on the board from the next tick on; the board must hover under its own law."""
    upload(heli.session, program)
    signal_names = ", ".join(program.signal_names) or "none"
    heli.session.tell(
        LAW_SIGNAL_NAMES,
        f"law {program.name} ({program.hash:08x}); its signals: {signal_names}",
        program.signal_names,
    )
    for name, value in (parameters or {}).items():
        set_parameter(heli.session, program, name, value)
    start = heli.latest.tick
    heli.session.command(LawFlyMessage(0, 1))
    law_ticks: list[int] = []

    def has_engaged(sample: Sample) -> bool:
        if sample.flags & Flags.LAW:
            law_ticks.append(sample.tick)
        return bool(law_ticks) or sample.tick > start + 200

    heli.wait_until(has_engaged, _ENGAGED_TIMEOUT_S)
    if not law_ticks:
        reasons = [text for event in heli.session.events if (text := takeover_text(event))]
        reason = f": {reasons[-1][0]} ({reasons[-1][1]:.4g})" if reasons else ""
        raise FlightAborted(
            f"control law {program.name} was taken over immediately{reason}",
            "simulate it first with heli-host law check",
        )
    return law_ticks[0]


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
    first = engage(heli, program, parameters)
    end = first + round(duration_s * 1000.0)

    def over(sample: Sample) -> bool:
        return sample.tick >= end or not sample.flags & Flags.LAW

    last = heli.wait_until(over, duration_s + 10.0)
    report = LawReport(program.name, program.hash, (last.tick - first) * 1e-3)
    if not last.flags & Flags.LAW:
        heli.wait(0.1)
        reasons = [text for event in heli.session.events if (text := takeover_text(event))]
        reason, value = reasons[-1] if reasons else ("unknown", 0.0)
        report = LawReport(program.name, program.hash, report.flown_s, reason, value)
    else:
        heli.session.command(LawFlyMessage(0, 0))
    if heli.latest.state is State.FAULT:
        raise FlightAborted(f"the board switched the motors off: {fault_text(heli.latest.fault)}")
    if after == "land":
        heli.land()
    elif after == "stop":
        heli.stop()
    return report
