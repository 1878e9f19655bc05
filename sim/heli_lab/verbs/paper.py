"""``heli-host paper``: reproduce the paper's bench tests, tables, gains and figures in simulation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from heli_host.data.files import save_figure
from heli_host.ui.cli.options import DEFAULT_RIG, JsonOption, SeedOption
from heli_host.ui.cli.say import data_on_stdout, say, say_files, write_result
from heli_host.ui.cli.verb import Verb

if TYPE_CHECKING:
    from heli_sim.model.plant import Plant
    from matplotlib.figure import Figure

    from heli_lab.apps.paper.experiments import PaperFlight
    from heli_lab.fit.records import Record

app = typer.Typer(
    help="Reproduce the paper's bench tests, tables, gains and figures in simulation.\n\n"
    "See `heli-host paper COMMAND --help` for options and examples.",
    no_args_is_help=True,
    rich_markup_mode="markdown",
)

RigName = Annotated[str, typer.Option("--rig", metavar="NAME|FILE", help="Simulate this rig.")]
ModelName = Annotated[
    str, typer.Option("--model", metavar="NAME", help="Simulate these equations of motion.")
]
_MODEL = "multibody"
_DPI = 130
_HEAVIER_ROTOR = "M_f"
"""Parameter that is increased by its tolerance in flights. With equal rotors, the figure of hover would show
two straight lines."""


@app.command("tables")
def tables(
    rig: RigName = DEFAULT_RIG, model: ModelName = _MODEL, seed: SeedOption = 1, json: JsonOption = None
) -> None:
    """Print Tables 2 to 5, and estimates from simulated bench tests.

    Simulates the bench tests of the paper, and fits them. This takes about a minute. No file is written
    without --json.

    Example: `heli-host paper tables --json tables.json`
    """
    from heli_host.ui.cli.live import WorkBar
    from heli_host.ui.cli.options import check_result_places

    from heli_lab.apps.paper.experiments import read_thrust
    from heli_lab.apps.paper.tables import fit_rig, fit_table, table_lines, tables_json

    check_result_places(json)
    data_on_stdout(json)
    plant = _flyable_plant(rig, model)
    # All numbers of the bar are rough shares of the time.
    with WorkBar() as bar:
        bar.show("bench tests", 0.0)
        records = _run_bench_tests(plant, seed)
        line = read_thrust(plant, seed).line()
        tables_ = []
        for place, number in enumerate(records):
            on_progress = _stage_reporter(bar.show, f"fitting Table {number}", 0.1 + 0.1 * place, 0.1)
            tables_.append(fit_table(number, plant.rig, records[number], on_progress))
        by_rig = fit_rig(plant.rig, records, line, lambda done: bar.show("fitting Table 2", 0.4 + 0.6 * done))
    say(*table_lines(line, by_rig, tables_))
    write_result(json, tables_json(plant, line, by_rig, tables_))


@app.command("gains")
def gains(rig: RigName = DEFAULT_RIG, json: JsonOption = None) -> None:
    """Check the stability of pitch and travel for each interpretation of Table 6.

    The plants are the linearised equations (30) and the linearised multibody model. No file is written
    without --json.

    Example: `heli-host paper gains`
    """
    from heli_host.ui.cli.options import check_result_places
    from heli_sim.model import model_named
    from heli_sim.rig import load_rig

    from heli_lab.apps.paper.table6 import gain_lines, verdicts

    check_result_places(json)
    data_on_stdout(json)
    loaded_rig = load_rig(rig)
    by_model = {name: verdicts(model_named(name), loaded_rig) for name in ("paper", "multibody")}
    say(*gain_lines(by_model))
    verdicts_by_model = {name: [asdict(verdict) for verdict in rows] for name, rows in by_model.items()}
    write_result(json, {"models": verdicts_by_model})


@app.command("models")
def models(rig: RigName = DEFAULT_RIG, seed: SeedOption = 1, json: JsonOption = None) -> None:
    """Compare the paper's equations with a flight of a multibody rig.

    Every model, printed and corrected, simulates the flight open loop over 2 s. The parameters are those of
    the rig file, without a fit. No file is written without --json.

    Example: `heli-host paper models`
    """
    from heli_host.ui.cli.live import WorkBar
    from heli_host.ui.cli.options import check_result_places
    from heli_sim.model import MODELS, model_named

    from heli_lab.apps.paper.experiments import fly_plan
    from heli_lab.apps.paper.tables import model_errors, model_lines

    check_result_places(json)
    data_on_stdout(json)
    plant = _flyable_plant(rig, _MODEL)
    with WorkBar() as bar:
        sine_flight = fly_plan(
            "sine",
            plant,
            "sine",
            gains=None,
            seed=seed,
            on_progress=lambda done: bar.show("flying", 0.5 * done),
        )
        bar.show("predicting", 0.5)
        errors_by_model = model_errors(
            [model_named(name) for name in sorted(MODELS)], plant.rig, sine_flight.flight
        )
    say(*model_lines(errors_by_model))
    write_result(
        json, {"models": {model_error.model: asdict(model_error) for model_error in errors_by_model}}
    )


@app.command("equations")
def equations(
    model: Annotated[
        str, typer.Argument(metavar="MODEL", help="Print this model: multibody, paper or paper_printed.")
    ] = _MODEL,
) -> None:
    """Print the equations of a model as LaTeX.

    They come from the symbols that the simulation uses. Nothing is written.

    Example: `heli-host paper equations paper_printed`
    """
    from heli_sim.model import model_named
    from heli_sim.model.latex import equations as equations_of

    for equation in equations_of(model_named(model)):
        say(*equation.text.splitlines())


@app.command("figures")
def figures(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Write the figures into this folder.")],
    rig: RigName = DEFAULT_RIG,
    model: ModelName = _MODEL,
    seed: SeedOption = 1,
) -> None:
    """Reproduce Figs. 15 to 19 and 21 to 25 of the paper.

    Figs. 21 to 25 are simulated twice. One flight has the board's default gains, the other Table 6 with P and
    I of travel exchanged. In both, the front rotor is heavier by its tolerance.

    Example: `heli-host paper figures paper-figures`
    """
    from heli_host.ui.cli.live import WorkBar
    from heli_host.ui.cli.options import check_result_places

    from heli_lab.apps.paper import figures
    from heli_lab.apps.paper.experiments import read_thrust
    from heli_lab.apps.paper.tables import TESTS_OF_TABLE, fit_table

    check_result_places(folder / "fig15.png")
    plant = _flyable_plant(rig, model)
    figure_names = []

    def write(name: str, figure: Figure) -> None:
        save_figure(figure, folder / name, dpi=_DPI)
        figure_names.append(name)

    # All numbers of the bar are rough shares of the time.
    with WorkBar() as bar:
        bar.show("bench tests", 0.0)
        write("fig15.png", figures.thrust_figure(read_thrust(plant, seed)))
        records = _run_bench_tests(plant, seed)
        for place, number in enumerate(records):
            bar.show(f"fitting Table {number}", 0.05 + 0.1 * place)
            table = fit_table(number, plant.rig, records[number])
            write(
                f"fig{TESTS_OF_TABLE[number][0].figure}.png",
                figures.bench_figure(table, records[number], plant.rig),
            )
        write("fig19.png", figures.sensitivity_figure(plant.rig))
        flights = _fly_plans(
            _with_heavier_rotor(plant), seed, lambda stage, done: bar.show(stage, 0.35 + 0.6 * done)
        )
        write("fig21.png", figures.hover_figure(flights["hover"]))
        for name, path, number in (("irregular", "irregular path", 22), ("sine", "sine path", 24)):
            write(f"fig{number}.png", figures.response_figure(flights[name], path, number))
            write(f"fig{number + 1}.png", figures.performance_figure(flights[name], path, number + 1))
    say_files(folder / name for name in figure_names)
    for name, flights_of_plan in flights.items():
        for plan_flight in flights_of_plan:
            say(f"{name}, {plan_flight.label}: {plan_flight.outcome}{_errors_text(plan_flight)}")


def _flyable_plant(rig: str, model: str) -> Plant:
    """Return a rig with a model; an IdentifyError is raised if its hover voltage differs from the paper's."""
    from heli_sim.model import model_named
    from heli_sim.model.plant import Plant
    from heli_sim.rig import load_rig

    from heli_lab.apps.paper.experiments import check_rig

    loaded_rig = load_rig(rig)
    check_rig(loaded_rig)
    return Plant(model_named(model), loaded_rig)


