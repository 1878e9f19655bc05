"""``heli-host law``: check, fly, compare and export your own control law."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from heli_host.cli.say import say, say_files, say_progress
from heli_host.cli.simulated import (
    DEFAULT_RIG,
    MAX_SPEED,
    BoardOption,
    RigOption,
    SeedOption,
    sil_address,
)
from heli_host.cli.verb import Verb
from heli_host.laws import FILE_LIMIT_s

if TYPE_CHECKING:
    from heli_host.flight import Flight
    from heli_host.heli import Heli

    from heli_lab.law import Law

app = typer.Typer(no_args_is_help=True, help="Check, fly, compare and export your own control law.")

LawArgument = Annotated[
    Path, typer.Argument(metavar="LAW.py", help="Python file that defines LAW. Its code is executed.")
]
LoadTimeoutOption = Annotated[
    float,
    typer.Option("--load-timeout", metavar="SECONDS", min=0.1, help="Time limit for loading the law's file."),
]
_MAX_POLES = 4


@app.command()
def check(
    law: LawArgument,
    rig: Annotated[
        str, typer.Option("--rig", metavar="NAME|FILE", help="Rig to close the loop around.")
    ] = DEFAULT_RIG,
    rigs: Annotated[
        int, typer.Option("--rigs", min=0, help="Number of simulated rigs with random thrust and lag.")
    ] = 3,
    seed: SeedOption = 1,
    load_timeout: LoadTimeoutOption = FILE_LIMIT_s,
) -> None:
    """Report a law's cost and stability margins, and fly it in simulation.

    The simulated rigs have random thrust and rotor lag.

    Example: `heli-host law check lqi.py --rigs 5`
    """
    from heli_host.declaration import LAW_TICK_COST

    from heli_lab.law.files import load_law

    loaded = load_law(law, load_timeout)
    program = loaded.program
    spread = f", over {program.ticks} ticks" if program.ticks > 1 else ""
    say(
        f"{loaded.name}: {loaded.rate_Hz:g} Hz, {len(program.instructions)} operations, "
        f"{len(loaded.states)} states, {len(program.words)} words; at most {program.cost} instructions "
        f"per call{spread} (limit per tick: {LAW_TICK_COST})"
    )
    # Imported here so that an invalid law is refused without this delay.
    import numpy as np
    from heli_sim.rig import load_rig

    from heli_lab.law.linear import linearised
    from heli_lab.tune.plants import linear_plant

    linear = linearised(loaded, linear_plant(load_rig(rig)))
    slow = sorted(linear.poles, key=lambda pole: -pole.real)[:_MAX_POLES]
    poles = ", ".join(f"{pole.real:.2f}{pole.imag:+.2f}j" for pole in slow)
    say(f"{'stable' if linear.stable else 'UNSTABLE'} around level; slowest poles {poles} 1/s")
    for loop, gain, phase_deg in zip(
        ("collective", "differential"), linear.gain_up, linear.phase_deg, strict=True
    ):
        say(f"{loop:13} gain margin {gain:.2f}, phase margin {phase_deg:.0f} deg")
    random = np.random.default_rng(seed)
    for number in range(rigs):
        thrust, lag_s = float(random.uniform(-0.1, 0.1)), float(random.uniform(0.0, 0.1))
        thrust_effects = ";".join(f"thrust_step.{motor}={thrust:.3f}@0.001" for motor in ("front", "back"))
        address = f"sil://?rig={rig}&seed={seed + number}&effect=rotor_lag={lag_s:.3f};{thrust_effects}"
        description = f"thrust {100 * thrust:+.0f} %, lag {1e3 * lag_s:.0f} ms"
        say(f"rig {number + 1} ({description}): {_fly_trial(loaded, address, 15.0)}")


@app.command()
def fly(
    law: LawArgument,
    port: Annotated[str, typer.Option("--port", help="Serial port, or another address of a board.")] = "",
    board: BoardOption = None,
    rig: RigOption = None,
    seconds: Annotated[
        float, typer.Option("--seconds", min=1.0, max=600.0, help="Flight time with the law [s].")
    ] = 20.0,
    log: Annotated[Path | None, typer.Option("--log", metavar="FILE", help="Log to write, .mcap.")] = None,
    plan: Annotated[
        str,
        typer.Option(
            "--plan", metavar="NAME|FILE", help="Plan to fly instead of the default path, such as sine."
        ),
    ] = "",
    seed: SeedOption = 1,
    load_timeout: LoadTimeoutOption = FILE_LIMIT_s,
) -> None:
    """Fly a law on the board along a travel step and sines.

    Without --port the flight is simulated.

    Example: `heli-host law fly lqi.py --board due --log lqi.mcap`
    """
    from heli_lab.law.files import load_law

    address = port or sil_address(board=board, rig=rig, seed=seed, speed=MAX_SPEED)
    loaded = load_law(law, load_timeout)
    say(
        _fly_plan(loaded, address, plan, log, rig) if plan else _fly_trial(loaded, address, seconds, log, rig)
    )


@app.command()
def compare(
    law: Annotated[
        Path,
        typer.Argument(metavar="A", help="Law (.py, its code is executed), or flight log (.mcap, .csv)."),
    ],
    other: Annotated[
        Path | None,
        typer.Argument(
            metavar="[B]", help="Another law or log.  [default: the board's control law]", show_default=False
        ),
    ] = None,
    board: BoardOption = None,
    rig: RigOption = None,
    seconds: Annotated[
        float, typer.Option("--seconds", min=1.0, max=600.0, help="Flight time of each law [s].")
    ] = 30.0,
    seed: SeedOption = 1,
    out: Annotated[Path, typer.Option("--out", metavar="FILE.png", help="Figure of both flights.")] = Path(
        "compare.png"
    ),
    load_timeout: LoadTimeoutOption = FILE_LIMIT_s,
) -> None:
    """Compare two flight logs, or two laws along the same path in simulation.

    Prints the metrics of `heli-host plot`, and writes a figure.

    Example: `heli-host law compare lqi.mcap lqr.mcap --out both.png`
    """
    from heli_host.log.comparison import comparison_lines, comparison_numbers, write_comparison

    address = sil_address(board=board, rig=rig, seed=seed, speed=MAX_SPEED)
    flights = (
        _read_logs(law, other)
        if law.suffix != ".py"
        else _fly_both(law, other, address, seconds, load_timeout)
    )
    say(*comparison_lines(comparison_numbers(flights)))
    write_comparison(flights, out)
    say_files((out,))


@app.command()
def export(
    law: LawArgument,
    out: Annotated[Path, typer.Option("--out", metavar="FILE.c", help="File to write.")],
    load_timeout: LoadTimeoutOption = FILE_LIMIT_s,
) -> None:
    """Export a law as a C file in single precision.

    Example: `heli-host law export lqi.py --out lqi.c`
    """
    from heli_lab.law.export_c import c_source
    from heli_lab.law.files import load_law

    out.write_text(c_source(load_law(law, load_timeout)), encoding="utf-8")
    say_files((out,))


def _fly_plan(law: Law, address: str, plan: str, log: Path | None, rig: str | None) -> str:
    import heli_host
    from heli_host.cli.board import check_board_rig
    from heli_host.errors import FlightAborted
    from heli_host.fly.runner import fly as fly_plan
    from heli_host.guest_law import engage

    program = law.program
    with heli_host.connect(address) as heli:
        _say_note(heli)
        check_board_rig(heli, rig)
        summary = fly_plan(heli, plan, log_path=log, on_taken_off=lambda: engage(heli, program))
    if not summary.completed:
        raise FlightAborted(summary.outcome.removeprefix("aborted: "))
    rms = ", ".join(
        f"{axis} {error:.2f}" for axis, error in summary.rms_error_deg.items() if error is not None
    )
    return f"{law.name} flew {plan}: RMS error {rms} deg"


def _read_logs(first: Path, second: Path | None) -> dict[str, Flight]:
    from heli_host.errors import FlightDataError

    from heli_lab.law.compare import flight_of_law

    if second is None:
        raise FlightDataError("a comparison needs two logs", "give two logs, or a law (.py)")
    if first == second:
        raise FlightDataError(f"{first} is given twice", "give two different logs")
    return {str(path): flight_of_law(path) for path in (first, second)}


def _fly_both(
    first: Path, second: Path | None, address: str, seconds: float, limit_s: float
) -> dict[str, Flight]:
    from heli_lab.law.files import load_law
    from heli_lab.law.trial import try_law

    flights = {}
    laws = [load_law(path, limit_s) if path is not None else None for path in (first, second)]
    for path, law in zip((first, second), laws, strict=True):
        trial = try_law(law, address, seconds)
        name = law.name if law is not None else "the board's own"
        flights[name if name not in flights else str(path)] = trial.flight
        if trial.report is not None and trial.report.taken_over:
            say(str(trial.report))
    return flights


def _fly_trial(
    law: Law | None, address: str, seconds: float, log: Path | None = None, rig: str | None = None
) -> str:
    from heli_host.cli.board import check_board_rig

    from heli_lab.law.trial import try_law

    def check(heli: Heli) -> None:
        _say_note(heli)
        check_board_rig(heli, rig)

    return str(try_law(law, address, seconds, log, check))


def _say_note(heli: Heli) -> None:
    from heli_host.link.transport import transport_note

    if note := transport_note(heli.session.transport):
        say_progress(note)


VERB = Verb(app, "Laboratory")
