"""Reads which parameters a board has stored, if it saved them under another parameter schema."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from heli_host.declaration import PARAMS, ParamsOriginMessage, ParamsOriginReadMessage, ParamsSource

if TYPE_CHECKING:
    from heli_host.link.session import Session


@dataclass(frozen=True)
class ParameterOrigin:
    """Origin of the parameters on a board: kept, dropped and new ones."""

    source: ParamsSource  # Source of the parameters in force
    kept: int  # Stored values in force
    dropped: int  # Stored values that no parameter takes: unknown, or out of range
    new: tuple[str, ...]  # Parameters at their defaults, because the stored set had no usable value


def read_origin(session: Session) -> ParameterOrigin:
    """Ask the board which parameters its stored set gave."""
    answer = ParamsOriginMessage.unpack(session.request(ParamsOriginReadMessage(0)).payload)
    bits = answer.new_0 | answer.new_1 << 32 | answer.new_2 << 64
    return ParameterOrigin(
        source=ParamsSource(answer.source),
        kept=answer.kept,
        dropped=answer.dropped,
        new=tuple(spec.name for spec in PARAMS if bits >> spec.index & 1),
    )


def migration_text(origin: ParameterOrigin) -> str:
    """Describe the migration of parameters stored under another schema; empty if there was none."""
    if origin.source is not ParamsSource.MIGRATED:
        return ""
    new = f"{', '.join(origin.new)} at the default" if origin.new else "none new"
    return (
        f"the board saved its parameters under another schema: {origin.kept} kept, {new}, {origin.dropped} "
        "dropped; check them, then heli-host params save"
    )
