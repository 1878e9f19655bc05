"""Mark submissions: fly each on an equal simulated board, and write log, figure and mark into its folder."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

from heli_host.board.parameter_file import parameters_text
from heli_host.errors import FlightAborted, FlightDataError, HeliError
from heli_host.interrupts import was_interrupted
from heli_host.ui.cli.flight_command import FlightOptions
from heli_host.ui.cli.say import QUIET, write_result

from heli_lab.apps.classroom.grade import FlightScore, score_of_trial, with_plan_setpoints
from heli_lab.apps.classroom.mark import Mark, MIN_MOTION_deg, mark_of
from heli_lab.apps.classroom.submission import Submission, read_submission, returned_files
from heli_lab.control.law.limits import FileLimits
from heli_lab.control.law.trial import LawTrial
from heli_lab.control.law_flight import flown_with

if TYPE_CHECKING:
    from heli_host.fly.plan import Plan

_SIMULATED: Final = {"arm_rate_max_deg_s": 100.0}
"""Parameters of every simulated flight. With a torque about travel, the arm moves slowly on its table. If
an encoder count happens to fall into the moment of arming, it looks like a rate of 3.05 deg/s, and the
board refuses to arm. This limit protects hands near the rig, and in simulation there are none."""
LOG, FIGURE, MARK = "flight.mcap", "figure.png", "mark.json"


@dataclass(frozen=True)
class MarkedSubmission:
    """A submission after its flights in simulation."""

    folder: Path  # Folder of the submission, into which log, figure and mark are written
    mark: Mark  # Mark of the submission, or the reason why it has none
    submission: Submission | None  # Content of the submission; None if it is invalid

    @property
    def may_fly(self) -> bool:
        """Whether the submission may fly on the rig, because it completed its flights in simulation."""
        return self.submission is not None and not self.mark.reason


class Marking:
    """Marks submissions by flights along one plan, compared with the board's own law."""

    def __init__(self, options: FlightOptions, plan: Plan, seeds: Sequence[int], limits: FileLimits) -> None:
        self.options, self.plan, self.seeds, self.limits = options, plan, seeds, limits
        self._references: dict[tuple[str, int], FlightScore] = {}

    def fly_references(self) -> None:
        """Fly the board's own law along the plan of the class."""
        for seed in self.seeds:
            self._reference_score(self.plan, seed)

    def mark_submission(self, folder: Path) -> MarkedSubmission:
        """Read, fly and mark a submission, and write log, figure and mark into its folder."""
        mark, submission = Mark(folder.name), None
        try:
            if folder.is_symlink():
                raise HeliError("the folder is a symbolic link", "submit the folder itself")
            with returned_files(folder) as files:
                try:
                    submission = read_submission(folder, self.limits, self.options.rig)
                    mark = self._mark_submission(submission, files)
                except HeliError as error:
                    mark = replace(mark, reason=str(error))
                write_result(files / MARK, mark.as_dict())
        except HeliError as error:
            # Files that cannot be read or returned: a submission without its result has no points.
            mark = replace(mark, points=0.0, reason=mark.reason or str(error))
        return MarkedSubmission(folder, mark, submission)

    def _mark_submission(self, submission: Submission, output_folder: Path) -> Mark:
        """Fly a submission once per seed, and write log and figure of the first flight."""
        plan = submission.plan or self.plan
        _check_that_it_moves(submission)
        scores = []
        for seed in self.seeds:
            folder = output_folder if seed == self.seeds[0] else None
            scores.append(self._fly_submission(submission, plan, seed, folder))
        references = [self._reference_score(plan, seed) for seed in self.seeds]
        return mark_of(submission.name, scores, references)

    def _reference_score(self, plan: Plan, seed: int) -> FlightScore:
        """Return the score of the board's own law along the same plan; each plan and seed is flown once."""
        key = plan.text, seed
        if key not in self._references:
            self._references[key] = self._fly_submission(Submission("reference"), plan, seed, None)
        return self._references[key]

    def _fly_submission(
        self, submission: Submission, plan: Plan, seed: int, output_folder: Path | None
    ) -> FlightScore:
        """Fly a submission in simulation, and write log and figure if `output_folder` is given."""
        with tempfile.TemporaryDirectory() as temporary_folder:
            options = replace(
                self.options,
                seed=seed,
                log=(output_folder or Path(temporary_folder)) / LOG,
                figure=output_folder / FIGURE if output_folder is not None else None,
            )
            return scored_flight(submission, options, plan, {**_SIMULATED, **submission.gains})


def _check_that_it_moves(submission: Submission) -> None:
    """Refuse a submitted plan that only holds."""
    plan = submission.plan
    if plan is None or any(segment.kind == "excite" for segment in plan.segments):
        return
    if plan.setpoint_range_deg < MIN_MOTION_deg:
        raise HeliError(
            f"the plan only holds: its setpoints move by {plan.setpoint_range_deg:.1f} deg",
            f"move one by at least {MIN_MOTION_deg:g} deg",
        )


def scored_flight(
    submission: Submission, options: FlightOptions, plan: Plan, parameters: Mapping[str, float]
) -> FlightScore:
    """Fly a submission without output on the terminal, and score the flight."""
    program = with_plan_setpoints(submission.program) if submission.program is not None else None
    output_setting = QUIET.set(True)
    try:
        with tempfile.TemporaryDirectory() as temporary_folder:
            if parameters:
                file = Path(temporary_folder) / "parameters.toml"
                file.write_text(parameters_text(parameters, "Parameters of a submission"), encoding="utf-8")
                options = replace(options, params=file)
            flight_result, taken_over = flown_with(program, options, plan)
    finally:
        QUIET.reset(output_setting)
    if was_interrupted(flight_result.summary.outcome):
        raise KeyboardInterrupt
    outcome = ""
    try:
        flight_result.end()
    except FlightAborted as error:
        outcome = error.cause
    try:
        return score_of_trial(LawTrial.of_log(flight_result.log, taken_over or outcome))
    except FlightDataError as error:
        return FlightScore(ended=outcome or error.cause)
