"""``heli-host class`` and ``course``: fly and mark submissions, and write editions of notebooks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from heli_host.ui.cli.flight import FlightOptions
from heli_host.ui.cli.options import DEFAULT_RIG, MAX_SPEED, EffectOption, JsonOption
from heli_host.ui.cli.say import data_on_stdout, say, say_files, write_result
from heli_host.ui.cli.verb import Verb

from heli_lab.fit_inputs import SeedsOption

if TYPE_CHECKING:
    from heli_host.fly.plan import Plan

    from heli_lab.apps.classroom.marking import Mark, MarkedSubmission


_LOAD_s = 10.0
"""Longest processor time for loading a law's file [s]. The laws of the documents take under 2 s. Shorter: a
law that first solves an optimisation problem is refused. Longer: each endless loop delays the class."""
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
        typer.Option(
            "--duration",
            metavar="S",
            min=5.0,
            max=600.0,
            help="Fly for this time in s if --plan is not given.",
        ),
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
    effect: EffectOption = None,
    seeds: SeedsOption = 1,
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
    and mark go into its folder `marked`. A new run replaces this folder, but keeps flights on the rig. All
    marks, with the points for each measure, go into FOLDER/marks.csv. A law's file has limits of processor
    time and memory (1 GB), and may not write files, open sockets or start processes. Only submissions that
    flew to the end of the simulation may fly on the rig.

    Example: `heli-host class submissions --seeds 3`
    """
    from heli_host.fly.plan import load_plan
    from heli_host.ui.cli.board import open_board
    from heli_host.ui.cli.options import check_result_places
    from heli_sim.rig import load_rig

    from heli_lab.apps.classroom.marking import Marking
    from heli_lab.apps.classroom.submission import submissions_in
    from heli_lab.control.fence import FileLimits
    from heli_lab.control.law_flight import trial_plan

    folders = submissions_in(folder)
    check_result_places(folder / MARKS, json)
    data_on_stdout(json)
    class_plan = load_plan(plan) if plan is not None else trial_plan(duration_s)
    options = FlightOptions(sil=True, rig=rig, effect=effect, speed=MAX_SPEED)
    # Invalid options and a rig that does not answer are errors before the first submission flies.
    load_rig(rig or DEFAULT_RIG)
    if port is not None:
        with open_board(port):
            pass
    marking = Marking(options, class_plan, range(1, seeds + 1), FileLimits(load_timeout))
    marking.fly_references()
    all_marked: list[MarkedSubmission] = []
    try:
        for submission_folder in folders:
            all_marked.append(marking.mark_submission(submission_folder))
            say(str(all_marked[-1].mark))
    finally:
        # If the teacher interrupts the command, the marks so far are written.
        _write_marks([marked.mark for marked in all_marked], folder / MARKS)
    marks = [marked.mark for marked in all_marked]
    if port is not None:
        marks = _fly_on_rig(all_marked, FlightOptions(port=port, rig=rig), class_plan, folder / MARKS)
    write_result(json, {"plan": class_plan.title, "marks": [mark.as_dict() for mark in marks]})
    refused_count = sum(mark.refused for mark in marks)
    incomplete_count = sum(bool(mark.reason) for mark in marks)
    say(
        f"{len(marks)} submissions: {len(marks) - incomplete_count} flew to the end, "
        f"{incomplete_count - refused_count} ended early, {refused_count} refused"
    )
    say_files((folder / MARKS, json))


def _fly_on_rig(
    all_marked: Sequence[MarkedSubmission], options: FlightOptions, plan: Plan, table: Path
) -> list[Mark]:
    """Fly submissions on the rig, and return the marks of all submissions with the outcome on the rig.

    Only submissions that flew to the end of the simulation fly. After each flight, its mark and the `table`
    of all marks are written, so that no later error loses them.
    """
    from heli_lab.apps.classroom.marking import MARK, fly_on_rig
    from heli_lab.apps.classroom.submission import MARKED

    marks = {marked.folder: marked.mark for marked in all_marked}
    flyable = [marked for marked in all_marked if marked.may_fly]
    for marked, outcome in fly_on_rig(flyable, options, plan, _ask_yes_or_no):
        say(f"{marked.mark.name}: rig: {outcome}")
        marks[marked.folder] = replace(marked.mark, rig=outcome)
        write_result(marked.folder / MARKED / MARK, marks[marked.folder].as_dict())
        _write_marks(list(marks.values()), table)
    return list(marks.values())


def _ask_yes_or_no(question: str) -> bool | None:
    """Ask a yes-or-no question; None at the end of standard input."""
    try:
        return typer.confirm(question, err=True)
    except typer.Abort:  # the end of standard input
        return None


def _write_marks(marks: Sequence[Mark], path: Path) -> None:
    """Write a CSV table of all marks to `path`: the points of each measure, then its mean value."""
    import csv
    import io

    from heli_host.data.files import write_text

    from heli_lab.apps.classroom.marking import FULL, POINTS

    text = io.StringIO()
    table = csv.writer(text, lineterminator="\n")
    table.writerow(["submission", "points", "of", *POINTS.values(), *POINTS, "reason", "rig"])
    table.writerows(
        [
            _without_formula(mark.name),
            mark.points,
            FULL,
            *(mark.parts.get(name, "") for name in POINTS.values()),
            *(_number_text(mark.mean(measure)) for measure in POINTS),
            _without_formula(mark.reason),
            _without_formula(mark.rig),
        ]
        for mark in marks
    )
    write_text(path, text.getvalue())


def _number_text(value: float) -> str:
    """Return a value for a table: empty if there is none, ``never`` for a motion that did not settle."""
    import math

    return "" if math.isnan(value) else "never" if math.isinf(value) else f"{value:.3g}"


def _without_formula(text: str) -> str:
    """Return the text of a cell, quoted if a spreadsheet would read it as a formula."""
    from heli_host.errors import printable

    return printable(f"'{text}" if text[:1] in ("=", "+", "-", "@") else text)


def course(
    notebooks: Annotated[
        list[Path],
        typer.Argument(metavar="NOTEBOOK.py...", help="Read these notebooks, or all in these folders."),
    ],
    output: Annotated[
        Path,
        typer.Option("--output", "-o", metavar="DIR", help="Write student/ and teacher/ into this folder."),
    ],
) -> None:
    """Make student and teacher editions of notebooks, for Jupyter and nbgrader.

    A notebook is a Python file with cells, such as those in docs/course. The student edition has no
    solutions. The teacher edition has solutions, and is a source notebook of nbgrader. The rubric is a file
    next to it. Former editions in the folder are replaced.

    Example: `heli-host course docs/course --output editions`
    """
    from heli_lab.apps.classroom.notebook import NotebookError, write_editions

    sources: list[Path] = []
    for path in notebooks:
        sources += sorted(path.glob("*.py")) if path.is_dir() else [path]
    if not sources:
        raise NotebookError(f"{notebooks[0]} contains no notebook", "give Python files with cells")
    files = write_editions(sources, output)
    say(f"{len(sources)} notebooks, each for students and teachers")
    say_files(files)


VERBS = {"class": Verb(class_, "Laboratory"), "course": Verb(course, "Laboratory")}
