"""``heli-host diagnose``: what the simulation gets wrong."""

from __future__ import annotations

import gc
import itertools
import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from heli_host.cli.say import data_on_stdout, say, say_files, write_numbers
from heli_host.cli.simulated import DEFAULT_RIG
from heli_host.cli.verb import Verb

from heli_lab import fit_options as option

if TYPE_CHECKING:
    from heli_lab.diagnose import Diagnosis, InsufficientExcitation


def diagnose(
    flights: option.FlightsArgument,
    validate: option.ValidateOption = None,
    rig: option.KnownRigOption = DEFAULT_RIG,
    model: option.EquationsOption = None,
    effects: option.OwnEffectsOption = None,
    start_s: option.FromOption = None,
    stop_s: option.ToOption = None,
    allow_gaps: option.GapsOption = False,
    as_is: option.AsIsOption = False,
    report: option.ReportOption = None,
    json: option.NumbersOption = None,
    out: option.FoundRigOption = None,
    with_term: Annotated[
        bool,
        typer.Option(
            "--with-law",
            help="Put a law that is proposed into the rig of --out too; it flies with its effect file.",
        ),
    ] = False,
    calibrate_s: Annotated[
        float | None,
        typer.Option(
            "--calibrate",
            metavar="SECONDS",
            min=0.0,
            help="Free flight of each validation flight to find its zeros and torques from; the rest is "
            "judged.  [default: 8, or a third of a short flight]",
            show_default=False,
        ),
    ] = None,
    seed: Annotated[
        int, typer.Option("--seed", metavar="N", min=0, help="Seed of the bootstrap behind the intervals.")
    ] = 0,
    budget: Annotated[
        int,
        typer.Option(
            "--budget",
            metavar="N",
            min=1,
            help="Most refits of the model; the result says whether everything was tried.",
        ),
    ] = 80,
    resume: Annotated[
        Path | None,
        typer.Option(
            "--resume",
            metavar="FILE",
            help="Keep what is worked out in this file, and go on from what it has.",
        ),
    ] = None,
) -> None:
    """Show what a model gets wrong in flights, name the cause, extend the model, measure the gain.

    The baseline is refitted first. Every effect of the catalogue is scored; one is named if its
    log-likelihood ratio exceeds its penalty; the flights given with --validate have no part in that, they
    judge it. What chance alone makes is weather; what can be foretold and no effect explains is
    `unexplained`: its law is looked for, and proposed as an effect file in the folder of --report.

    Example: `heli-host diagnose a.mcap --validate b.mcap --rig makki2024 --report why --out extended.toml`
    """
    # Matrices here are small: more threads only wait for each other.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from heli_host.cli.outputs import check_result_places
    from heli_host.cli.progress_bar import WorkBar
    from heli_sim.model.effects import catalogue
    from heli_sim.rig import write_rig

    from heli_lab.diagnose import InsufficientExcitation, insufficient_excitation, summary, to_json
    from heli_lab.diagnose import diagnose as find
    from heli_lab.diagnose.report import write_effect_file, write_insufficient_excitation, write_report
    from heli_lab.errors import NotExcited
    from heli_lab.fit_inputs import fit_inputs, part_of, parts, read_flights, refuse_wrong_signs
    from heli_lab.page.drawing import Drawing
    from heli_lab.threads import default_thread_count, limit_malloc_arenas

    # What libraries keep is no garbage: to look through it again and again took 8 % of a diagnosis.
    gc.freeze()
    limit_malloc_arenas()
    others = validate or []
    data_on_stdout(json)
    check_result_places(out, json, resume, report=report)
    given = fit_inputs(flights, others, rig, model, effects or ())
    kinds = catalogue(effects or ())
    result: Diagnosis | InsufficientExcitation
    written: list[Path | None] = []
    beside = report is not None and default_thread_count() > 1
    with WorkBar() as bar, Drawing(beside) as drawing:
        bar.show("reading", 0.0)
        spans = parts(start_s or (), stop_s or (), len(flights), len(others))
        read = read_flights([*flights, *others], allow_gaps)
        if not as_is:
            bar.show("looking at signs and zeros", 0.0)
            refuse_wrong_signs(read, given.labels, given.rig)
        # Handed over one by one, and not kept: ten minutes at 1 kHz are 45 MB.
        read.reverse()
        used = (
            part_of(read.pop(), given.rig, label, span)
            for label, span in zip(given.labels, spans, strict=True)
        )
        try:
            result = find(
                given.model,
                given.rig,
                itertools.islice(used, len(flights)),
                used,
                kinds=kinds,
                labels=given.labels,
                seed=seed,
                calibrate_s=calibrate_s,
                refits=budget,
                resume=resume,
                say=bar.show,
            )
        except NotExcited as nothing:
            result = insufficient_excitation(str(nothing), given.model, given.rig, kinds)
        if out is not None and not isinstance(result, InsufficientExcitation):
            write_rig(
                result.rig(out.stem, with_term),
                out,
                f"Found by heli-host diagnose, model {given.model.name}. {summary(result)}",
            )
            written.append(out)
        if report is not None:
            bar.show("drawing", 0.95)
            if isinstance(result, InsufficientExcitation):
                written.append(write_insufficient_excitation(result, report))
            else:
                written.append(write_report(result, report, drawing))
        if not isinstance(result, InsufficientExcitation) and result.proposed_term is not None:
            place = report or (out.parent if out is not None and with_term else None)
            if place is not None:
                written.append(write_effect_file(result, place))
        write_numbers(json, to_json(result))
        written.append(json)
    _print(result)
    say_files(written)


def _print(result: Diagnosis | InsufficientExcitation) -> None:
    """Print the verdict, the causes and the gain."""
    from heli_lab.diagnose.report import lines, summary

    say(f"{result.label}: {summary(result)}", *(f"  {line}" for line in lines(result)))


VERB = Verb(diagnose, "Laboratory", variadic=True)