def _with_heavier_rotor(plant: Plant) -> Plant:
    """Return a plant whose front rotor is heavier by its tolerance."""
    from heli_sim.model.plant import Plant

    mass = plant.rig[_HEAVIER_ROTOR]
    return Plant(plant.model, plant.rig.replace(**{_HEAVIER_ROTOR: mass.value + mass.tolerance}))


def _run_bench_tests(plant: Plant, seed: int) -> dict[int, list[Record]]:
    """Run all bench tests; return their records by the number of the table that they identify."""
    from heli_lab.apps.paper.experiments import record_of, run_bench_test
    from heli_lab.apps.paper.tables import TESTS_OF_TABLE

    return {
        number: [record_of(test, run_bench_test(test, plant, seed), plant.rig) for test in tests]
        for number, tests in TESTS_OF_TABLE.items()
    }


def _fly_plans(
    plant: Plant, seed: int, on_progress: Callable[[str, float], None]
) -> dict[str, list[PaperFlight]]:
    """Fly each plan with the default gains and with Table 6; return the two flights by plan."""
    from heli_lab.apps.paper.experiments import PLANS, fly_plan

    gain_sets = (("default gains", None), ("Table 6, P and I of travel exchanged", "paper"))
    flights: dict[str, list[PaperFlight]] = {}
    for plan_number, name in enumerate(PLANS):
        for set_number, (label, gains) in enumerate(gain_sets):
            share = 1.0 / (len(PLANS) * len(gain_sets))
            earlier_share = share * (len(gain_sets) * plan_number + set_number)
            on_flight_progress = _stage_reporter(on_progress, f"flying {name}", earlier_share, share)
            flights.setdefault(name, []).append(fly_plan(name, plant, label, gains, seed, on_flight_progress))
    return flights


def _stage_reporter(
    on_progress: Callable[[str, float], None], stage: str, earlier_share: float, share: float
) -> Callable[[float], None]:
    """Return a function that takes the progress of one stage, from 0 to 1, and reports that of all stages."""
    return lambda done: on_progress(stage, earlier_share + share * done)


def _errors_text(flight: PaperFlight) -> str:
    """State the RMS errors of elevation and travel after the take-off; empty if there is no such part."""
    import numpy as np

    from heli_lab.apps.paper.figures import take_off_end_s

    error_deg = flight.error_deg[flight.flight.t_s > take_off_end_s(flight)]
    if not len(error_deg):
        return ""
    rms_deg = np.sqrt(np.mean(error_deg**2, axis=0))
    return f"; RMS error after take-off: elevation {rms_deg[0]:.2f}, travel {rms_deg[2]:.2f} deg"


VERB = Verb(app, "Laboratory")
