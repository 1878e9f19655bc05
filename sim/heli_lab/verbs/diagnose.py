"""``heli-host diagnose``: what the simulation gets wrong."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from heli_host.cli.simulated import DEFAULT_RIG
from heli_host.cli.verb import Verb

from heli_lab import fit_options as option

if TYPE_CHECKING:
    from heli_lab.diagnose import Diagnosis
    from heli_lab.diagnose.insufficient_excitation import InsufficientExcitation


def diagnose(
    flights: option.FlightsArgument,
    validate: option.ValidateOption = None,
    rig: option.KnownRigOption = DEFAULT_RIG,
    model: option.EquationsOption = None,
    effects: option.OwnEffectsOption = None,
    start_s: option.FromOption = None,
    stop_s: option.ToOption = None,
    report: option.ReportOption = None,
    json: option.NumbersOption = None,
    out: option.FoundRigOption = None,
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
) -> None:
    """Show what a model gets wrong in flights, name the cause, extend the model, measure the gain.

    The baseline is refitted first. Every effect of the catalogue is scored; one is named if its
    log-likelihood ratio exceeds its penalty; the flights given with --validate have no part in that, they
    judge it. What chance alone makes is weather; what can be foretold and no effect explains is
    `unexplained`.

    Example: `heli-host diagnose a.mcap --validate b.mcap --rig makki2024 --report why --out extended.toml`
    """
    # Matrices here are small: more threads only wait for each other.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from heli_host.cli.outputs import check_result_places
    from heli_host.cli.progress_bar import WorkBar
    from heli_sim.model.effects import catalogue
    from heli_sim.rig import write_rig

    from heli_lab.diagnose import diagnose as find
    from heli_lab.diagnose.insufficient_excitation import InsufficientExcitation, insufficient_excitation
    from heli_lab.diagnose.report import write_insufficient_excitation, write_report
    from heli_lab.diagnose.serialize import to_json
    from heli_lab.diagnose.summary import summary
    from heli_lab.errors import NotExcited
    from heli_lab.fit_inputs import fit_inputs, read_flights
    from heli_lab.page import write_json

    others = validate or []
    check_result_places(out, json, report=report)
    given = fit_inputs(flights, others, rig, model, effects or ())
    kinds = catalogue(effects or ())
    found: Diagnosis | InsufficientExcitation
    written: list[Path] = []
    with WorkBar() as bar:
        bar.show("reading", 0.0)
        fitted, held_out = read_flights(flights), read_flights(others)
        try:
            found = find(
                given.model,
                given.rig,
                fitted,
                held_out,
                kinds=kinds,
                labels=given.labels,
                start_s=start_s,
                stop_s=stop_s,
                seed=seed,
                calibrate_s=calibrate_s,
                refits=budget,
                say=bar.show,
            )
        except NotExcited as nothing:
            found = insufficient_excitation(str(nothing), given.model, given.rig, kinds)
        if out is not None and not isinstance(found, InsufficientExcitation):
            write_rig(
                found.rig(out.stem),
                out,
                f"Found by heli-host diagnose, model {given.model.name}. {summary(found)}",
            )
            written.append(out)
        if report is not None:
            bar.show("drawing", 0.95)
            if isinstance(found, InsufficientExcitation):
                written.append(write_insufficient_excitation(found, report))
            else:
                written.append(write_report(found, report))
        if json is not None:
            write_json(json, to_json(found))
            written.append(json)
    _print(found)
    if written:
        print(f"files: {', '.join(str(path) for path in written)}")


def _print(found: Diagnosis | InsufficientExcitation) -> None:
    """Print the verdict, the causes and the gain."""
    from heli_lab.diagnose.summary import lines, summary

    print(f"{found.label}: {summary(found)}")
    for line in lines(found):
        print(f"  {line}")


VERB = Verb(diagnose, "Laboratory", variadic=True)
