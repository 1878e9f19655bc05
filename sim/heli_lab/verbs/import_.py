"""``heli-host import``: convert log files of other programs into flights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from heli_host.data.files import FORCE, write_signed
from heli_host.errors import FlightDataError
from heli_host.ui.cli.options import JsonOption
from heli_host.ui.cli.say import data_on_stdout, say, say_files, write_result
from heli_host.ui.cli.verb import Verb

if TYPE_CHECKING:
    from heli_host.data.tables import Profile, Table
    from heli_sim.rig import Rig

    from heli_lab.setup.guess import Ambiguity, Guess
    from heli_lab.setup.guess.files import Target


def import_(
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILE...",
            help="Convert text, .mat, .npz, .json, .parquet, .mcap, .bag, .xlsx or bag folders.",
        ),
    ],
    profile: Annotated[
        Path | None,
        typer.Option(
            "--profile",
            metavar="FILE",
            help="Assign the columns by this TOML file, and guess the rest with --guess.",
        ),
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
            "--rate", metavar="HZ", min=1.0, help="Use this sampling rate in Hz, and no times of the files."
        ),
    ] = None,
    one_flight: Annotated[
        bool,
        typer.Option("--one-flight", help="Merge all files into one flight, such as angles and voltages."),
    ] = False,
    force: Annotated[
        bool,
        typer.Option(
            "--force", help="Write the flights even if the guess is unsure, and replace files of others."
        ),
    ] = False,
    json: JsonOption = None,
) -> None:
    """Convert logs of other programs into flights by a given or guessed profile.

    A guess that is certain writes the flights, the profile and a figure. Otherwise the guess lists what is
    not certain, and writes only profile and figure. Correct the profile, and give it with --profile. With
    --guess and --profile, the entries of the profile stay, and the rest is guessed.

    Example: `heli-host import lab1.mat lab2.mat --guess --rig quanser-course -o flights/lab`
    """
    from heli_host.data.tables import read_profile
    from heli_sim.rig import load_rig

    if profile is None and not guess:
        raise typer.BadParameter("import needs --profile or --guess; give one of them")
    data_on_stdout(json)
    if force:
        FORCE.set(True)
    known_rig = load_rig(rig) if rig is not None else None
    sources = _read_sources(files, output, one_flight=one_flight)
    if not guess and profile is not None:
        given_profile = read_profile(profile)
        if rate is not None:
            given_profile = replace(given_profile, time="", rate_Hz=rate)
        write_result(json, _write_flights(sources, given_profile))
        return
    guesses = _guess_profiles([source.table for source in sources], known_rig, rate, profile)
    # All files are from one program, and have the same profile.
    best = guesses[0]
    ambiguities = sorted(best.ambiguities, key=lambda ambiguity: ambiguity.danger)
    profile_path, profile_lines = _write_profile(best, ambiguities, output)
    output_files = [profile_path]
    for source, file_guess in zip(sources, guesses, strict=True):
        output_files.append(_draw_evidence(file_guess, source.table, output / f"{source.target.name}.png"))
        say(f"{source.path.name}: {'sure' if file_guess.sure else 'unsure'}")
    _say_reasons(best, ambiguities, profile_path, profile_lines)
    say_files(output_files)
    sentence_by_subject = {ambiguity.subject: ambiguity.sentence() for ambiguity in ambiguities}
    content = {
        "sure": not ambiguities,
        "ambiguities": sentence_by_subject,
        "evidence": {
            str(source.path): file_guess.evidence for source, file_guess in zip(sources, guesses, strict=True)
        },
        "files": [str(path) for path in output_files],
    }
    if ambiguities and not force:
        write_result(json, {**content, "flights": [], "rows": []})
        from heli_lab.errors import UnsureGuess

        raise UnsureGuess(
            f"unsure of {', '.join(sentence_by_subject)}: no flight was written",
            f"correct {profile_path} and import with --profile, or use it unchanged with --force",
        )
    write_result(json, {**content, **_write_flights(sources, best.profile)})


@dataclass(frozen=True)
class _Source:
    """A file to import, its table, and the place of its flights."""

    path: Path
    table: Table
    target: Target


def _read_sources(files: Sequence[Path], output: Path, *, one_flight: bool) -> list[_Source]:
    """Read the files, and create the `output` folder; with `one_flight`, merge all tables into one source.

    A flight in the folder that was imported from another file is an error.
    """
    from heli_host.data.tables import read_table

    from heli_lab.setup.guess.files import Target, digest, output_names

    tables = [read_table(path) for path in files]
    names = output_names(files)
    digests = [digest([path]) for path in files]
    if one_flight:
        from heli_lab.setup.guess import merge_tables

        merged = merge_tables(tables)
        if merged.notes:
            say(merged.notes)
        files, tables, names, digests = files[:1], [merged], names[:1], [digest(files)]
    output.mkdir(parents=True, exist_ok=True)
    sources = [
        _Source(path, table, Target(output, name, sha))
        for path, table, name, sha in zip(files, tables, names, digests, strict=True)
    ]
    for source in sources:
        source.target.refuse_to_replace_another()
    return sources


def _guess_profiles(
    tables: Sequence[Table], rig: Rig | None, rate_Hz: float | None, profile: Path | None
) -> Sequence[Guess]:
    """Guess the profile of each table with a progress bar; the entries of a given `profile` stay."""
    from heli_host.ui.cli.live import WorkBar

    from heli_lab.setup.guess import guess_by_rigs
    from heli_lab.setup.guess.result import NOTHING_KNOWN, read_known

    given_entries = read_known(profile) if profile is not None else NOTHING_KNOWN
    with WorkBar() as bar:
        return guess_by_rigs(
            tables, rig, rate_Hz, given_entries, lambda share: bar.show("guessing", share)
        ).guesses


def _write_profile(
    best: Guess, ambiguities: Sequence[Ambiguity], folder: Path
) -> tuple[Path, dict[str, int]]:
    """Write ``profile.toml`` with ambiguities and evidence as comments."""
    from heli_host.data.tables import profile_text

    from heli_lab.setup.guess.files import entry_lines

    path = folder / "profile.toml"
    warnings = [f"UNSURE: {ambiguity.sentence()}" for ambiguity in ambiguities]
    comments = [f"# {line}" for line in (*warnings, *best.evidence)]
    text = "\n".join([*comments, "", profile_text(best.profile)])
    write_signed(path, text)
    return path, entry_lines(text)


def _say_reasons(
    best: Guess, ambiguities: Sequence[Ambiguity], profile_path: Path, profile_lines: dict[str, int]
) -> None:
    """Print the evidence for a profile, and each ambiguity with the line of its entry in the file."""
    say(*(f"  {sentence}" for sentence in best.evidence))
    for ambiguity in ambiguities:
        say(ambiguity.sentence())
        if line := profile_lines.get(ambiguity.entry):
            say(f"  {profile_path}:{line}: {ambiguity.entry}")


def _draw_evidence(guess: Guess, table: Table, path: Path) -> Path:
    """Draw the longest flight of a table with its guessed profile; return the figure's path."""
    from heli_host.data.tables import flights_of

    from heli_lab.setup.guess.figure import draw

    return draw(guess, max(flights_of(table, guess.profile), key=len), path)


