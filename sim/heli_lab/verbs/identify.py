"""``heli-host identify``: estimate a rig's parameters from flights."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from heli_host.ui.cli.options import DEFAULT_RIG, JsonOption
from heli_host.ui.cli.say import data_on_stdout, say, say_files, write_result
from heli_host.ui.cli.verb import Verb

from heli_lab import fit_inputs as option

if TYPE_CHECKING:
    from heli_lab.fit.identification import Identification


def identify(
    flights: option.FlightsArgument,
    rig: option.KnownRigOption = DEFAULT_RIG,
    model: option.EquationsOption = None,
    effect: Annotated[
        list[str] | None,
        typer.Option("--effect", metavar="ID...", help="Estimate these effects too, such as rotor_lag."),
    ] = None,
    effect_file: option.OwnEffectsOption = None,
    free: Annotated[
        list[str] | None,
        typer.Option(
            "--free",
            metavar="NAME...",
            help="Estimate these parameters.  [default: all with a tolerance]",
            show_default=False,
        ),
    ] = None,
    fix: Annotated[
        list[str] | None,
        typer.Option("--fix", metavar="NAME...", help="Keep these parameters at their prior values."),
    ] = None,
    validate: option.ValidateOption = None,
    start_s: option.FromOption = None,
    stop_s: option.ToOption = None,
    window_s: Annotated[
        float,
        typer.Option(
            "--window-s",
            metavar="S",
            min=0.5,
            max=30.0,
            help="Simulate open loop over windows of this length in s.",
        ),
    ] = 2.0,
    allow_gaps: option.GapsOption = False,
    skip_sign_check: option.SkipSignCheckOption = False,
    save_rig: option.SaveRigOption = None,
    report: option.ReportOption = None,
    json: JsonOption = None,
) -> None:
    """Estimate a rig's parameters from flights, with standard errors.

    Each window of a flight is simulated open loop from its voltages. The estimates minimise the squared
    errors, with the tolerances of the rig file as priors. If a fit does not converge, the result states this,
    and the exit code is 1. Without --save-rig, --report and --json the result is only printed.

    Example: `heli-host identify a.mcap --validate b.mcap --save-rig mine.toml --report mine`
    """
    from heli_host.ui.cli.live import WorkBar
    from heli_host.ui.cli.options import check_result_places
    from heli_sim.rig import write_rig

    from heli_lab.fit.identification import identify as run_identification
    from heli_lab.fit_inputs import fit_inputs, flights_line, input_lines, parts, read_parts
    from heli_lab.report.identification_page import verdict, write_identification_report
    from heli_lab.report.page.drawing import Drawing
    from heli_lab.threads import default_thread_count

    validation_paths = validate or []
    data_on_stdout(json)
    check_result_places(save_rig, json, report=report)
    inputs = fit_inputs(flights, validation_paths, rig, model, effect_file or (), effect or ())
    say(*input_lines(inputs, rig))
    use_process = report is not None and default_thread_count() > 1
    with WorkBar() as bar, Drawing(use_process) as drawing:
        spans = parts(start_s or (), stop_s or (), len(flights), len(validation_paths))
        paths = [*flights, *validation_paths]
        flight_parts = list(read_parts(paths, inputs, spans, allow_gaps, skip_sign_check, bar.show))
        identification = run_identification(
            inputs.model,
            inputs.rig,
            flight_parts[: len(flights)],
            validation=flight_parts[len(flights) :],
            free=free or None,
            fixed=fix or (),
            labels=inputs.labels[: len(flights)],
            validation_labels=inputs.labels[len(flights) :],
            window_s=window_s,
            on_progress=lambda progress: bar.show(progress.stage, progress.done),
            skip_sign_check=skip_sign_check,
        )
        page: Path | None = None
        if save_rig is not None:
            identified_rig = identification.rig(save_rig.stem)
            write_rig(identified_rig, save_rig, f"Found by heli-host identify. {verdict(identification)}")
        if report is not None:
            bar.show("drawing", 0.9)
            page = write_identification_report(identification, report, drawing)
        numbers = identification.json()
        write_result(json, numbers)
    say(flights_line(numbers["flights"]))
    _print_estimates(identification)
    say(verdict(identification))
    say_files((save_rig, page, json))
    if not identification.converged:
        raise typer.Exit(1)


def _print_estimates(identification: Identification) -> None:
    """Print estimates and priors in a table, each with its standard error."""
    from heli_host.data.log.comparison import table_lines

    from heli_lab.fit.identification import rounded

    fit = identification.fit
    rows = [("parameter", "estimate", "±", "prior", "±", "unit", "")]
    for parameter, value, std in zip(fit.problem.free, fit.theta, fit.std.values(), strict=True):
        remark = identification.remark(parameter.name)
        prior = f"{parameter.prior.mean:g}", f"{parameter.prior.std:g}"
        rows.append((parameter.name, rounded(value, std), rounded(std, std), *prior, parameter.unit, remark))
    say(*table_lines(rows, words=(0, 5, 6)), "± is one standard error")


VERB = Verb(identify, "Laboratory", variadic=True)
