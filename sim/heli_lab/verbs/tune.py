"""``heli-host tune``: design gains of the control law for a rig."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from heli_host.data.files import save_figure, write_signed
from heli_host.ui.cli.options import DEFAULT_RIG, EffectFilesOption, FigureOption, JsonOption, SeedOption
from heli_host.ui.cli.say import data_on_stdout, say, say_files, write_result
from heli_host.ui.cli.verb import Verb

from heli_lab.fit_inputs import DEFAULT_MODEL, EquationsOption

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from heli_host.errors import FlightAborted
    from heli_host.ui.cli.live import WorkBar
    from heli_sim.model.base import Model
    from heli_sim.model.effect import Effect
    from heli_sim.rig import Rig

    from heli_lab.control.tune import Design, LoopEffects
    from heli_lab.control.tune.trial import Trial

TRIAL_LAG_s = 0.12
"""Rotor lag of the second test flight if no lag is stated [s]; rotors of this size have 0.09 to 0.15 s."""
_DIGITS = 4
"""Significant digits of the parameters."""


def tune(
    rig: Annotated[
        str, typer.Option("--rig", metavar="NAME|FILE", help="Design the gains for this rig.")
    ] = DEFAULT_RIG,
    model: EquationsOption = None,
    effect: Annotated[
        list[str] | None,
        typer.Option(
            "--effect",
            metavar="ID[=VALUE]",
            help="Add an effect to the rig, such as rotor_lag=0.12. Repeatable.",
        ),
    ] = None,
    effect_file: EffectFilesOption = None,
    sensitivity: Annotated[
        float,
        typer.Option(
            "--sensitivity",
            metavar="S",
            min=1.6,
            max=10.0,
            help="Bound the peak of 1/|1 + L|. Lower values give slower loops.",
        ),
    ] = 3.5,
    seed: SeedOption = 1,
    save_params: Annotated[
        Path | None, typer.Option("--save-params", metavar="FILE", help="Write the board's parameters, TOML.")
    ] = None,
    json: JsonOption = None,
    figure: FigureOption = None,
) -> None:
    """Design gains for a rig, print stability margins, and test them in simulation.

    One set of gains must fly rigs that differ from the rig file: by 20 % in thrust, 3 % in counterweight, and
    with rotor lags from 0 to 0.15 s. If the rig file states a rotor_lag, the lags are within 25 % of it.
    Without --save-params the gains are only tested. If a test flight fails, the exit code is 4, and no
    parameters are written.

    Example: `heli-host tune --rig mine.toml --save-params gains.toml`
    """
    from heli_host.ui.cli.live import WorkBar
    from heli_host.ui.cli.options import check_parameters_place, check_result_places
    from heli_sim.model.effects import effects_with
    from heli_sim.rig import load_rig

    data_on_stdout(json)
    check_result_places(json, figure=figure)
    check_parameters_place(save_params)
    base_rig = load_rig(rig)
    task = _Task(
        base_rig,
        model or base_rig.model or DEFAULT_MODEL,
        tuple(effects_with(base_rig, effect or (), effect_file or ())),
        sensitivity,
        seed,
    )
    with WorkBar() as bar:
        result = _design_and_test(task, bar)
    say(*_rig_lines(result), *_margin_lines(result.design), *_flight_lines(result.trials))
    failures = result.failures
    if save_params is not None and not failures:
        _write_parameters(save_params, result)
    write_result(json, _json_object(result))
    if figure is not None:
        from heli_lab.control.tune.trial import figure_of_design

        save_figure(figure_of_design(result.design, result.trials), figure, dpi=120)
    say_files((None if failures else save_params, json, figure))
    if failures:
        raise _failed_flights_error(result, save_params)
    if save_params is not None:
        say(
            f"to fly with these gains: heli-host fly hover --sil --rig {rig} --params {save_params}; "
            f"to set them on a board: heli-host params restore {save_params} --port PORT"
        )


@dataclass(frozen=True)
class _Task:
    """A rig, and the demands on its gains."""

    rig: Rig
    model_name: str
    effects: tuple[Effect, ...]  # Of the rig file and of the options
    sensitivity: float  # Largest peak of 1/|1 + L|
    seed: int  # Seed of the test flights


@dataclass(frozen=True)
class _Result:
    """Gains for a rig, and their test flights."""

    task: _Task
    loop_effects: LoopEffects  # Effects that the design considers
    design: Design
    parameters: Mapping[str, float]  # The gains, rounded, as parameters of the board
    trials: Sequence[Trial]

    @property
    def failures(self) -> list[str]:
        """Label and outcome of each test flight that was not completed."""
        return [
            f"{trial.label}: {trial.metrics.outcome}"
            for trial in self.trials
            if trial.metrics.outcome != "completed"
        ]


def _design_and_test(task: _Task, bar: WorkBar) -> _Result:
    """Design gains that the board accepts, and fly them in simulation."""
    from heli_host.board.parameters import checked
    from heli_sim.model import MODELS, model_named
    from heli_sim.model.effects.lags import RotorLag

    from heli_lab.control.tune import find_gains, loop_effects_of

    equations = model_named(task.model_name, task.effects)
    loop_effects = loop_effects_of(task.effects)
    design = find_gains(
        task.rig,
        spread=None,
        sensitivity=task.sensitivity,
        # The loop of elevation is designed first; the shares of the time are rough.
        on_progress=lambda stage: bar.show(stage, 0.05 if stage.startswith("elevation") else 0.2),
        model=MODELS[task.model_name],
        loop_effects=loop_effects,
    )
    parameters = rounded_parameters(design.parameters)
    for parameter, value in parameters.items():
        checked(parameter, value)
    test_models = [_TestModel(_lag_label(loop_effects.lag_s), equations)]
    if loop_effects.lag_s is None:
        model_with_lag = model_named(task.model_name, (*task.effects, RotorLag(TRIAL_LAG_s)))
        test_models.append(_TestModel(_lag_label(TRIAL_LAG_s), model_with_lag))
    trials = _fly_test(test_models, task.rig, parameters, task.seed, bar)
    return _Result(task, loop_effects, design, parameters, trials)


def _write_parameters(file: Path, result: _Result) -> None:
    """Write the board's parameters; the first line states for which rig they are."""
    from heli_host.board.parameters import parameters_text

    task = result.task
    effect_names = [effect.name for effect in task.effects]
    design_text = ", ".join((f"rig {task.rig.name}", f"model {task.model_name}", *effect_names))
    write_signed(file, parameters_text(result.parameters, f"heli-host tune: gains for {design_text}"))


