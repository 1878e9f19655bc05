"""``heli-host class``: fly and mark a folder of submissions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from heli_host.cli import simulated
from heli_host.cli.flight_command import FlightOptions
from heli_host.cli.options import JsonOption
from heli_host.cli.say import QUIET, data_on_stdout, say, say_files, write_result
from heli_host.cli.simulated import DEFAULT_RIG, MAX_SPEED
from heli_host.cli.verb import Verb

if TYPE_CHECKING:
    from heli_host.fly.plan import Plan

    from heli_lab.classroom.grade import FlightScore
    from heli_lab.classroom.mark import Mark
    from heli_lab.classroom.submission import Submission
    from heli_lab.law.limits import FileLimits

_LOAD_s = 10.0
"""Processor time of a law's file [s]. The laws of the documents take under 2 s. With less, a law that solves
a problem first is refused; with more, each endless loop delays the class."""
MARKS = "marks.csv"


def class_(
    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="Mark each folder in this folder.")],
    plan: Annotated[
        str | None,
        typer.Option(
            "--plan",
            metavar="NAME|FILE",
            help="Fly this plan, unless a submission has one.  [default: a travel step, then sines]",
            show_default=False,
        ),
    ] = None,
    duration_s: Annotated[
        float,
        typer.Option("--duration", metavar="S", min=5.0, max=600.0, help="Fly for this time in s."),
    ] = 20.0,
    rig: Annotated[
        str | None,
        typer.Option(
            "--rig",
            metavar="NAME|FILE",
            help=f"Simulate this rig, and compare the real board with it.  [default: {DEFAULT_RIG}]",
            show_default=False,
        ),
    ] = None,
    effect: simulated.EffectOption = None,
    seeds: Annotated[
        int, typer.Option("--seeds", metavar="N", min=1, max=100, help="Fly N times, with the seeds 1 to N.")
    ] = 1,
    port: Annotated[
        str | None,
        typer.Option(
            "--port",
            "-p",
            metavar="URL",
            help="Then fly on the rig at this port, after a confirmation for each submission.",
            show_default=False,
        ),
    ] = None,
    json: JsonOption = None,
    load_timeout: Annotated[
        float,
        typer.Option(
            "--load-timeout", metavar="S", min=0.1, help="Stop a law's file after this processor time in s."
        ),
    ] = _LOAD_s,
) -> None:
    """Fly and mark a folder of submissions, in simulation and then on the rig.

    A submission is a folder with law.py, a plan (TOML), a parameter file, or several of these. Log, figure
    and mark go into its folder `marked`, which is replaced; all marks go into FOLDER/marks.csv. A law's file
    may use processor time and 1 GB of memory, and may not write files, open sockets or start processes. Only
    submissions that flew to the end of the simulation may fly on the rig.

    Example: `heli-host class submissions --seeds 3`
    """
    from heli_host.cli.outputs import check_result_places
    from heli_host.fly.plan import load_plan

    from heli_lab.classroom.submission import MARKED, submissions_in
    from heli_lab.law.limits import FileLimits
    from heli_lab.law.trial import trial_plan

    check_result_places(folder / MARKS if folder.is_dir() else None, json)
    data_on_stdout(json)
    folders = submissions_in(folder)
    class_plan = load_plan(plan) if plan is not None else trial_plan(duration_s)
    options = FlightOptions(sil=True, rig=rig, effect=effect, speed=MAX_SPEED)
    options.address()  # refuse invalid options before the first flight
    simulation = _Simulation(options, class_plan, range(1, seeds + 1))
    marks: list[Mark] = []
    flown: list[tuple[Path, Submission]] = []
    for one in folders:
        mark, submission = _answer(one, simulation, FileLimits(load_timeout))
        marks.append(mark)
        say(str(mark))
        if submission is not None and not mark.reason:
            flown.append((one, submission))
    _write_marks(marks, folder / MARKS)
    if port is not None:
        by_name = {mark.name: mark for mark in marks}
        for name, outcome in _fly_on_rig(flown, replace(options, port=port), class_plan).items():
            by_name[name] = replace(by_name[name], rig=outcome)
            write_result(folder / name / MARKED / "mark.json", by_name[name].as_dict())
        marks = list(by_name.values())
        _write_marks(marks, folder / MARKS)
    write_result(json, {"plan": class_plan.title, "marks": [mark.as_dict() for mark in marks]})
    refused, ended = sum(mark.refused for mark in marks), sum(bool(mark.reason) for mark in marks)
    say(f"{len(marks)} submissions: {len(marks) - ended} flew to the end, {refused} refused")
    say_files((folder / MARKS, json))


class _Simulation:
    """Flights of submissions on equal simulated boards, and of the board's own law for comparison.

    Parameters
    ----------
    options : FlightOptions
        Simulated board.
    plan : Plan
        Plan of the class.
    seeds : sequence of int
        Seed of each flight.
    """

    def __init__(self, options: FlightOptions, plan: Plan, seeds: Sequence[int]) -> None:
        self.options, self.plan, self.seeds = options, plan, seeds
        self._references: dict[tuple[str, int], FlightScore] = {}

    def mark(self, submission: Submission, folder: Path) -> Mark:
        """Fly a submission, write the first log and its figure into a `folder`, and mark it."""
        from heli_lab.classroom.mark import mark_of

        plan = submission.plan or self.plan
        scores = [
            self._score(submission, plan, seed, folder if seed == self.seeds[0] else None)
            for seed in self.seeds
        ]
        return mark_of(submission.name, scores, [self._reference(plan, seed) for seed in self.seeds])

    def _reference(self, plan: Plan, seed: int) -> FlightScore:
        from heli_lab.classroom.submission import Submission

        key = plan.text, seed
        if key not in self._references:
            self._references[key] = self._score(Submission("reference"), plan, seed, None)
        return self._references[key]

    def _score(self, submission: Submission, plan: Plan, seed: int, folder: Path | None) -> FlightScore:
        import tempfile

        with tempfile.TemporaryDirectory() as made:
            place = folder or Path(made)
            options = replace(
                self.options,
                seed=seed,
                log=place / "flight.mcap",
                figure=place / "figure.png" if folder is not None else None,
            )
            return _flight(submission, options, plan, submission.gains)


def _flight(
    submission: Submission, options: FlightOptions, plan: Plan, parameters: Mapping[str, float]
) -> FlightScore:
    """Fly a submission with these parameters, without a word, and score the flight."""
    import tempfile

    from heli_host.errors import FlightAborted, FlightDataError
    from heli_host.parameter_file import parameters_text

    from heli_lab.classroom.grade import FlightScore, score_of
    from heli_lab.law.trial import LawTrial
    from heli_lab.law_flight import flown_with

    before = QUIET.set(True)
    try:
        with tempfile.TemporaryDirectory() as made:
            if parameters:
                file = Path(made) / "parameters.toml"
                file.write_text(parameters_text(parameters, "Of a submission."), encoding="utf-8")
                options = replace(options, params=file)
            flown, taken_over = flown_with(submission.program, options, plan)
    finally:
        QUIET.reset(before)
    outcome = ""
    try:
        flown.end()
    except FlightAborted as error:
        outcome = error.cause
    try:
        return score_of(LawTrial.of_log(flown.log, outcome or taken_over))
    except FlightDataError as error:
        return FlightScore(ended=outcome or error.cause)


def _answer(folder: Path, simulation: _Simulation, limits: FileLimits) -> tuple[Mark, Submission | None]:
    """Mark a submission, and return its files; whatever is wrong with it is the reason of its mark."""
    from heli_host.errors import HeliError

    from heli_lab.classroom.mark import Mark
    from heli_lab.classroom.submission import read_submission, returned_files

    if folder.is_symlink():
        return Mark(folder.name, reason="the folder is a link; submit the folder itself"), None
    mark = Mark(folder.name)
    submission = None
    try:
        with returned_files(folder) as files:
            try:
                submission = read_submission(folder, limits)
                mark = simulation.mark(submission, files)
            except HeliError as error:
                mark = Mark(folder.name, reason=str(error))
            write_result(files / "mark.json", mark.as_dict())
    except HeliError as error:
        return replace(mark, reason=mark.reason or str(error)), None
    return mark, submission


def _fly_on_rig(
    submissions: Sequence[tuple[Path, Submission]], options: FlightOptions, plan: Plan
) -> dict[str, str]:
    """Ask before each flight on the rig; the outcomes by name of the submission."""
    from heli_host.cli.board import open_board
    from heli_host.errors import HeliError, LinkError, printable

    from heli_lab.classroom.submission import MARKED

    rig_options = FlightOptions(port=options.port, rig=options.rig)
    with open_board(options.port) as heli:
        before = heli.params.dump()
    outcomes: dict[str, str] = {}
    try:
        for folder, submission in submissions:
            try:
                flies = typer.confirm(f"fly {printable(submission.name)} on the rig?", err=True)
            except typer.Abort:  # the end of standard input
                break
            outcomes[submission.name] = "not flown"
            if not flies:
                continue
            log, figure = folder / MARKED / "rig.mcap", folder / MARKED / "rig.png"
            try:
                score = _flight(
                    submission,
                    replace(rig_options, log=log, figure=figure),
                    submission.plan or plan,
                    {**before, **submission.gains},
                )
            except HeliError as error:
                outcomes[submission.name] = str(error)
                if isinstance(error, LinkError):
                    # The board is in a state that a person has to look at.
                    break
            else:
                outcomes[submission.name] = score.ended or "completed"
            finally:
                say(f"{submission.name}: rig: {outcomes[submission.name]}")
    finally:
        # The next user gets the rig with the parameters that it had.
        try:
            with open_board(options.port) as heli:
                heli.params.restore(before)
        except HeliError as error:
            say(f"warning: the parameters of the rig are those of a submission: {error}")
    return outcomes


def _write_marks(marks: Sequence[Mark], path: Path) -> None:
    """Write a table of all marks, in place of a former one."""
    import csv
    import tempfile

    from heli_lab.classroom.mark import FULL

    with tempfile.NamedTemporaryFile(
        "w", dir=path.parent, prefix=".marks-", delete=False, newline="", encoding="utf-8"
    ) as file:
        table = csv.writer(file)
        table.writerow(["submission", "points", "of", "reason", "rig"])
        table.writerows([mark.name, mark.points, FULL, mark.reason, mark.rig] for mark in marks)
    Path(file.name).chmod(0o644)
    Path(file.name).replace(path)


VERB = Verb(class_, "Laboratory")
