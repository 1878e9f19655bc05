"""``heli-host pool``: diagnoses of several machines of one make, together."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from heli_host.cli.say import say, say_files
from heli_host.cli.verb import Verb

from heli_lab.fit_options import NumbersOption

if TYPE_CHECKING:
    from heli_lab.pool import RigPopulation


def pool(
    diagnoses: Annotated[
        list[Path],
        typer.Argument(metavar="DIAGNOSIS.json...", help="One of each machine, by diagnose --json."),
    ],
    rig: Annotated[
        str | None,
        typer.Option(
            "--rig",
            metavar="NAME|FILE",
            help="The rig that they were diagnosed with.  [default: by its name]",
            show_default=False,
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="FILE", help="The rig that a new machine begins with, TOML."),
    ] = None,
    json: NumbersOption = None,
) -> None:
    """Tell what machines of one make have in common: numbers, how they differ, and on how many a cause is.

    What a new machine begins with is another rig file: give it to identify or diagnose as --rig.

    Example: `heli-host pool lab1.json lab2.json lab3.json --out make.toml`
    """
    from dataclasses import asdict

    from heli_host.cli.outputs import check_result_places
    from heli_sim.rig import load_rig, write_rig

    from heli_lab.page import write_json
    from heli_lab.pool import pool as pooled
    from heli_lab.pool import read_machine

    check_result_places(out, json)
    population = pooled([read_machine(path) for path in diagnoses])
    say(*_lines(population))
    written = []
    if out is not None:
        base = load_rig(rig or population.machines[0].rig)
        comment = f"Found by heli-host pool from {len(population.machines)} machines."
        write_rig(population.prior(base, out.stem), out, comment)
        written.append(out)
    if json is not None:
        content = {
            "machines": [machine.label for machine in population.machines],
            "numbers": {name: asdict(number) for name, number in population.numbers.items()},
            "causes": {name: asdict(cause) for name, cause in population.causes.items()},
        }
        write_json(json, content)
        written.append(json)
    say_files(written)


def _lines(population: RigPopulation) -> list[str]:
    units = {
        name: quantity.unit for machine in population.machines for name, quantity in machine.numbers.items()
    }
    lines = [
        f"{len(population.machines)} machines of {population.machines[0].rig}, "
        f"model {population.machines[0].model}"
    ]
    if not population.causes:
        lines.append("  no cause on any of them")
    for name, cause in population.causes.items():
        low, high = cause.interval
        lines.append(
            f"  {name}: on {cause.found} of {cause.seen} machines that would show it; "
            f"of all {100 * low:.0f} to {100 * high:.0f} %"
        )
    lines.append(f"  {'number':32}{'mean':>10}{'std error':>11}{'from machine to machine':>25}  unit")
    for name, number in population.numbers.items():
        tau = f"{number.tau:.2g}" if number.machines > 1 else "unknown"
        lines.append(f"  {name:32}{number.mean:>10.4g}{number.std:>11.2g}{tau:>25}  {units[name]}")
    return lines


VERB = Verb(pool, "Laboratory")
