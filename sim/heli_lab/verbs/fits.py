"""``heli-host identify`` and ``diagnose``: fit a model to flights, and find what it lacks."""

from __future__ import annotations

import gc
import itertools
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer
from heli_host.ui.cli.options import DEFAULT_RIG, JsonOption
from heli_host.ui.cli.say import data_on_stdout, say, say_files, write_result
from heli_host.ui.cli.verb import Verb

from heli_lab import fit_inputs as option

if TYPE_CHECKING:
    from collections.abc import Sequence

    from heli_sim.rig import Rig

    from heli_lab.explain import Diagnosis, InsufficientExcitation
    from heli_lab.fit.identification import Identification
    from heli_lab.fit.records import Record
    from heli_lab.fit_inputs import FitInputs
    from heli_lab.watch.error_shares import ErrorShares
    from heli_lab.watch.saved_rig import Forecaster, JudgedFlight, RigComparison, RigModel, SavedRig


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
    loop_rate_Hz: option.LoopRateOption = None,
    skip_sign_check: option.SkipSignCheckOption = False,
    save_rig: option.SaveRigOption = None,
    report: option.ReportOption = None,
    vector: option.VectorOption = None,
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

    from heli_lab.fit.identification import identify as run_identification
    from heli_lab.fit.records import prepare_all
    from heli_lab.fit.voltage_timing import sampled
    from heli_lab.fit_inputs import fit_inputs, flights_line, input_lines, model_of, parts, read_parts
    from heli_lab.report.identification_page import verdict, write_identification_report
    from heli_lab.report.page.drawing import Drawing
    from heli_lab.threads import default_thread_count
    from heli_lab.watch.disturbances import with_likely_advance
    from heli_lab.watch.saved_rig import RigModel, comparison_json

    validation_paths = validate or []
    data_on_stdout(json)
    check_result_places(save_rig, json, report=report)
    inputs = fit_inputs(flights, validation_paths, rig, model, effect_file or (), effect or ())
    say(*input_lines(inputs))
    use_process = report is not None and default_thread_count() > 1
    with WorkBar() as bar, Drawing(use_process, option.vector_of_report(vector, report)) as drawing:
        spans = parts(start_s or (), stop_s or (), len(flights), len(validation_paths))
        paths = [*flights, *validation_paths]
        flight_parts = read_parts(paths, inputs, spans, allow_gaps, skip_sign_check, bar.show)
        records = prepare_all(list(flight_parts), inputs.rig, inputs.labels)
        if loop_rate_Hz is not None:
            records = sampled(records, loop_rate_Hz)

        def with_equations(rig: Rig) -> RigModel:
            return RigModel(model_of(rig, inputs.model.name, effect_file or ()), rig)

        def identified(records: Sequence[Record]) -> Identification:
            return run_identification(
                inputs.model,
                inputs.rig,
                records[: len(flights)],
                validation=records[len(flights) :],
                free=free or None,
                fixed=fix or (),
                window_s=window_s,
                on_progress=lambda progress: bar.show(progress.stage, progress.done),
                accept_unexplained=skip_sign_check,
            )

        identification = identified(records)
        if loop_rate_Hz is None:
            # The identified rig shows whether the voltages of a slow log are samples of those that acted.
            estimated = with_equations(identification.rig("estimated"))
            timed_records = with_likely_advance(estimated.model, estimated.rig, records, loop_Hz=None)
            if any(record.advance_rows for record in timed_records):
                records, identification = timed_records, identified(timed_records)
        page: Path | None = None
        comparison: RigComparison | None = None
        rig_lines: list[str] = []
        if save_rig is not None:
            bar.show("forecasts", 0.88)  # about this share of the work is done
            files = _FlightFiles(paths, inputs.labels, spans, len(flights), allow_gaps)
            comparison, rig_lines = _write_identified_rig(
                identification,
                save_rig,
                before=RigModel(model_of(inputs.rig, model, effect_file or ()), inputs.rig),
                after=with_equations(identification.rig(save_rig.stem)),
                judged=files.held_out(records) if validation_paths else files.fitted(records),
            )
        if report is not None:
            bar.show("drawing", 0.9)
            page = write_identification_report(identification, report, drawing)
        numbers = identification.json()
        numbers["saved_rig"] = None if comparison is None else comparison_json(comparison)
        write_result(json, numbers)
    say(*identification.slow_log_notes, flights_line(numbers["flights"]))
    _print_estimates(identification)
    say(verdict(identification))
    if rig_lines:
        say(f"{save_rig}: {rig_lines[0]}", *rig_lines[1:])
    say_files((save_rig, page, json))
    if not identification.converged:
        raise typer.Exit(1)


