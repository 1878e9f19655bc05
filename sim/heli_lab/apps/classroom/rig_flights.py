"""Fly submissions on the physical rig, after a confirmation of each."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import TYPE_CHECKING

from heli_host.declaration import State
from heli_host.errors import HeliError, LinkError, fault_text, printable
from heli_host.ui.cli.board import open_board
from heli_host.ui.cli.flight_command import FlightOptions
from heli_host.ui.cli.say import say

from heli_lab.apps.classroom.marking import MarkedSubmission, scored_flight
from heli_lab.apps.classroom.submission import new_rig_log

if TYPE_CHECKING:
    from heli_host.fly.plan import Plan

Confirm = Callable[[str], bool | None]
"""Asks the person at the rig a question, and returns the answer; None ends the session."""
NOT_FLOWN = "not flown"
"""Outcome of a submission whose flight was not confirmed."""


def fly_on_rig(
    submissions: Sequence[MarkedSubmission], options: FlightOptions, plan: Plan, confirm: Confirm
) -> Iterator[tuple[MarkedSubmission, str]]:
    """Fly each submission on the rig, and yield the submission with the outcome.

    Each flight begins with the rig's parameters and the gains of the submission. Afterwards, the rig has its
    own parameters again.
    """
    with _parameters_restored(options.port) as rig_parameters:
        for marked in submissions:
            submission = marked.submission
            assert submission is not None
            try:
                is_confirmed, has_fault = _confirm_flight(options.port, submission.name, confirm)
                if is_confirmed is None:
                    return
                outcome = NOT_FLOWN
                if is_confirmed:
                    log = new_rig_log(marked.folder)
                    score = scored_flight(
                        submission,
                        replace(options, log=log, figure=log.with_suffix(".png"), clear_fault=has_fault),
                        submission.plan or plan,
                        {**rig_parameters, **submission.gains},
                    )
                    outcome = score.ended or "completed"
            except HeliError as error:
                yield marked, str(error)
                if isinstance(error, LinkError):
                    # Without a link, a person must first check the board.
                    return
            else:
                yield marked, outcome


def _confirm_flight(port: str | None, name: str, confirm: Confirm) -> tuple[bool | None, bool]:
    """Ask the person at the rig whether a submission named `name` may fly. Returns `is_confirmed`,
    `has_fault`.
    """
    with open_board(port) as heli:
        has_fault, fault = heli.state is State.FAULT, heli.fault
    name = printable(name)
    if has_fault:
        say(f"the rig has a fault: {fault_text(fault)}")
        return confirm(f"clear the fault, and fly {name} on the rig?"), True
    return confirm(f"fly {name} on the rig?"), False


@contextmanager
def _parameters_restored(port: str | None) -> Iterator[dict[str, float]]:
    """Read the parameters of a board, and restore them when the block ends."""
    with open_board(port) as heli:
        parameters = heli.params.dump()
    try:
        yield parameters
    finally:
        try:
            with open_board(port) as heli:
                heli.params.restore(parameters)
        except HeliError as error:
            say(f"warning: the rig has the parameters of a submission: {error}")
