"""``heli-host law``: check, fly, compare, grade and export control laws."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from heli_host.board.law_program import FILE_LIMIT_s
from heli_host.data.files import write_signed
from heli_host.ui.cli.flight import FlightOptions
from heli_host.ui.cli.options import DEFAULT_RIG, MAX_SPEED, EffectOption, JsonOption, SeedOption
from heli_host.ui.cli.say import data_on_stdout, say, say_files, write_result
from heli_host.ui.cli.verb import Verb, with_option_groups

from heli_lab.fit_inputs import ReportOption, SeedsOption

if TYPE_CHECKING:
    from heli_host.board.law_program import LawProgram
    from heli_host.data.flight import Flight

    from heli_lab.control.law_flight import LawTrial
    from heli_lab.control.linear_law import LinearisedLaw

app = typer.Typer(
    no_args_is_help=True,
    help="Check, fly, compare, grade and export control laws.\n\n"
    "See `heli-host law COMMAND --help` for options and examples.",
    rich_markup_mode="markdown",
)

LawArgument = Annotated[
    Path, typer.Argument(metavar="LAW.py", help="Load LAW from this Python file, and run its code.")
]
LoadTimeoutOption = Annotated[
    float,
    typer.Option("--load-timeout", metavar="S", min=0.1, help="Stop loading the law after this time in s."),
]
DurationOption = Annotated[
    float,
    typer.Option("--duration", metavar="S", min=1.0, max=600.0, help="Fly each law for this time in s."),
]
GradedPlanOption = Annotated[
    str | None,
    typer.Option(
        "--plan",
        metavar="NAME|FILE",
        help="Fly this plan, such as sine.  [default: a travel step, then sines]",
        show_default=False,
    ),
]
_MAX_POLES = 4
"""Number of poles that `law check` prints."""
TAKEN_OVER = "taken over"
_LINEAR_V = 0.2
"""Largest difference from the linear law up to which poles and margins describe a law [V]: a twentieth of the
voltage that carries the arm. Saturations and dead zones outside of small errors stay below it."""
_MIN_LOGS = 2
_CHECK_s = 15.0
"""Flight time with the law on each rig of `law check` [s]."""


@app.command()
def check(
    law: LawArgument,
    rig: Annotated[
        str, typer.Option("--rig", metavar="NAME|FILE", help="Close the loop around this rig.")
    ] = DEFAULT_RIG,
    rigs: Annotated[
        int, typer.Option("--rigs", min=0, help="Fly on this many rigs with random thrust and lag.")
    ] = 3,
    seed: SeedOption = 1,
    load_timeout: LoadTimeoutOption = FILE_LIMIT_s,
    json: JsonOption = None,
) -> None:
    """Report a control law's cost and stability margins, and fly it in simulation.

    The simulated rigs have random thrust and rotor lag. The code of the file runs with your rights. No real
    board is used, and no file is written without --json. The exit code is 1 if the loop is not stable, or the
    board had to take over.

    Example: `heli-host law check lqi.py --rigs 5`
    """
    from heli_host.declaration import LAW_TICK_COST

    from heli_lab.control.law_files import load_law

    data_on_stdout(json)
    control_law = load_law(law, load_timeout, rig)
    program = control_law.program
    tick_text = f", over {program.ticks} ticks" if program.ticks > 1 else ""
    say(
        f"{control_law.name}: {control_law.rate_Hz:g} Hz, {len(program.instructions)} operations, "
        f"{len(control_law.states)} states, {len(program.words)} words; at most {program.cost} instructions "
        f"per call{tick_text} (limit per tick: {LAW_TICK_COST})"
    )
    # Imported here so that an invalid law is refused without this delay.
    from heli_sim.rig import load_rig

    from heli_lab.control.linear_law import linearised
    from heli_lab.control.tune.loops import linear_plant

    linear = linearised(control_law, linear_plant(load_rig(rig)))
    say(*_stability_lines(linear))
    trials = _fly_random_rigs(program, rig, rigs, seed)
    problems = _problems(linear, trials)
    write_result(
        json,
        {
            "law": control_law.name,
            "rate_Hz": control_law.rate_Hz,
            "operations": len(program.instructions),
            "cost": program.cost,
            "stable": linear.stable,
            "poles": [[pole.real, pole.imag] for pole in linear.poles],
            "gain_margin": list(linear.gain_up),
            "phase_margin_deg": list(linear.phase_deg),
            "linear_within_V": linear.nonlinearity_V,
            "trials": trials,
            "problems": problems,
        },
    )
    if problems:
        say(*(f"problem: {problem}" for problem in problems))
        raise typer.Exit(1)


@app.command()
@with_option_groups()
def fly(
    law: LawArgument,
    plan: GradedPlanOption = None,
    duration_s: DurationOption = 20.0,
    *,
    options: FlightOptions,
    load_timeout: LoadTimeoutOption = FILE_LIMIT_s,
) -> None:
    """Fly a control law on the board, along a travel step and sines.

    The board takes off and lands with its own control law. If the flight fails, that law takes over, and the
    exit code is 4. Options and files are those of `heli-host fly`. --duration applies only without --plan.
    The code of the file runs with your rights.

    Example: `heli-host law fly lqi.py --sil --board due --log lqi.mcap`
    """
    from heli_host.fly.plan import load_plan
    from heli_host.ui.cli.board import check_target

    from heli_lab.control.law_files import load_law
    from heli_lab.control.law_flight import fly_law, trial_plan

    check_target(options.port, options.sil)
    flown_plan = load_plan(plan) if plan is not None else trial_plan(duration_s)
    control_law = load_law(law, load_timeout, options.rig)
    flight_result, trial = fly_law(control_law.program, options, flown_plan, plan or "")
    flight_result.report()
    say(f"law {control_law.name}: {trial}")
    flight_result.write(law=control_law.name, trial=trial.as_dict())
    flight_result.raise_if_not_completed()


@app.command()
@with_option_groups(without=("blind", "twin", "on_alarm", "foxglove", "log", "json", "figure"))
def compare(
    compared: Annotated[
        list[Path],
        typer.Argument(
            metavar="A [B...]",
            help="Compare .py laws or .mcap, .csv logs. One law is compared with the board's.",
        ),
    ],
    duration_s: DurationOption = 30.0,
    *,
    options: FlightOptions,
    json: JsonOption = None,
    figure: Annotated[
        Path, typer.Option("--figure", metavar="FILE", help="Draw the flights: .png, .pdf or .svg.")
    ] = Path("compare.png"),
    load_timeout: LoadTimeoutOption = FILE_LIMIT_s,
) -> None:
    """Compare flight logs, or control laws along the same path.

    Prints the metrics of `heli-host plot`, and draws a figure. From nine flights on, it draws several
    figures, each with the first flight. Runs the code in the files of laws. Control laws need --sil or
    --port, logs do not.

    Example: `heli-host law compare lqi.mcap lqr.mcap --figure both.png`
    """
    from heli_host.data.log.comparison import comparison_lines, comparison_numbers, write_comparisons
    from heli_host.errors import FlightAborted
    from heli_host.ui.cli.board import check_target
    from heli_host.ui.cli.options import check_result_places

    check_result_places(json, figure=figure)
    law_count = sum(path.suffix == ".py" for path in compared)
    if 0 < law_count < len(compared):
        raise typer.BadParameter("laws and logs do not compare; give only laws (.py), or only logs")
    are_laws = law_count > 0
    if are_laws:
        check_target(options.port, options.sil)
    data_on_stdout(json)
    flights = _fly_laws(compared, options, duration_s, load_timeout) if are_laws else _read_logs(compared)
    numbers = comparison_numbers(flights)
    figures = write_comparisons(flights, figure)
    result = {"flights": numbers, "figure": str(figure), "figures": [str(file) for file in figures]}
    if not write_result(json, result):
        say(*comparison_lines(numbers, flights))
    say_files(figures)
    taken_over = [label for label in flights if label.endswith(f"({TAKEN_OVER})")]
    if taken_over:
        raise FlightAborted(
            f"the board took over from {len(taken_over)} of {len(flights)} laws",
            "look at the reasons above, or try one with heli-host law check",
        )


@app.command()
def grade(
    laws: Annotated[
        list[Path],
        typer.Argument(metavar="LAW.py...", help="Grade these laws. Each file's code is run behind limits."),
    ],
    rig: Annotated[
        list[str] | None,
        typer.Option(
            "--rig",
            metavar="NAME|FILE",
            help=f"Fly on this rig. Repeatable.  [default: {DEFAULT_RIG}]",
            show_default=False,
        ),
    ] = None,
    effect: EffectOption = None,
    seeds: SeedsOption = 3,
    plan: GradedPlanOption = None,
    duration_s: DurationOption = 30.0,
    report: ReportOption = None,
    json: JsonOption = None,
    load_timeout: LoadTimeoutOption = FILE_LIMIT_s,
) -> None:
    """Grade control laws on the same plan, simulated rigs and seeds.

    The board's own control law is the first row. --duration applies only without --plan. Each file has limits
    of processor time and memory (1 GB), and may not write files, open sockets or start processes. A law that
    depends on the rig is designed for the first rig. The exit code is 4 if the board refused a law, or had to
    take over from it.

    Example: `heli-host law grade lqi.py lqr.py --seeds 5 --report grades`
    """
    from heli_host.errors import BadLaw, FlightAborted
    from heli_host.fly.plan import load_plan
    from heli_host.ui.cli.options import check_result_places
    from heli_sim.rig import load_rig

    from heli_lab.apps.classroom.grade import REFERENCE, LawGrade, grade_lines
    from heli_lab.apps.classroom.grade import grade as grade_law
    from heli_lab.control.fence import FileLimits
    from heli_lab.control.law_files import check_files, load_limited
    from heli_lab.control.law_flight import fly_trial, trial_plan
    from heli_lab.control.tune.loops import linear_plant

    check_result_places(json, report=report)
    data_on_stdout(json)
    # A wrong name is the user's mistake, not a law that fails.
    check_files(laws)
    graded_plan = load_plan(plan) if plan is not None else trial_plan(duration_s)
    rigs = rig or [DEFAULT_RIG]
    plant = linear_plant(load_rig(rigs[0]))
    flights = list(itertools.product(rigs, range(1, seeds + 1)))

    def fly_on(program: LawProgram | None, name: str, seed: int) -> LawTrial:
        options = FlightOptions(sil=True, rig=name, seed=seed, speed=MAX_SPEED, effect=effect)
        return fly_trial(program, options, graded_plan)

    grades = [grade_law(REFERENCE, None, flights, fly_on)]
    for path in laws:
        # Two laws with the same file name have their paths as labels.
        label = path.stem if path.stem not in {law_grade.label for law_grade in grades} else str(path)
        try:
            program = load_limited(path, FileLimits(load_timeout), rigs[0])
        except BadLaw as error:
            grades.append(LawGrade(label, str(error)))
            continue
        grades.append(grade_law(label, program, flights, fly_on, plant))
    content: dict[str, Any] = {
        "plan": graded_plan.title,
        "rigs": rigs,
        "seeds": list(range(1, seeds + 1)),
        "effects": list(effect or ()),
        "grades": [law_grade.as_dict() for law_grade in grades],
    }
    if not write_result(json, content):
        say(*grade_lines(grades))
    page = None
    if report is not None:
        from heli_lab.apps.classroom.grade import write_grades

        page = write_grades(grades, content, report)
    say_files((json, page))
    incomplete_laws = [law_grade.label for law_grade in grades[1:] if not law_grade.passed]
    if incomplete_laws:
        names = ", ".join(incomplete_laws)
        raise FlightAborted(
            f"{len(incomplete_laws)} of {len(laws)} laws did not fly to the end: {names}",
            "look at the reasons above, or try one with heli-host law check",
        )


@app.command()
def export(
    law: LawArgument,
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="FILE.c", help="Write the C code to this file.")
    ],
    rig: Annotated[
        str | None,
        typer.Option("--rig", metavar="NAME|FILE", help="Design the law for this rig.", show_default=False),
    ] = None,
    load_timeout: LoadTimeoutOption = FILE_LIMIT_s,
) -> None:
    """Export a control law as a C file in single precision.

    The C code needs no library. The code of LAW.py is run.

    Example: `heli-host law export lqi.py -o lqi.c`
    """
    from heli_lab.control.law import c_source
    from heli_lab.control.law_files import load_law

    write_signed(output, c_source(load_law(law, load_timeout, rig)))
    say_files((output,))


def _stability_lines(linear: LinearisedLaw) -> list[str]:
    """Describe the slowest poles and the margins of both loops, as text."""
    slowest_poles = sorted(linear.poles, key=lambda pole: -pole.real)[:_MAX_POLES]
    poles = ", ".join(f"{pole.real:.2f}{pole.imag:+.2f}j" for pole in slowest_poles)
    lines = [f"{'stable' if linear.stable else 'NOT STABLE'} around level; slowest poles {poles} 1/s"]
    if linear.nonlinearity_V > _LINEAR_V:
        lines.append(
            "the law is not linear, and poles and margins do not describe it: at small errors its voltages "
            f"differ by {linear.nonlinearity_V:.2g} V from the linear law"
        )
    if not linear.stable:
        return lines
    loops = zip(("collective", "differential"), linear.gain_up, linear.phase_deg, strict=True)
    for loop, gain, phase_deg in loops:
        lines.append(f"{loop:13} gain margin {gain:.2f}, phase margin {phase_deg:.0f} deg")
    return lines


def _problems(linear: LinearisedLaw, trials: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return why a law must not fly, one line per reason; none if the check found no problem."""
    problems = []
    if not linear.stable:
        slowest = max(linear.poles, key=lambda pole: pole.real)
        problems.append(
            f"the pole at {slowest.real:.3g}{slowest.imag:+.3g}j 1/s does not decay: check the signs of the "
            "gains, and that the law uses all three axes"
        )
    reasons = [trial["taken_over"] for trial in trials if trial["taken_over"]]
    if reasons:
        problems.append(
            f"the board's own law had to take over on {len(reasons)} of {len(trials)} rigs: {reasons[0]}"
        )
    return problems


