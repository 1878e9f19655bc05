"""``heli-host campaign``: run many flights, fits, diagnoses or gain checks."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from heli_host.ui.cli.options import JsonOption, SchedulerOption
from heli_host.ui.cli.say import data_on_stdout, say, say_dropped, say_files, write_result
from heli_host.ui.cli.verb import Verb

if TYPE_CHECKING:
    from heli_lab.apps.campaign.cases import Campaign
    from heli_lab.apps.campaign.page import Summary
    from heli_lab.apps.campaign.run import CampaignProgress


def campaign(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="CAMPAIGN.toml", help="Read the task and the settings of its cases from this file."
        ),
    ],
    scheduler: SchedulerOption = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="DIR",
            help="Write the results into this folder.  [default: the file's name]",
            show_default=False,
        ),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(
            "--workers",
            metavar="N",
            min=1,
            help="Run this many cases in parallel.  [default: number of cores]",
        ),
    ] = None,
    retry: Annotated[
        bool, typer.Option("--retry", help="Repeat the cases that ended without a result.")
    ] = False,
    json: JsonOption = None,
) -> None:
    """Run many flights, fits, diagnoses or gain checks, here or on a cluster.

    The cases are all combinations of rigs, effects, plans and seeds in the campaign file. Every case writes a
    JSON file and a row of the table. After an interruption, the same command continues with the remaining
    cases.

    The exit code is 1 if a case has no result. Otherwise it is 4 if a flight was not completed.

    Example: `heli-host campaign study.toml -o study`, and on a cluster `--scheduler tcp://head:8786`
    """
    from heli_host.board.parameters import read_parameter_set
    from heli_host.errors import FlightAborted
    from heli_host.ui.cli.live import WorkBar
    from heli_host.ui.cli.options import check_result_places

    from heli_lab.apps.campaign.file import load_campaign
    from heli_lab.apps.campaign.page import summarise, write_summary
    from heli_lab.apps.campaign.run import run_campaign
    from heli_lab.apps.campaign.store import TABLE, Store
    from heli_lab.errors import CampaignError

    if scheduler is not None and workers is not None:
        raise typer.BadParameter("--workers applies to this machine only; remove it, or remove --scheduler")
    study = load_campaign(file)
    folder = output or Path(file.stem)
    check_result_places(json, report=folder)
    data_on_stdout(json)
    for params in _parameter_files(study):
        say_dropped(read_parameter_set(params).dropped, params)
    store = Store(folder)
    ended_cases = 0
    with WorkBar() as bar:

        def show(progress: CampaignProgress) -> None:
            """Print notes and failures of cases, and update the progress bar."""
            nonlocal ended_cases
            ended_cases = progress.ended
            if progress.note:
                say(progress.note)
            if progress.newest is not None and progress.newest.failure:
                say(f"{progress.newest.name}: {progress.newest.failure}")
            failed = f", {progress.failed} without a result" if progress.failed else ""
            bar.show(f"{progress.ended} of {progress.cases} cases{failed}", progress.ended / progress.cases)

        try:
            rows = run_campaign(
                study,
                store,
                scheduler=scheduler,
                processes=workers or _usable_core_count(),
                is_repeated=(lambda result: bool(result.failure)) if retry else None,
                on_progress=show,
            )
        except KeyboardInterrupt:
            raise CampaignError(
                f"stopped: {ended_cases} of {len(study.cases)} cases have ended and are saved",
                "run the same command again to continue with the others",
            ) from None
    summary = summarise(study, rows)
    page = write_summary(study, summary, folder)
    _print_summary(summary, len(study.cases))
    write_result(json, _json_object(summary, len(study.cases)))
    say_files([page, folder / TABLE])
    if summary.failed:
        raise typer.Exit(1)
    if summary.not_completed:
        raise typer.Exit(FlightAborted.exit_code)


def _parameter_files(campaign: Campaign) -> list[Path]:
    """Return the files of board parameters of the cases, as far as they exist on this computer."""
    from heli_lab.apps.campaign.works import WORKS

    cases = [case for case in campaign.cases if case.work in WORKS.values()]
    names = {str(case.settings["params"]) for case in cases if case.settings["params"]}
    return [Path(name) for name in sorted(names) if Path(name).is_file()]


def _usable_core_count() -> int:
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _json_object(summary: Summary, cases: int) -> dict[str, Any]:
    """Return the summary of a campaign with this number of cases as a JSON object."""
    return {
        "cases": cases,
        "ended": summary.cases,
        "failed": len(summary.failed),
        "outcomes": dict(summary.outcomes),
        "columns": {
            column.name: {"median": column.median, "p05": column.low, "p95": column.high}
            for column in summary.columns
            if len(column.values)
        },
    }


def _print_summary(summary: Summary, cases: int) -> None:
    """Print how the cases ended, and median and 5 to 95 % range of each numeric column."""
    say(f"{summary.cases} of {cases} cases have ended, {len(summary.failed)} of them without a result")
    if summary.outcomes:
        outcome_counts = ", ".join(f"{outcome} {count}" for outcome, count in summary.outcomes.items())
        say(
            f"{summary.not_completed} of {sum(summary.outcomes.values())} cases "
            f"did not end as completed: {outcome_counts}"
        )
    for column in summary.columns:
        if len(column.values):
            say(
                f"  {column.name:28s} median {column.median:.4g}, "
                f"5 to 95 % {column.low:.4g} to {column.high:.4g}"
            )
    for name, counts in summary.words.items():
        text = ", ".join(f"{value} {count}" for value, count in list(counts.items())[:6])
        say(f"  {name:28s} {text}")


VERB = Verb(campaign, "Laboratory")
