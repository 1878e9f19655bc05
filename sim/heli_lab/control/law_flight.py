"""Fly control laws with the options of the command line, and measure their test flight.

The test flight is a step of travel and then sines of elevation and travel.
"""

from __future__ import annotations

import math
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from heli_host.board.interrupts import was_interrupted
from heli_host.board.law_program import LawProgram
from heli_host.data.flight import Flight
from heli_host.data.log.reader import read_flight
from heli_host.data.response import effort_V, flight_under_law, responses
from heli_host.errors import FlightDataError
from heli_host.fly.pilot import LAW_TAKEN_OVER
from heli_host.fly.plan import Plan
from heli_host.ui.cli.flight import FlightOptions, FlownFlight, fly_plans
from heli_host.ui.cli.say import QUIET

from heli_lab.simulated_board import WITHOUT_TRAVEL_CHECKS


def fly_law(
    program: LawProgram | None, options: FlightOptions, plan: Plan, typed: str = ""
) -> tuple[FlownFlight, LawTrial]:
    """Fly a plan with a law; None: the law of the board."""
    # Returns `flown`, `trial`.
    # The caller must write the files of the flight, and then call `FlownFlight.raise_if_not_completed`, which
    # raises if the board's own law took over.
    flown, taken_over = flown_with(program, options, plan, typed)
    if not taken_over and not flown.summary.completed:
        # No trial can be measured, so the caller cannot write these files.
        flown.report()
        flown.write()
        flown.raise_if_not_completed()
    return flown, LawTrial.of_log(flown.log, taken_over)


def fly_trial(program: LawProgram | None, options: FlightOptions, plan: Plan) -> LawTrial:
    """Fly a plan with a law, and return the result only: no output is printed, and no file is kept."""
    # A takeover by the board's own law is a result. Any other end before the plan's is an error.
    quiet_setting = QUIET.set(True)
    try:
        with tempfile.TemporaryDirectory() as folder:
            trial_options = replace(options, log=Path(folder) / "trial.mcap")
            flown, taken_over = flown_with(program, trial_options, plan)
            if was_interrupted(flown.summary.outcome):
                # After an error, a caller goes on with its next flight; Ctrl-C must end all of them.
                raise KeyboardInterrupt
            if not taken_over:
                flown.raise_if_not_completed()
            return LawTrial.of_log(flown.log, taken_over)
    finally:
        QUIET.reset(quiet_setting)


def flown_with(
    program: LawProgram | None, options: FlightOptions, plan: Plan, plan_name: str = ""
) -> tuple[FlownFlight, str]:
    """Fly a plan with a law. Return the flight, completed or not, and why the board's own law took over,
    empty if it did not.
    """
    from heli_host.board.law_flight import engage

    flown = fly_plans(
        _without_travel_checks(options) if program is None else options,
        [plan],
        plan_names=[plan_name],
        on_taken_off=(lambda heli: engage(heli, program)) if program is not None else None,
    )
    # An outcome is such as "law taken over: jump (3.1 V)".
    outcome, _, reason = flown.summary.outcome.partition(": ")
    taken_over = reason.partition(" ")[0] if outcome == LAW_TAKEN_OVER else ""
    return flown, taken_over


def _without_travel_checks(options: FlightOptions) -> FlightOptions:
    """Return the options of a simulated flight in which the board does not tilt the arm to check a silent
    travel encoder.
    """
    # The board checks no encoder while an uploaded law flies. With such tilts, its own law would have an
    # overshoot of 23 % instead of 12 %, and not settle. A real board keeps its checks.
    if not options.sil:
        return options
    return replace(options, parameters={**options.parameters_to_set(), **WITHOUT_TRAVEL_CHECKS})


STEP_deg: Final = 10.0
_STEP_AT_s: Final = 2.0
"""Time of the step [s]. The setpoint is held until then, so that the step begins at rest."""
_SINES_AT_s: Final = 12.0
_PLAN_NAME: Final = "trial"
_TOLERANCE_deg: Final = 180.0
"""Large enough that no error aborts the flight, because a flight with large errors is a valid result too."""


@dataclass(frozen=True)
class LawTrial:
    """Result of a test flight of a law."""

    flight: Flight  # The rows that the law flew, with time from the first of them on
    taken_over: str = ""  # Why the board's own law took over; empty if it did not

    @staticmethod
    def of_log(log: Path, taken_over: str = "") -> LawTrial:
        """Read the flight of a law from its `log`; `taken_over` is the reason of a takeover, or empty."""
        return LawTrial(flight_of_law(log), taken_over)

    def as_dict(self) -> dict[str, Any]:
        """Return the result as a dictionary for JSON."""
        elevation, _, travel = responses(self.flight)
        return {
            "travel_step_deg": travel.step_deg,
            "travel_overshoot_percent": travel.overshoot_percent,
            "travel_settling_s": travel.settling_s,
            "elevation_rms_deg": elevation.rms_deg,
            "travel_rms_deg": travel.rms_deg,
            "effort_V": effort_V(self.flight),
            "taken_over": self.taken_over,
        }

    def __str__(self) -> str:
        elevation, _, travel = responses(self.flight)
        step = "travel step: not flown to its end"
        if not math.isnan(travel.step_deg):
            settling = (
                "not settled" if math.isnan(travel.settling_s) else f"settling time {travel.settling_s:.1f} s"
            )
            step = f"travel step: overshoot {travel.overshoot_percent:.0f} %, {settling}"
        over = f"; the board's control law took over: {self.taken_over}" if self.taken_over else ""
        return (
            f"{step}; RMS error: elevation {_error_text(elevation.rms_deg)}, travel "
            f"{_error_text(travel.rms_deg)}; effort {effort_V(self.flight):.2f} V{over}"
        )


def _error_text(rms_deg: float) -> str:
    """Return a tracking error with its unit; a law may publish no setpoint, and then has no error."""
    return "not measured (no setpoint)" if math.isnan(rms_deg) else f"{rms_deg:.2f} deg"


def trial_plan(duration_s: float) -> Plan:
    """Return the plan of a trial that lasts `duration_s`: a step of travel, then sines."""
    step_s = min(duration_s, _SINES_AT_s) - _STEP_AT_s
    sines_s = duration_s - _SINES_AT_s
    segments = [f'kind = "hold"\nduration_s = {min(duration_s, _STEP_AT_s)}']
    if step_s > 0.0:
        segments.append(f'kind = "step"\ntravel_deg = {STEP_deg}\nduration_s = {step_s}')
    if sines_s > 0.0:
        segments.append(
            'kind = "sine"\nelevation_amplitude_deg = 4\nelevation_period_s = 15\n'
            f"travel_amplitude_deg = {STEP_deg}\ntravel_period_s = 20\nduration_s = {sines_s}"
        )
    tolerance = "\n".join(f"{axis}_deg = {_TOLERANCE_deg}" for axis in ("elevation", "pitch", "travel"))
    text = f'title = "Step of travel, then sines"\n\n[tolerance]\n{tolerance}\n' + "".join(
        f"\n[[segment]]\n{segment}\n" for segment in segments
    )
    return Plan.parse(text, f"{_PLAN_NAME}.toml", _PLAN_NAME)


def flight_of_law(path: Path) -> Flight:
    """Read a log, and cut it to the rows that a control law flew."""
    flight = read_flight(path, allow_gaps=True)
    if flight.setpoints_rad is None:
        raise FlightDataError(
            f"{path} contains no flight with setpoints", "give a log of a flight with a control law"
        )
    try:
        return flight_under_law(flight)
    except FlightDataError as error:
        raise FlightDataError(f"{path}: {error.cause}", error.remedy) from error