def _write_identified_rig(
    identification: Identification,
    path: Path,
    *,
    before: RigModel,
    after: RigModel,
    judged: Sequence[JudgedFlight],
) -> tuple[RigComparison | None, list[str]]:
    """Write the identified rig with a comment on its forecasts of some flights, compared with those `before`.

    Returns the comparison, None if there is none, and the lines of the comment about it.
    """
    from heli_host.errors import HeliError
    from heli_sim.rig import write_rig

    from heli_lab.report.identification_page import verdict
    from heli_lab.watch.saved_rig import compare_rigs, unmeasured_sentence

    comparison: RigComparison | None = None
    try:
        comparison = compare_rigs(before, after, judged, fitted=identification.fit.problem.records)
        lines = list(comparison.lines)
    except HeliError as error:
        lines = [unmeasured_sentence(error)]
    comment = f"Found by heli-host identify. {verdict(identification)}"
    write_rig(after.rig, path, "\n".join([comment, *lines]))
    return comparison, lines


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


def diagnose(
    flights: option.FlightsArgument,
    validate: option.ValidateOption = None,
    rig: option.KnownRigOption = DEFAULT_RIG,
    model: option.EquationsOption = None,
    effect_file: option.OwnEffectsOption = None,
    start_s: option.FromOption = None,
    stop_s: option.ToOption = None,
    allow_gaps: option.GapsOption = False,
    loop_rate_Hz: option.LoopRateOption = None,
    skip_sign_check: option.SkipSignCheckOption = False,
    report: option.ReportOption = None,
    vector: option.VectorOption = None,
    json: JsonOption = None,
    save_rig: option.SaveRigOption = None,
    with_term: Annotated[
        bool, typer.Option("--with-term", help="Add a proposed equation term to the rig of --save-rig.")
    ] = False,
    with_unconfirmed: Annotated[
        bool,
        typer.Option(
            "--with-unconfirmed", help="Add causes that are not confirmed to the rig of --save-rig."
        ),
    ] = False,
    calibrate_s: Annotated[
        float | None,
        typer.Option(
            "--calibrate",
            metavar="SECONDS",
            min=0.0,
            help="Calibrate over this time of a validation flight, s.  [default: 8, at most a third]",
            show_default=False,
        ),
    ] = None,
    seed: Annotated[
        int, typer.Option("--seed", metavar="N", min=0, help="Seed the bootstrap of the intervals.")
    ] = 0,
    budget: Annotated[
        int,
        typer.Option(
            "--budget", metavar="N", min=1, help="Stop the search after this many refits of the model."
        ),
    ] = 80,
    resume: Annotated[
        Path | None,
        typer.Option("--resume", metavar="FILE", help="Save the search to this file, and continue from it."),
    ] = None,
) -> None:
    """Find the causes of a model's errors in flights, and extend the model.

    The model is refitted first. An effect counts as a cause if its log-likelihood ratio exceeds its
    complexity penalty. Random torques count as disturbances. If no effect explains a predictable error, the
    verdict is `unexplained`. Then --report proposes an equation term as an effect file.

    --validate evaluates the error reduction and confirms causes: a confirmed cause also holds if the roles
    of the flights are exchanged. Without --validate, nothing is confirmed. The rig of --save-rig has
    confirmed causes only. Without --report, --json and --save-rig the result is only printed.

    Example: `heli-host diagnose a.mcap --validate b.mcap --report why --save-rig extended.toml`
    """
    # The matrices are small: several BLAS threads only wait for each other.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from heli_host.ui.cli.live import WorkBar
    from heli_host.ui.cli.options import check_result_places
    from heli_sim.model.effects import catalogue

    from heli_lab.errors import NotExcited
    from heli_lab.explain import InsufficientExcitation, insufficient_excitation
    from heli_lab.explain import diagnose as run_diagnosis
    from heli_lab.fit_inputs import fit_inputs, flights_line, input_lines, parts, read_parts
    from heli_lab.report.diagnosis.page import write_effect_file, write_insufficient_excitation, write_report
    from heli_lab.report.diagnosis.serialize import to_json
    from heli_lab.report.page.drawing import Drawing
    from heli_lab.threads import default_thread_count, limit_malloc_arenas
    from heli_lab.watch.saved_rig import saved_json

    # Exclude loaded libraries from garbage collection, which otherwise takes 8 % of a diagnosis.
    gc.freeze()
    limit_malloc_arenas()
    validation_paths = validate or []
    data_on_stdout(json)
    check_result_places(save_rig, json, resume, report=report)
    inputs = fit_inputs(flights, validation_paths, rig, model, effect_file or ())
    say(*input_lines(inputs))
    kinds = catalogue(effect_file or ())
    result: Diagnosis | InsufficientExcitation
    output_files: list[Path | None] = []
    shares: ErrorShares | None = None
    rig_file: _RigFile | None = None
    use_process = report is not None and default_thread_count() > 1
    with WorkBar() as bar, Drawing(use_process, option.vector_of_report(vector, report)) as drawing:
        spans = parts(start_s or (), stop_s or (), len(flights), len(validation_paths))
        paths = [*flights, *validation_paths]
        flight_parts = read_parts(paths, inputs, spans, allow_gaps, skip_sign_check, bar.show)
        try:
            # One iterator for both: no list keeps the flights in memory, and those to fit come first.
            result = run_diagnosis(
                inputs.model,
                inputs.rig,
                itertools.islice(flight_parts, len(flights)),
                flight_parts,
                kinds=kinds,
                labels=inputs.labels,
                seed=seed,
                calibrate_s=calibrate_s,
                refits=budget,
                resume=resume,
                loop_Hz=loop_rate_Hz,
                say=bar.show,
            )
        except NotExcited as error:
            result = insufficient_excitation(str(error), inputs.model, inputs.rig, kinds)
        if isinstance(result, InsufficientExcitation):
            if report is not None:
                output_files.append(write_insufficient_excitation(result, report))
        else:
            if result.label != "explained" or save_rig is not None:
                bar.show("forecasts", 0.93)  # about this share of the work is done
                files = _FlightFiles(paths, inputs.labels, spans, len(flights), allow_gaps)
                forecast = _forecaster(result, files, inputs, effect_file or ())
                shares = _error_shares(result, forecast, files)
                if save_rig is not None:
                    bar.show("forecasts with the extended rig", 0.94)
                    rig_file = _write_extended_rig(result, save_rig, forecast, with_unconfirmed, with_term)
                    output_files.append(save_rig)
            if report is not None:
                bar.show("drawing", 0.95)
                output_files.append(write_report(result, report, drawing, shares))
            # A rig with a proposed equation term needs the effect file of that term.
            effect_folder = report or (save_rig.parent if save_rig is not None and with_term else None)
            if result.proposed_term is not None and effect_folder is not None:
                output_files.append(write_effect_file(result, effect_folder))
        numbers = to_json(result, shares)
        numbers["saved_rig"] = None if rig_file is None else saved_json(rig_file.saved)
        write_result(json, numbers)
        output_files.append(json)
    if numbers["flights"]:
        say(flights_line(numbers["flights"]))
    _print_diagnosis(result, shares)
    if rig_file is not None and rig_file.remark:
        say(f"{save_rig}: {rig_file.remark}")
    if rig_file is not None and rig_file.lines:
        say(f"{save_rig}: {rig_file.lines[0]}", *rig_file.lines[1:])
    say_files(output_files)


