"""Options of the verbs that fly together with a twin."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Annotated, Final

import typer

if TYPE_CHECKING:
    from collections.abc import Callable

    from heli_host.board.twins import TwinMaker, TwinWatch
    from heli_host.fly.heli import Heli

TwinOption = Annotated[
    str | None,
    typer.Option(
        "--twin",
        metavar="NAME|FILE",
        help="Compare the flight with this rig, or twin file, and report alarms.",
    ),
]
OnAlarmOption = Annotated[
    str | None,
    typer.Option(
        "--on-alarm",
        metavar="warn|land",
        help="Choose what an alarm of the twin does.  [default: warn]",
        show_default=False,
    ),
]
WARN: Final = "warn"
LAND: Final = "land"


def lands_on_alarm(twin: str | None, on_alarm: str | None) -> bool:
    """Return whether an alarm ends the flight in a landing, as `on_alarm` says; refuse any other word, and
    any word without a `twin`.
    """
    # A twin's matrices are small, so that more threads only wait for each other. Set it before numpy is
    # loaded.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if on_alarm is None:
        return False
    if on_alarm not in (WARN, LAND):
        raise typer.BadParameter(f"unknown --on-alarm '{on_alarm}'; choose {WARN} or {LAND}")
    if twin is None:
        raise typer.BadParameter("--on-alarm needs a twin; add --twin NAME|FILE")
    return on_alarm == LAND


def read_twin(twin: str | None) -> TwinMaker | None:
    """Read a `twin`, the name of a rig or a file, so that an error in it is reported before anything starts;
    None without a twin.
    """
    if twin is None:
        return None
    from heli_host.board.twins import open_twin

    return open_twin(twin)


def open_watch(
    heli: Heli, twin: TwinMaker | None, on_alarm: Callable[[], None] | None = None
) -> TwinWatch | None:
    """Let a `twin`, as `read_twin` gives it, fly along with a board; an alarm calls `on_alarm`."""
    if twin is None:
        return None
    from heli_host.board.twins import FALSE_ALARM_INTERVAL_h, TwinWatch

    return TwinWatch(heli.session, twin(dict(heli.params), FALSE_ALARM_INTERVAL_h), on_alarm)
