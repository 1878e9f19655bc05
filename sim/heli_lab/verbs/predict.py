"""``heli-host predict``: forecast a flight from its present state, and compare the forecasts with it."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from heli_host.ui.cli.options import DEFAULT_RIG, FigureOption, JsonOption
from heli_host.ui.cli.say import data_on_stdout, say, say_files, write_result
from heli_host.ui.cli.verb import Verb

from heli_lab import fit_inputs as option

if TYPE_CHECKING:
    from collections.abc import Sequence

    from heli_sim.model import Model
    from heli_sim.rig import Rig

    from heli_lab.watch.forecast import Forecasts, HorizonErrors


def predict(
    flight: Annotated[
        Path, typer.Argument(metavar="FLIGHT", help="Forecast this flight: .mcap, .csv or .csv.gz.")
    ],
    rig: Annotated[
        str,
        typer.Option(
            "--rig",
            metavar="NAME|FILE",
            help=f"Forecast with this rig and its effects.  [default: {DEFAULT_RIG}]",
            show_default=False,
        ),
    ] = DEFAULT_RIG,
    baseline: Annotated[
        str | None,
        typer.Option(
            "--baseline",
            metavar="NAME|FILE",
            help="Compare with this rig.  [default: the rig without its effects]",
            show_default=False,
        ),
    ] = None,
    effect_file: option.OwnEffectsOption = None,
    start_s: Annotated[
        float | None,
        typer.Option("--from", "--from-s", metavar="S", help="Ignore rows before this time in s."),
    ] = None,
    stop_s: Annotated[
        float | None, typer.Option("--to", "--to-s", metavar="S", help="Ignore rows from this time in s on.")
    ] = None,
    allow_gaps: option.GapsOption = False,
    loop_rate_Hz: option.LoopRateOption = None,
    json: JsonOption = None,
    figure: FigureOption = None,
) -> None:
    """Forecast a flight from its present state, and measure the errors.

    A forecast starts every 0.2 s from the state that a filter has estimated from the past. It continues for
    5 s with the voltages that acted. The errors are compared with those of a rig without the effects, and of
    angles that stay. Without --json and --figure the result is only printed.

    Example: `heli-host predict b.mcap --rig extended.toml --baseline mine.toml --figure forecast.png`
    """
    # The matrices are small: several BLAS threads only wait for each other.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from heli_host.data.log.reader import read_flight
    from heli_host.ui.cli.live import WorkBar
    from heli_host.ui.cli.options import check_result_places
    from heli_sim.model import model_named
    from heli_sim.rig import load_rig

    from heli_lab.fit.identification import is_fitted_flight
    from heli_lab.watch.disturbances import acting_flights, learn_disturbances
    from heli_lab.watch.forecast import draw_forecasts, errors_json, forecasts_of, horizon_errors

    check_result_places(json, figure=figure)
    data_on_stdout(json)
    if start_s is not None and stop_s is not None and stop_s <= start_s:
        raise typer.BadParameter(f"--from {start_s:g} is not before --to {stop_s:g}; give an earlier --from")
    loaded_rig = load_rig(rig)
    model = option.model_of(loaded_rig, effect_files=effect_file or ())
    baseline_rig = loaded_rig if baseline is None else load_rig(baseline)
    baseline_model = (
        model_named(model.name)
        if baseline is None
        else option.model_of(baseline_rig, effect_files=effect_file or ())
    )
    # A rig without effects is its own baseline, unless another is given.
    has_baseline = baseline is not None or bool(model.effects)
    with WorkBar() as bar:
        bar.show("reading", 0.0)
        label = flight.name
        flown = replace(read_flight(flight, allow_gaps=allow_gaps), extra={})
        say(*option.other_rig_notes(loaded_rig, rig, {label: flown.meta.get("rig", "")}))
        bar.show("voltages between the rows", 0.05)
        (flown,), slow_log_notes = acting_flights(model, loaded_rig, [flown], [label], loop_rate_Hz)

        def forecast(equations: Model, parameters: Rig, name: str, share: float) -> Forecasts:
            """Forecast with a model; the bar shows `name`, beginning with this `share` of the work."""
            bar.show(f"disturbances of the {name}", share)
            disturbances = learn_disturbances(equations, parameters, flown, label)
            bar.show(f"forecasts of the {name}", share + 0.1)
            return forecasts_of(equations, parameters, disturbances, flown, label, (start_s, stop_s))

        forecasts = forecast(model, loaded_rig, "rig", share=0.1)
        baseline_forecasts: Forecasts | None = None
        if has_baseline:
            baseline_forecasts = forecast(baseline_model, baseline_rig, "baseline", share=0.5)
        rows = horizon_errors(forecasts, baseline_forecasts)
    baseline_name = baseline or (f"{rig} without its effects" if has_baseline else None)
    say(*slow_log_notes, *_table(forecasts, rows, rig, baseline_name))
    if is_fitted_flight(loaded_rig, label):
        say(f"{rig} was identified from {label}: forecast another flight to see how well it predicts")
    numbers = errors_json(forecasts, rows, rig, baseline_name)
    write_result(json, {**numbers, "slow_log": slow_log_notes[0] if slow_log_notes else None})
    if figure is not None:
        draw_forecasts(forecasts, rows, baseline_name or "", figure)
    say_files((json, figure))


def _table(
    forecasts: Forecasts, rows: Sequence[HorizonErrors], rig: str, baseline_name: str | None
) -> list[str]:
    """Write the errors as a table, with the conditions in which they were measured."""
    import numpy as np
    from heli_host.data.log.comparison import table_lines
    from heli_sim.model.effect import AXES

    cells = [("horizon", "axis", "model", "baseline", "ratio", "95 %", "nothing changes")]
    for row in rows:
        for axis in AXES:
            reduction = None if row.reduction is None else row.reduction[axis]
            compared = ("-", "-", "-")
            if reduction is not None:
                low, high = reduction.interval95
                compared = (
                    f"{reduction.before_deg:.3g}",
                    f"{reduction.ratio:.2f}",
                    f"{low:.2f} to {high:.2f}",
                )
            cells.append(
                (
                    f"{row.horizon_s:g} s",
                    axis,
                    f"{row.with_causes[axis]:.3g}",
                    *compared,
                    f"{row.persistence[axis]:.3g}",
                )
            )
    (low_V, high_V), rates_deg_s = forecasts.range_V, np.rad2deg(forecasts.range_rad_s)
    rates = ", ".join(
        f"{axis} {low:z.3g} to {high:z.3g} deg/s" for axis, low, high in zip(AXES, *rates_deg_s, strict=True)
    )
    lines = [
        f"{forecasts.label}: {len(forecasts.start_s)} forecasts with rig {rig}; rms errors in deg",
        *table_lines(cells, words=(0, 1)),
        f"measured at front {low_V[0]:.1f} to {high_V[0]:.1f} V, back {low_V[1]:.1f} to {high_V[1]:.1f} V",
        f"and at {rates}",
    ]
    if baseline_name is not None:
        lines.insert(1, f"baseline: {baseline_name}; a ratio below 1 means that the model is better")
    return lines


VERB = Verb(predict, "Laboratory")