def _failed_flights_error(result: _Result, save_params: Path | None) -> FlightAborted:
    """Return the error that ends the verb if a test flight failed."""
    from heli_host.errors import FlightAborted

    not_written = f"; {save_params} was not written" if save_params is not None else ""
    return FlightAborted(
        f"{len(result.failures)} of {len(result.trials)} test flights with these gains failed: "
        f"{result.failures[0]}{not_written}",
        "check the rig file with heli-host rig check, or lower --sensitivity",
    )


def rounded_parameters(parameters: Mapping[str, float]) -> dict[str, float]:
    """Round `parameters` to four significant digits, apart from counts per turn, which are exact."""
    return {
        name: value if name.endswith("_counts_per_rev") else float(f"{value:.{_DIGITS}g}")
        for name, value in parameters.items()
    }


@dataclass(frozen=True)
class _TestModel:
    """Equations of motion for a test flight; the label is the rotor lag."""

    label: str
    model: Model


def _fly_test(
    test_models: Sequence[_TestModel], rig: Rig, parameters: Mapping[str, float], seed: int, bar: WorkBar
) -> list[Trial]:
    """Simulate a test flight with the board's parameters for each model, and return the results."""
    from heli_sim.model.plant import Plant

    from heli_lab.control.tune.trial import try_gains

    def show(number: int, done: float) -> None:
        # The design before the test flights is half of the work.
        share = 0.5 + 0.5 * (number + done) / len(test_models)
        bar.show(f"test flight, {test_models[number].label}", share)

    return [
        try_gains(Plant(test.model, rig, seed), parameters, test.label, seed, partial(show, number))
        for number, test in enumerate(test_models)
    ]


def _lag_label(lag_s: float | None) -> str:
    return "no lag" if lag_s is None else f"lag {1e3 * lag_s:.0f} ms"