@dataclass(frozen=True)
class _FlightFiles:
    """The files of all flights: first those to fit, then those for validation."""

    paths: Sequence[Path]
    labels: Sequence[str]
    spans: Sequence[tuple[float | None, float | None]]  # Part of each flight [s], None without a limit
    fitted_count: int
    allow_gaps: bool

    def fitted(self, records: Sequence[Record]) -> list[JudgedFlight]:
        """Read the fitted flights for forecasts, with the voltages that acted according to the `records`."""
        return self._read(slice(self.fitted_count), records)

    def held_out(self, records: Sequence[Record]) -> list[JudgedFlight]:
        """Read the validation flights in the same way."""
        return self._read(slice(self.fitted_count, None), records)

    def _read(self, part: slice, records: Sequence[Record]) -> list[JudgedFlight]:
        from heli_host.data.log.reader import read_flight

        from heli_lab.fit.voltage_timing import with_acting_voltages
        from heli_lab.watch.saved_rig import JudgedFlight

        advance_rows = {record.label: record.advance_rows for record in records}
        judged: list[JudgedFlight] = []
        for path, label, span in zip(self.paths[part], self.labels[part], self.spans[part], strict=True):
            flight = replace(read_flight(path, allow_gaps=self.allow_gaps), extra={})
            acting = with_acting_voltages(flight, advance_rows.get(label, 0.0))
            judged.append(JudgedFlight(label, acting, span))
        return judged


