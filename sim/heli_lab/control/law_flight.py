"""Fly control laws with the options of the command line, for the verbs `law` and `class`."""

from __future__ import annotations

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from heli_host.board.interrupts import was_interrupted
from heli_host.board.law_program import LawProgram
from heli_host.fly.pilot import LAW_TAKEN_OVER
from heli_host.ui.cli.flight import FlightOptions, FlownFlight, fly_plans
from heli_host.ui.cli.say import QUIET

from heli_lab.control.law.trial import LawTrial

if TYPE_CHECKING:
    from heli_host.fly.plan import Plan


def fly_law(
    program: LawProgram | None, options: FlightOptions, plan: Plan, typed: str = ""
) -> tuple[FlownFlight, LawTrial]:
    """Fly a plan with a law. Returns `flown`, `trial`.

    The caller must write the files of the flight, and then call `FlownFlight.end`, which raises if the
    board's own law took over.
    """
    flown, taken_over = flown_with(program, options, plan, typed)
    if not (flown.summary.completed or taken_over):
        flown.report()
        flown.write()
        # This raises FlightAborted.
        flown.end()
    return flown, LawTrial.of_log(flown.log, taken_over)


def fly_trial(program: LawProgram | None, options: FlightOptions, plan: Plan) -> LawTrial:
    """Fly a plan with a law, and return the result only: no output is printed, and no file is kept."""
    quiet_setting = QUIET.set(True)
    try:
        with tempfile.TemporaryDirectory() as folder:
            trial_options = replace(options, log=Path(folder) / "trial.mcap")
            flown, taken_over = flown_with(program, trial_options, plan)
            if was_interrupted(flown.summary.outcome):
                # The caller flies more than one flight, and would go on after the error of one.
                raise KeyboardInterrupt
            if not taken_over:
                flown.end()
            return LawTrial.of_log(flown.log, taken_over)
    finally:
        QUIET.reset(quiet_setting)


def flown_with(
    program: LawProgram | None, options: FlightOptions, plan: Plan, typed: str = ""
) -> tuple[FlownFlight, str]:
    """Fly a plan with a law, and return the flight, whether it was completed or not. Returns `flown`,
    `taken_over`.
    """
    from heli_host.fly.guest_law import engage

    flown = fly_plans(
        options,
        [plan],
        plan_names=[typed],
        on_taken_off=(lambda heli: engage(heli, program)) if program is not None else None,
    )
    outcome, _, reason = flown.summary.outcome.partition(": ")
    return flown, reason.partition(" ")[0] if outcome == LAW_TAKEN_OVER else ""
