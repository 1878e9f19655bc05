"""``heli-host benchmark``: make a split, run methods on it, score and report them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from heli_host.data.files import write_signed
from heli_host.ui.cli.options import JsonOption, SchedulerOption
from heli_host.ui.cli.say import data_on_stdout, say, say_files, say_progress, write_result
from heli_host.ui.cli.verb import Verb

app = typer.Typer(
    help="Compare methods that find hidden causes.\n\n"
    "See `heli-host benchmark COMMAND --help` for options and examples.",
    no_args_is_help=True,
    rich_markup_mode="markdown",
)

SplitArgument = Annotated[Path, typer.Argument(metavar="DIR", help="Use the split in this folder.")]
RunsArgument = Annotated[
    list[Path], typer.Argument(metavar="RUN...", help="Score these folders of benchmark run.")
]
WorkersOption = Annotated[
    int, typer.Option("--workers", metavar="N", min=1, help="Work on this many cases in parallel.")
]
TruthOption = Annotated[
    Path | None,
    typer.Option("--truth", metavar="DIR", help="Use this folder for the truths of a sealed split."),
]


@app.command("make")
def make(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Write the split into this folder.")],
    split: Annotated[
        str, typer.Option("--split", metavar="NAME", help="Give the split this name.")
    ] = "public",
    seed: Annotated[
        int | None,
        typer.Option("--seed", metavar="N", min=0, help="Choose the cases at random with this seed."),
    ] = None,
    secret: Annotated[
        Path | None,
        typer.Option("--secret", metavar="FILE", help="Seal the split: draw the cases with this secret."),
    ] = None,
    truth: TruthOption = None,
    count: Annotated[int, typer.Option("--count", metavar="N", min=1, help="Make this many cases.")] = 24,
    workers: WorkersOption = 1,
) -> None:
    """Fly cases with hidden causes, and write them as folders for methods.

    Each case takes about 10 s of CPU time. After an interruption, the same command continues.

    A split with --seed is open: its folder `truth` has the hidden causes. A split with --secret is sealed:
    the hidden causes are in the folder of --truth, and the split has only their SHA-256 digests. To make a
    secret, use `openssl rand -hex 32`.

    Example: `heli-host benchmark make public --seed 34 --count 24`
    """
    from heli_benchmark.errors import BenchmarkError
    from heli_benchmark.splits import make_split, read_seal

    if seed is not None and secret is not None:
        raise BenchmarkError("--seed and --secret exclude each other", "give one of them")
    if secret is not None and truth is None:
        raise BenchmarkError(
            "a sealed split stores its true answers in another folder", "name the folder with --truth"
        )
    draw = read_seal(secret) if secret is not None else seed or 0
    make_split(
        folder,
        split,
        draw,
        count,
        truth_folder=truth,
        workers=workers,
        say=lambda name, done: say_progress(f"{name}: {done} of {count} cases"),
    )
    say_files([folder])


@app.command("run")
def run(
    folder: SplitArgument,
    method: Annotated[
        str,
        typer.Option(
            "--method", metavar="NAME|FILE:FUNC", help="Run this method: a name, or FILE.py:FUNCTION."
        ),
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="RUN", help="Write the answers into this folder.")
    ],
    resources: Annotated[
        Path | None,
        typer.Option(
            "--resources", metavar="DIR", help="Give the method this folder, such as training cases."
        ),
    ] = None,
    cpu_limit: Annotated[
        int, typer.Option("--cpu-limit", metavar="S", min=1, help="Limit the CPU time of a case.")
    ] = 300,
    memory_limit: Annotated[
        int, typer.Option("--memory-limit", metavar="MB", min=200, help="Limit the memory of a case.")
    ] = 6000,
    workers: WorkersOption = 1,
    scheduler: SchedulerOption = None,
) -> None:
    """Run a method on each case of a split, in a process with limits.

    A case without an answer counts as failed, and the run goes on. After an interruption, the same command
    continues with the remaining cases. The method can read every file that you can read, so run only methods
    that you trust.

    With --scheduler, the cases run on the workers of a Dask cluster. The workers must see the folders of
    split, method and resources under the same paths. --workers then has no effect.

    Example: `heli-host benchmark run public --method mymethod.py:diagnose -o runs/mymethod`
    """
    from functools import partial

    from heli_benchmark.entries import RunLimits, run_method, run_on_cluster
    from heli_benchmark.task import read_split

    split = read_split(folder)

    def show(case: str, failure: str) -> None:
        say_progress(f"{case}: {failure or 'answered'}")

    limits = RunLimits(cpu_limit, memory_limit)
    run_method(
        split,
        method,
        output,
        limits=limits,
        resources=resources,
        workers=workers,
        distribute=None if scheduler is None else partial(run_on_cluster, scheduler),
        say=show,
    )
    say_files([output])


@app.command("score")
def score(
    folder: SplitArgument, runs: RunsArgument, truth: TruthOption = None, json: JsonOption = None
) -> None:
    """Score runs on a split against its truth.

    Prints each score with its 95 % interval over cases, and compares each two methods. Nothing is written
    without --json. A sealed split needs --truth. Each truth must agree with its digest in the split.

    Example: `heli-host benchmark score public runs/ours runs/base_rates --json scores.json`
    """
    from heli_host.ui.cli.options import check_result_places

    from heli_benchmark.leaderboard import comparison_table, pair_lines, scores_content
    from heli_benchmark.scores import score_runs
    from heli_benchmark.task import read_split

    check_result_places(json)
    data_on_stdout(json)
    split = read_split(folder, truth)
    names = [run.name for run in runs]
    summary = scores_content(split, dict(zip(names, score_runs(split, runs), strict=True)))
    say(*comparison_table(summary).splitlines(), *pair_lines(summary))
    if write_result(json, summary):
        return
    say_files([json])


@app.command("report")
def report(
    scores: Annotated[
        list[Path],
        typer.Argument(metavar="SCORES.json...", help="Read these files of benchmark score --json."),
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="DIR", help="Write table and figure into this folder.")
    ],
) -> None:
    """Write the table and the figure of a comparison.

    Writes table.md, figure.png and scores.json. Files of several splits are pooled: the result is that of one
    split with all their cases. All files must score the same methods.

    Example: `heli-host benchmark report scores.json -o report`
    """
    from heli_benchmark.leaderboard import draw_comparison, pooled_scores, report_text

    summary = pooled_scores(scores)
    output.mkdir(parents=True, exist_ok=True)
    write_signed(output / "table.md", report_text(summary))
    draw_comparison(summary, output / "figure.png")
    write_result(output / "scores.json", summary)
    say_files([output / name for name in ("table.md", "figure.png", "scores.json")])


VERB = Verb(app, "Laboratory")