def _fly_random_rigs(program: LawProgram, rig: str, count: int, seed: int) -> list[dict[str, Any]]:
    """Fly a control law on simulated rigs with random thrust and rotor lag; return their JSON objects."""
    import numpy as np

    from heli_lab.control.law_flight import fly_trial, trial_plan

    random = np.random.default_rng(seed)
    trials: list[dict[str, Any]] = []
    for number in range(count):
        thrust, lag_s = float(random.uniform(-0.1, 0.1)), float(random.uniform(0.0, 0.1))
        thrust_effects = [f"thrust_step.{motor}={thrust:.3f}@0.001" for motor in ("front", "back")]
        options = FlightOptions(
            sil=True,
            rig=rig,
            seed=seed + number,
            speed=MAX_SPEED,
            effect=[f"rotor_lag={lag_s:.3f}", *thrust_effects],
        )
        trial = fly_trial(program, options, trial_plan(_CHECK_s))
        description = f"thrust {100 * thrust:+.0f} %, lag {1e3 * lag_s:.0f} ms"
        say(f"rig {number + 1} ({description}): {trial}")
        trials.append({"thrust": 1.0 + thrust, "lag_s": lag_s, **trial.as_dict()})
    return trials


def _read_logs(paths: Sequence[Path]) -> dict[str, Flight]:
    """Read two or more different logs; return their flights by path."""
    from heli_host.errors import FlightDataError

    from heli_lab.control.law_flight import flight_of_law

    if len(paths) < _MIN_LOGS:
        raise FlightDataError("a comparison needs two logs", "give two logs, or a law (.py)")
    for number, path in enumerate(paths):
        if path in paths[:number]:
            raise FlightDataError(f"{path} is given twice", "give different logs")
    return {str(path): flight_of_law(path) for path in paths}


def _fly_laws(
    paths: Sequence[Path], options: FlightOptions, duration_s: float, limit_s: float
) -> dict[str, Flight]:
    """Fly the trial plan with each control law; a single law is compared with the board's own.

    Returns the flights by the name of the law, or by its path if another law has the same name.
    """
    from heli_lab.apps.classroom.grade import REFERENCE
    from heli_lab.control.law_files import load_law
    from heli_lab.control.law_flight import fly_trial, trial_plan

    # All files are loaded before the first flight. None is the board's own control law.
    programs: dict[str, LawProgram | None] = {}
    for path in paths:
        law = load_law(path, limit_s, options.rig)
        label = law.name if law.name not in programs else str(path)
        programs[label] = law.program
    if len(paths) == 1:
        programs[REFERENCE] = None
    flights: dict[str, Flight] = {}
    for label, program in programs.items():
        trial = fly_trial(program, options, trial_plan(duration_s))
        # The label appears in the figure, whose curve ends at the takeover.
        flights[f"{label} ({TAKEN_OVER})" if trial.taken_over else label] = trial.flight
        if trial.taken_over:
            say(f"law {label}: the board's control law took over: {trial.taken_over}")
    return flights


VERB = Verb(app, "Laboratory")
