"""``heli-host pool``: combine diagnoses of several rigs of one type."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from heli_host.ui.cli.options import JsonOption
from heli_host.ui.cli.say import data_on_stdout, say, say_files, write_result
from heli_host.ui.cli.verb import Verb

from heli_lab.fit_inputs import SaveRigOption

if TYPE_CHECKING:
    from heli_lab.apps.pool import RigPopulation


def pool(
    diagnoses: Annotated[
        list[Path],
        typer.Argument(
            metavar="DIAGNOSIS.json...", help="Combine these files of diagnose --json, one per rig."
        ),
    ],
    rig: Annotated[
        str | None,
        typer.Option(
            "--rig",
            metavar="NAME|FILE",
            help="Use this rig file.  [default: the one that the diagnoses name]",
            show_default=False,
        ),
    ] = None,
    save_rig: SaveRigOption = None,
    json: JsonOption = None,
) -> None:
    """Combine diagnoses of several rigs and estimate how their parameters vary.

    The rigs must be of one type. Prints each parameter's mean, its standard error and its standard deviation
    between rigs. Also prints the share of rigs with each cause. --save-rig writes a rig file for
    the next rig of this type: give it to identify or diagnose as --rig.

    Example: `heli-host pool lab1.json lab2.json lab3.json --save-rig type.toml`
    """
    from dataclasses import asdict

    from heli_host.ui.cli.options import check_result_places
    from heli_sim.rig import load_rig, write_rig

    from heli_lab.apps.pool import pool as pool_diagnoses
    from heli_lab.apps.pool import read_rig_diagnosis

    check_result_places(save_rig, json)
    data_on_stdout(json)
    population = pool_diagnoses([read_rig_diagnosis(path) for path in diagnoses])
    say(*_population_lines(population))
    if save_rig is not None:
        type_rig = load_rig(rig or population.diagnoses[0].rig)
        comment = f"Pooled by heli-host pool from {len(population.diagnoses)} rigs."
        comment = "\n".join((comment, *population.cautions))
        write_rig(population.prior_rig(type_rig, save_rig.stem), save_rig, comment)
    content = {
        "cautions": list(population.cautions),
        "machines": [diagnosis.label for diagnosis in population.diagnoses],
        "numbers": {name: asdict(number) for name, number in population.parameters.items()},
        "causes": {
            name: {
                "found": cause.present,
                "seen": cause.detectable,
                "undecided": cause.undecided,
                "share": cause.share,
                "interval": cause.interval,
            }
            for name, cause in population.causes.items()
        },
    }
    write_result(json, content)
    say_files((save_rig, json))


def _population_lines(population: RigPopulation) -> list[str]:
    """Return the share of rigs with each cause, and the parameters' means and standard deviations, as
    text.
    """
    from heli_lab.apps.pool import MIN_CAUSE_CONFIDENCE

    units = {
        name: quantity.unit
        for diagnosis in population.diagnoses
        for name, quantity in diagnosis.parameters.items()
    }
    lines = [
        f"{len(population.diagnoses)} rigs of type {population.diagnoses[0].rig}, "
        f"model {population.diagnoses[0].model}"
    ]
    if not population.causes:
        lines.append("  no cause on any rig")
    for name, cause in population.causes.items():
        low, high = cause.interval
        lines.append(
            f"  {name}: on {cause.present} of {cause.detectable} rigs that could show it; "
            f"{100 * low:.0f} to {100 * high:.0f} % of all rigs of this type"
        )
        if cause.undecided:
            lines.append(
                f"    undecided on {cause.undecided} more: confidence below {MIN_CAUSE_CONFIDENCE:g}; "
                "diagnose with --validate"
            )
    lines.append(f"  {'parameter':32}{'mean':>10}{'std error':>11}{'std between rigs':>18}  unit")
    for name, number in population.parameters.items():
        tau = f"{number.tau:.2g}" if number.machines > 1 else "unknown"
        lines.append(f"  {name:32}{number.mean:>10.4g}{number.std:>11.2g}{tau:>18}  {units[name]}")
    lines += [f"  caution: {caution}" for caution in population.cautions]
    return lines


VERB = Verb(pool, "Laboratory")