def _rig_lines(result: _Result) -> list[str]:
    """Describe the rig and the plants of the design; name unknown encoder directions and excluded effects."""
    from heli_host.declaration import AXES
    from heli_sim.rig.rig import direction_is_known

    rig, design, loop_effects = result.task.rig, result.design, result.loop_effects
    lags_ms = [1e3 * plant.lag_s for plant in design.plants]
    delay_text = f", delay {1e3 * loop_effects.delay_s:.0f} ms" if loop_effects.delay_s else ""
    lines = [
        f"rig {rig.name}, model {result.task.model_name}: {len(design.plants)} plants, "
        f"lag {min(lags_ms):.0f} to {max(lags_ms):.0f} ms{delay_text}"
    ]
    unknown_axes = [
        axis for axis, is_known in zip(AXES, direction_is_known(rig), strict=True) if not is_known
    ]
    if unknown_axes:
        lines.append(
            f"the rig file states no encoder direction of {', '.join(unknown_axes)}: the gains leave these "
            "counts per turn as the board has them"
        )
    if loop_effects.excluded:
        lines.append(f"in the test flights, but not in the design: {', '.join(loop_effects.excluded)}")
    return lines


def _margin_lines(design: Design) -> list[str]:
    """Return a table of the stability margins of each loop, as text.

    There is one row for each rotor lag at nominal thrust and counterweight, and one for the worst plant.
    """
    from heli_lab.control.tune import LOOPS

    # Label of each row, and the margins of its plants.
    plant_rows = [
        (_lag_label(plant.lag_s), [margins])
        for plant, margins in zip(design.plants, design.margins, strict=True)
        if plant.thrust == plant.counterweight == 1.0
    ]
    plant_rows.append(("worst case", list(design.margins)))
    lines = [f"{'loop':13}{'plant':13}{'gain up':>9}{'down':>8}{'phase':>9}{'delay':>10}{'peak S':>8}"]
    for loop in LOOPS:
        for row, (label, margins) in enumerate(plant_rows):
            loop_margins = [margin[loop] for margin in margins]
            lines.append(
                f"{loop if row == 0 else '':13}{label:13}"
                f"{min(margin.gain_up for margin in loop_margins):>9.2f}"
                f"{max(margin.gain_down for margin in loop_margins):>8.2f}"
                f"{min(margin.phase_deg for margin in loop_margins):>5.0f} deg"
                f"{1e3 * min(margin.delay_s for margin in loop_margins):>7.0f} ms"
                f"{max(margin.sensitivity for margin in loop_margins):>8.2f}"
            )
    return lines


def _flight_lines(trials: Sequence[Trial]) -> list[str]:
    """Return the outcome and step metrics of each simulated test flight as text."""
    lines = ["simulated test flights with the flight code, encoders and motor drivers:"]
    for trial in trials:
        metrics = trial.metrics
        if metrics.outcome != "completed":
            lines.append(f"  {trial.label}: {metrics.outcome}")
            continue
        lines.append(
            f"  {trial.label}: take-off {_settling_text(metrics.take_off_s)}; travel step: overshoot "
            f"{metrics.overshoot_percent:.0f} %, {_settling_text(metrics.settling_time_s)}; "
            f"sines: RMS error {metrics.travel_rms_deg:.2f} deg in travel, "
            f"{metrics.elevation_rms_deg:.2f} deg in elevation"
        )
    return lines


def _settling_text(time_s: float) -> str:
    return f"settling time {time_s:.1f} s" if math.isfinite(time_s) else "not settled"


def _json_object(result: _Result) -> dict[str, Any]:
    """Return design, margins and test flights as a JSON object."""
    from dataclasses import asdict

    plants = [
        {
            "lag_s": plant.lag_s,
            "delay_s": plant.delay_s,
            "thrust": plant.thrust,
            "counterweight": plant.counterweight,
            "margins": {loop: asdict(margin) for loop, margin in plant_margins.items()},
        }
        for plant, plant_margins in zip(result.design.plants, result.design.margins, strict=True)
    ]
    return {
        "rig": result.task.rig.name,
        "model": result.task.model_name,
        "left_out": list(result.loop_effects.excluded),
        "sensitivity": result.design.sensitivity,
        "parameters": dict(result.parameters),
        "plants": plants,
        "flights": [{"on": trial.label, **asdict(trial.metrics)} for trial in result.trials],
    }


VERB = Verb(tune, "Laboratory")
