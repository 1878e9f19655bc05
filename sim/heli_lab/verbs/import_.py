"""``heli-host import``: convert log files of other programs into flights."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from heli_host.cli.options import JsonOption
from heli_host.cli.say import data_on_stdout, say, say_files, write_result
from heli_host.cli.verb import Verb

if TYPE_CHECKING:
    from heli_host.tables import Profile, Table
    from heli_sim.rig import Rig

    from heli_lab.guess import Guess


def import_(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILE...", help="Convert text, .mat, .parquet, .mcap, .bag, .xlsx or bag folders."
        ),
    ],
    profile: Annotated[
        Path | None, typer.Option("--profile", metavar="FILE", help="Assign the columns by this TOML file.")
    ] = None,
    guess: Annotated[
        bool, typer.Option("--guess", help="Propose the profile from names, ranges and physics.")
    ] = False,
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="DIR", help="Write flights and profile here.")
    ] = Path("imported"),
    rig: Annotated[
        str | None,
        typer.Option(
            "--rig",
            metavar="NAME|FILE",
            help="Use this rig.  [default: the shipped rig that fits best]",
            show_default=False,
        ),
    ] = None,
    rate: Annotated[
        float | None,
        typer.Option(
            "--rate", metavar="HZ", min=1.0, help="Assume this sampling rate in Hz for files without times."
        ),
    ] = None,
    one_flight: Annotated[
        bool,
        typer.Option(
            "--one-flight",
            help="Merge all files into one flight, such as angles and voltages.",
        ),
    ] = False,
    force: Annotated[
        bool, typer.Option("--force", help="Write the flights even if the guess is unsure.")
    ] = False,
    json: JsonOption = None,
) -> None:
    """Convert logs of other programs into flights by a given or guessed profile.

    A sure guess writes the flights, the profile and a figure. An unsure guess lists its ambiguities, and
    writes only profile and figure. Correct the profile, and give it with --profile.

    Example: `heli-host import lab1.mat lab2.mat --guess --rig quanser-course -o flights/lab`
    """
    from heli_host.tables import read_profile, read_table
    from heli_sim.rig import load_rig

    if (profile is None) == (not guess):
        raise typer.BadParameter("import needs exactly one of --profile and --guess; give one")
    data_on_stdout(json)
    known = load_rig(rig) if rig is not None else None
    tables = [read_table(path) for path in files]
    if one_flight:
        from heli_lab.guess import merge_tables

        tables, files = [merge_tables(tables)], files[:1]
    output.mkdir(parents=True, exist_ok=True)
    if profile is not None:
        write_result(json, {"flights": _write_flights(tables, read_profile(profile), output)})
        return
    guesses = _guesses(tables, known, rate)
    best = min(guesses, key=lambda candidate: len(candidate.ambiguities))
    ambiguities = {
        ambiguity.subject: ambiguity.sentence()
        for candidate in guesses
        for ambiguity in candidate.ambiguities
    }
    ambiguities |= _differing(guesses, best, files)
    written = _write_profile(best, list(ambiguities.values()), output)
    for path, file_guess, table in zip(files, guesses, tables, strict=True):
        written.append(_draw(file_guess, table, output / f"{_stem(path)}.png"))
        say(f"{path.name}: {'sure' if file_guess.sure else 'unsure'}")
        for sentence in file_guess.evidence:
            say(f"  {sentence}")
    for sentence in ambiguities.values():
        say(sentence)
    say_files(written)
    content = {
        "sure": not ambiguities,
        "ambiguities": ambiguities,
        "evidence": {str(path): guess.evidence for path, guess in zip(files, guesses, strict=True)},
        "files": [str(path) for path in written],
    }
    if ambiguities and not force:
        write_result(json, {**content, "flights": []})
        from heli_lab.errors import UnsureGuess

        raise UnsureGuess(
            f"unsure of {', '.join(ambiguities)}: no flight was written",
            f"correct {output / 'profile.toml'} and import with --profile, or use it unchanged with --force",
        )
    write_result(json, {**content, "flights": _write_flights(tables, best.profile, output)})


def _guesses(tables: Sequence[Table], rig: Rig | None, rate_Hz: float | None) -> Sequence[Guess]:
    from heli_host.cli.progress_bar import WorkBar

    from heli_lab.guess import guess_by_rigs

    with WorkBar() as bar:
        return guess_by_rigs(tables, rig, rate_Hz, lambda share: bar.show("guessing", share)).guesses


def _differing(guesses: Sequence[Guess], best: Guess, files: Sequence[Path]) -> dict[str, str]:
    """Report the files whose guessed profile differs from the best one."""
    from dataclasses import replace

    differing = {}
    for guess, path in zip(guesses, files, strict=True):
        if replace(guess.profile, about="") != replace(best.profile, about=""):
            differing[f"one profile for all: {path.name}"] = (
                f"unsure of one profile for all: the profile guessed from {path.name} alone differs; "
                "import it alone to see the difference"
            )
    return differing


def _write_profile(best: Guess, ambiguities: Sequence[str], out: Path) -> list[Path]:
    from heli_host.tables import profile_text

    target = out / "profile.toml"
    lines = [
        f"# {line}\n" for line in (*(f"UNSURE: {ambiguity}" for ambiguity in ambiguities), *best.evidence)
    ]
    target.write_text("".join(lines) + "\n" + profile_text(best.profile), encoding="utf-8")
    return [target]


def _draw(guess: Guess, table: Table, path: Path) -> Path:
    from heli_host.tables import flights_of

    from heli_lab.guess.figure import draw

    return draw(guess, max(flights_of(table, guess.profile), key=len), path)


def _write_flights(tables: Sequence[Table], profile: Profile, out: Path) -> list[dict[str, Any]]:
    from heli_host.flight import check
    from heli_host.log.table import write_csv
    from heli_host.tables import flights_of

    written: list[dict[str, Any]] = []
    for table in tables:
        flights = flights_of(table, profile)
        for number, flight in enumerate(flights, 1):
            check(flight, table.source)
            stem = _stem(Path(table.source))
            target = out / (f"{stem}.csv" if len(flights) == 1 else f"{stem}-{number}.csv")
            write_csv(flight, target)
            say(f"{len(flight)} rows, {flight.duration_s:.1f} s at {1.0 / flight.step_s:.0f} Hz -> {target}")
            written.append({"file": str(target), "rows": len(flight), "duration_s": flight.duration_s})
    return written


def _stem(path: Path) -> str:
    return path.name.removesuffix(".gz").rpartition(".")[0] or path.name


VERB = Verb(import_, "Logs", variadic=False)
