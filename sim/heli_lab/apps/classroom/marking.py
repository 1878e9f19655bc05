"""Fly submissions on equal simulated boards, then on the rig after a confirmation, and mark them.

The mark compares a flight with those of reference controllers on the same rig and seed. Log, figure and mark
go into the folder of the submission.
"""

from __future__ import annotations

import math
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from heli_host.board.interrupts import was_interrupted
from heli_host.board.parameters import parameters_text
from heli_host.declaration import State
from heli_host.errors import FlightAborted, FlightDataError, HeliError, LinkError, fault_text, printable
from heli_host.ui.cli.board import open_board
from heli_host.ui.cli.flight import FlightOptions
from heli_host.ui.cli.say import QUIET, say, write_result

from heli_lab.apps.classroom.grade import FlightScore, score_of_trial, with_plan_setpoints
from heli_lab.apps.classroom.submission import Submission, new_rig_log, read_submission, returned_files
from heli_lab.control.fence import FileLimits
from heli_lab.control.law_flight import LawTrial, flown_with

if TYPE_CHECKING:
    from heli_host.fly.plan import Plan


FULL: Final = 10.0
"""Points of a submission that is as good as the board's own law."""
WEIGHTS: Final = {"rms_deg": 4.0, "settling_s": 2.0, "overshoot_percent": 2.0, "effort_V": 2.0}
"""Largest points of each measure of a `FlightScore`; they add up to `FULL`."""
FLOORS: Final = {"rms_deg": 0.2, "settling_s": 1.0, "overshoot_percent": 5.0, "effort_V": 0.02}
"""Values of the measures below which a better flight earns no more points: two encoder counts, or the
difference between flights with other seeds. With lower values, noise decides the mark; with higher ones,
a better law gets no better mark."""
POINTS: Final = {
    "rms_deg": "rms_points",
    "settling_s": "settling_points",
    "overshoot_percent": "overshoot_points",
    "effort_V": "effort_points",
}
"""Names of the points for each measure, in tables and in JSON."""
MIN_MOTION_deg: Final = 2.0
"""Smallest range of the setpoints of a submitted plan [deg].

The reference flies the same plan. A plan that only holds would therefore earn all points. Lower: such plans
pass. Higher: plans with small steps are refused."""
_GOOD_WITHOUT_MOTION: Final = ("overshoot_percent", "effort_V")
"""Measures that are best if the motors do nothing."""
NO_POINTS: Final = 10.0
"""Multiple of the reference's value that earns no points; in between, points fall with the logarithm. An LQR
without integrals has 3 times the RMS error of the board's own law, and a slow PD law 7 times. With a lower
multiple, both get nothing; with a higher one, they get nearly the same."""


@dataclass(frozen=True)
class Mark:
    """Mark of one submission."""

    name: str  # Name of the submission
    points: float = 0.0  # Points, from 0 to `FULL`
    reason: str = ""
    """Why the submission was refused, or did not complete its flights; empty if it completed them."""
    scores: tuple[FlightScore, ...] = ()  # One per flight; empty if the submission was refused
    parts: dict[str, float] = field(default_factory=dict)
    """Points for each measure that the reference has, by the names in `POINTS`, mean over the flights; they
    add up to `points`."""
    references: tuple[FlightScore, ...] = ()
    """Flights of the board's own law, with which `scores` are compared."""
    rig: str = ""  # Outcome of the flight on the rig; empty if there was no such flight

    @property
    def refused(self) -> bool:
        """Whether the submission did not fly at all."""
        return not self.scores

    def mean(self, measure: str) -> float:
        """Return the mean of a measure over the flights; nan if a flight lacks it."""
        values = [getattr(score, measure) for score in self.scores]
        return sum(values) / len(values) if values else math.nan

    def as_dict(self) -> dict[str, Any]:
        """Return the mark for JSON."""
        return {
            "submission": self.name,
            "points": self.points,
            "of": FULL,
            "reason": self.reason,
            "parts": self.parts,
            "flights": [score.as_dict() for score in self.scores],
            "reference": [score.as_dict() for score in self.references],
            "rig": self.rig,
        }

    def __str__(self) -> str:
        reason = f"; {self.reason}" if self.reason else ""
        return f"{self.name}: {self.points:.1f} of {FULL:.0f} points{reason}"