def _write_flights(sources: Sequence[_Source], profile: Profile) -> dict[str, Any]:
    """Write each flight of the sources as CSV; return the flights, and the changed rows of each source, for
    JSON.
    """
    from heli_host.data.flight import check_flight
    from heli_host.data.log.table import write_csv
    from heli_host.data.tables import convert

    flight_objects: list[dict[str, Any]] = []
    row_objects: list[dict[str, Any]] = []
    for source in sources:
        conversion = convert(source.table, profile)
        flights = conversion.flights
        for number, flight in enumerate(flights, 1):
            try:
                check_flight(flight, source.table.source)
            except FlightDataError as error:
                # The numbers are in the units of the profile, so a unit or a column is wrong.
                used = [
                    f"{role} from '{each.column}' in {each.unit}" for role, each in profile.angles.items()
                ]
                used += [
                    f"{role} from '{each.column}' in {each.unit}" for role, each in profile.voltages.items()
                ]
                raise FlightDataError(
                    f"{error.cause}; the profile takes {', '.join(used)}",
                    "correct the column or the unit in the profile",
                ) from error
            path = source.target.path(number if len(flights) > 1 else None)
            write_csv(source.target.with_digest(flight), path)
            say(f"{len(flight)} rows, {flight.duration_s:.1f} s at {1.0 / flight.step_s:.0f} Hz -> {path}")
            for note in ("cut", "filled"):
                if note in flight.meta:
                    say(f"  {note}: {flight.meta[note]}")
            flight_objects.append({"file": str(path), "rows": len(flight), "duration_s": flight.duration_s})
        say(f"{source.path.name}: {conversion.file_rows} rows in the file")
        say(*(f"  {change.sentence()}" for change in conversion.changes))
        if conversion.unexplained_rows:
            say(f"  {conversion.unexplained_rows:+d} rows for an unknown reason; please report this")
        row_objects.append(
            {
                "file": str(source.path),
                "rows": conversion.file_rows,
                "changes": [asdict(change) for change in conversion.changes],
            }
        )
    return {"flights": flight_objects, "rows": row_objects}


VERB = Verb(import_, "Logs", variadic=False)