def _records_of(result: Diagnosis) -> tuple[Record, ...]:
    """Return the records of all flights of a diagnosis, of the fitted ones first."""
    after = result.assessment.after
    held_out_records = after.held_out_fit.problem.records if after.held_out_fit else ()
    return (*after.fit.problem.records, *held_out_records)


class _RigFile(NamedTuple):
    """The rig file of a diagnosis, and what is printed about it."""

    saved: SavedRig
    remark: str  # On unconfirmed causes in the rig; empty without them
    lines: list[str]  # Causes that were left out, and forecast errors


def _forecaster(
    result: Diagnosis, files: _FlightFiles, inputs: FitInputs, effect_files: Sequence[Path]
) -> Forecaster:
    """Forecast the validation flights; without them, the fitted flights."""
    from heli_lab.fit_inputs import model_of
    from heli_lab.watch.saved_rig import Forecaster

    records = _records_of(result)
    judged = files.held_out(records) if result.has_other_flight else files.fitted(records)
    return Forecaster(judged, lambda rig: model_of(rig, inputs.model.name, effect_files), inputs.rig)


def _write_extended_rig(
    result: Diagnosis, path: Path, forecast: Forecaster, with_unconfirmed: bool, with_term: bool
) -> _RigFile:
    """Write the extended rig, without causes that worsen the forecasts."""
    from heli_sim.rig import write_rig

    from heli_lab.report.diagnosis.text import summary, unconfirmed_in_rig
    from heli_lab.watch.saved_rig import saved_rig

    saved = saved_rig(result, path.stem, forecast, with_unconfirmed=with_unconfirmed, with_term=with_term)
    remark = unconfirmed_in_rig(result, saved.has_term, with_unconfirmed)
    model_name = result.assessment.after.fit.problem.model.name
    comment = f"Found by heli-host diagnose, model {model_name}. {summary(result)} {remark}".strip()
    lines = [*(cause.sentence for cause in saved.left_out), *saved.lines]
    write_rig(saved.rig, path, "\n".join([comment, *lines]))
    return _RigFile(saved, remark, lines)


def _error_shares(result: Diagnosis, forecast: Forecaster, files: _FlightFiles) -> ErrorShares | None:
    """Return the parts of the forecast error; None if nothing is missing, or all flights are short."""
    from heli_host.errors import HeliError

    from heli_lab.watch.error_shares import error_shares

    if result.label == "explained":
        return None
    try:
        return error_shares(result, forecast, lambda: files.fitted(_records_of(result)))
    except HeliError:  # all flights are too short for a forecast
        return None


def _print_diagnosis(result: Diagnosis | InsufficientExcitation, shares: ErrorShares | None) -> None:
    """Print the verdict, the causes and the error reduction."""
    from heli_lab.report.diagnosis.text import lines, slow_log_cautions, summary

    say(*slow_log_cautions(result))
    say(f"{result.label}: {summary(result)}", *(f"  {line}" for line in lines(result, shares)))


VERBS = {verb.__name__: Verb(verb, "Laboratory", variadic=True) for verb in (diagnose, identify)}
