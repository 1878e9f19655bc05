"""Flights of control laws from the options of the command line, for `law` and `class`."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

from heli_host.cli.flight_command import FlightOptions, FlownFlight, fly_plans
from heli_host.cli.say import QUIET
from heli_host.declaration import Takeover
from heli_host.law_program import LawProgram

from heli_lab.law.trial import LawTrial

if TYPE_CHECKING:
    from heli_host.fly.plan import Plan
    from heli_host.heli import Heli

_LANDED: Final = Takeover.STATE.name.lower()


def fly_law(
    program: LawProgram | None, options: FlightOptions, plan: Plan, typed: str = ""
) -> tuple[FlownFlight, LawTrial]:
    """Fly a plan with a law. The caller writes the files of a completed flight; those of another flight are
    written here.

    Parameters
    ----------
    program : LawProgram or None
        Law as the board takes it; None for the board's own.
    typed : str
        Plan as typed, for the truth file of a blind flight.

    Returns
    -------
    FlownFlight
        The completed flight.
    LawTrial
        How the law followed its setpoints.

    Raises
    ------
    FlightAborted
        The flight was not completed; its files are written.
    HeliError
        As `fly_plans`.
    """
    flown, taken_over = flown_with(program, options, plan, typed)
    if not flown.summary.completed:
        flown.report()
        flown.write()
        flown.end()  # raises FlightAborted
    return flown, LawTrial.of_log(flown.log, taken_over)


def fly_trial(program: LawProgram | None, options: FlightOptions, plan: Plan) -> LawTrial:
    """Fly a plan with a law, or with the board's own for None, and print and keep nothing of the flight;
    `options` and `plan` as in `fly_law`.
    """
    before = QUIET.set(True)
    try:
        with tempfile.TemporaryDirectory() as folder:
            trial_options = replace(options, log=Path(folder) / "trial.mcap")
            flown, taken_over = flown_with(program, trial_options, plan)
            flown.end()
            return LawTrial.of_log(flown.log, taken_over)
    finally:
        QUIET.reset(before)


def flown_with(
    program: LawProgram | None, options: FlightOptions, plan: Plan, typed: str = ""
) -> tuple[FlownFlight, str]:
    """Fly a plan with a law; the flight, completed or not, and why the board's own law took over.

    Parameters
    ----------
    program, options, plan, typed
        As in `fly_law`; so are the errors.
    """
    from heli_host.guest_law import engage, takeover_text

    reasons: list[str] = []

    def note_takeovers(heli: Heli) -> None:
        # The landing ends closed loop, which the board reports as a takeover too.
        texts = (takeover_text(event) for event in heli.session.events)
        reasons.extend(text[0] for text in texts if text is not None and text[0] != _LANDED)

    flown = fly_plans(
        options,
        [plan],
        plan_names=[typed],
        on_taken_off=(lambda heli: engage(heli, program)) if program is not None else None,
        on_flown=note_takeovers,
    )
    return flown, ", ".join(reasons)