def points_by_measure(score: FlightScore, reference: FlightScore) -> dict[str, float]:
    """Compute the points for each measure: full points if it is as good as that of the reference."""
    # If the reference lacks a measure, such as the overshoot of a plan without a step, the other measures
    # count more. Effort and overshoot earn at most the share of points that the RMS error earns, because
    # motors that do nothing have little effort and no overshoot.
    shares = {name: _points_share(name, score, reference) for name in WEIGHTS}
    tracking_share = 1.0 if math.isnan(shares["rms_deg"]) else shares["rms_deg"]
    counted_shares = {name: share for name, share in shares.items() if not math.isnan(share)}
    if score.ended:
        return dict.fromkeys(counted_shares, 0.0)
    total_weight = sum(WEIGHTS[name] for name in counted_shares)
    points = {}
    for name, share in counted_shares.items():
        earned_share = min(share, tracking_share) if name in _GOOD_WITHOUT_MOTION else share
        points[name] = FULL * WEIGHTS[name] / total_weight * earned_share
    return points


def points_of(score: FlightScore, reference: FlightScore) -> float:
    """Return the points of a flight: the sum of `points_by_measure`."""
    return sum(points_by_measure(score, reference).values())


def _points_share(name: str, score: FlightScore, reference: FlightScore) -> float:
    """Compute the share of the points for the measure `name`, 0 to 1; nan if the reference lacks the
    measure.
    """
    value, reference_value = getattr(score, name), getattr(reference, name)
    if math.isnan(reference_value):
        return math.nan
    if math.isnan(value):
        return 0.0
    if math.isinf(value) and not math.isinf(reference_value):
        return 0.0
    ratio = 1.0 if value <= reference_value else max(1.0, value / max(reference_value, FLOORS[name]))
    return max(0.0, 1.0 - math.log(ratio) / math.log(NO_POINTS))


def mark_of(name: str, scores: Sequence[FlightScore], references: Sequence[FlightScore]) -> Mark:
    """Compute the mark of a submission: the mean of the points of its flights."""
    flights = list(zip(scores, references, strict=True))
    by_flight = [points_by_measure(score, reference) for score, reference in flights]
    mean_by_measure = {
        POINTS[measure]: round(sum(points.get(measure, 0.0) for points in by_flight) / len(by_flight), 2)
        for measure in by_flight[0]
    }
    flight_points = [points_of(score, reference) for score, reference in flights]
    return Mark(
        name=name,
        points=round(sum(flight_points) / len(flight_points), 1),
        reason=", ".join(sorted({score.ended for score in scores if score.ended})),
        scores=tuple(scores),
        parts=mean_by_measure,
        references=tuple(references),
    )


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
            self._references[key] = self._fly_submission(
                Submission("reference"), plan, seed, output_folder=None
            )
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
            flight_result, takeover = flown_with(program, options, plan)
    finally:
        QUIET.reset(output_setting)
    if was_interrupted(flight_result.summary.outcome):
        raise KeyboardInterrupt
    ended = ""
    try:
        flight_result.raise_if_not_completed()
    except FlightAborted as error:
        ended = error.cause
    if takeover:
        ended = f"the board's own law took over: {takeover}"
    try:
        return score_of_trial(LawTrial.of_log(flight_result.log, ended))
    except FlightDataError as error:
        return FlightScore(ended=ended or error.cause)


Confirm = Callable[[str], bool | None]
"""Asks the person at the rig a question, and returns the answer; None ends the session."""
NOT_FLOWN = "not flown"
"""Outcome of a submission whose flight was not confirmed."""


def fly_on_rig(
    submissions: Sequence[MarkedSubmission], options: FlightOptions, plan: Plan, confirm: Confirm
) -> Iterator[tuple[MarkedSubmission, str]]:
    """Fly each submission on the rig, and yield the submission with the outcome."""
    # Each flight begins with the rig's parameters and the gains of the submission. Afterwards, the rig has
    # its own parameters again.
    with _parameters_restored(options.port) as rig_parameters:
        for marked in submissions:
            submission = marked.submission
            assert submission is not None
            try:
                is_confirmed, has_fault = _confirm_flight(options.port, submission.name, confirm)
                if is_confirmed is None:
                    return  # The person at the rig has ended the session.
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
