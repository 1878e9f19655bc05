"""Options of the verbs that fly with a twin beside them."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Annotated, Final

import typer

if TYPE_CHECKING:
    from collections.abc import Callable

    from heli_host.heli import Heli
    from heli_host.twins import TwinMaker, TwinWatch

TwinOption = Annotated[
    str | None,
    typer.Option(
        "--twin",
        metavar="NAME|FILE",
        help="A model of the rig flies along and says when the two part: a rig, or a file of "
        "heli-host twin --learn.",
    ),
]
OnChangeOption = Annotated[
    str | None,
    typer.Option(
        "--on-change",
        metavar="tell|land",
        help="What happens when they part.  [default: tell]",
        show_default=False,
    ),
]
TELL: Final = "tell"
LAND: Final = "land"


def check_on_change(twin: str | None, on_change: str | None) -> bool:
    """Whether a change is to end in a landing: whether `on_change` says so; refuses words that mean nothing,
    and any without a `twin`.
    """
    # A twin's matrices are small: more threads only wait for each other. It counts before numpy is loaded.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if on_change is None:
        return False
    if on_change not in (TELL, LAND):
        raise typer.BadParameter(f"--on-change is {on_change}, give {TELL} or {LAND}")
    if twin is None:
        raise typer.BadParameter("--on-change needs --twin NAME|FILE")
    return on_change == LAND


def read_twin(twin: str | None) -> TwinMaker | None:
    """Read a `twin`, the name of a rig or a file, so that what is wrong with it is told before anything
    starts; None where none is asked for.
    """
    if twin is None:
        return None
    from heli_host.twins import open_twin

    return open_twin(twin)


def open_watch(
    heli: Heli, twin: TwinMaker | None, on_change: Callable[[], None] | None = None
) -> TwinWatch | None:
    """Let a `twin`, as `read_twin` gives it, fly along with a board; when they part `on_change` is called."""
    if twin is None:
        return None
    from heli_host.twins import FALSE_ALARM_INTERVAL_h, TwinWatch

    return TwinWatch(heli.session, twin(dict(heli.params), FALSE_ALARM_INTERVAL_h), on_change)
