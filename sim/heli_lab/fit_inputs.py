"""Options and inputs that the verbs of fits share: rig, model and flights."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from heli_host.ui.cli.options import DEFAULT_RIG
from heli_host.ui.cli.say import say

from heli_lab.errors import IdentifyError, NotExcited, WrongSigns

if TYPE_CHECKING:
    from heli_host.data.flight import Flight
    from heli_sim.model.base import Model
    from heli_sim.rig import Rig

    from heli_lab.fit.records import Record


DEFAULT_MODEL = "multibody"

FlightsArgument = Annotated[
    list[Path], typer.Argument(metavar="FLIGHT...", help="Fit the model to these: .mcap, .csv or .csv.gz.")
]
ValidateOption = Annotated[
    list[Path] | None,
    typer.Option("--validate", metavar="FLIGHT...", help="Check the result on these other flights."),
]
KnownRigOption = Annotated[
    str,
    typer.Option(
        "--rig",
        metavar="NAME|FILE",
        help=f"Use this rig's parameters and tolerances as priors.  [default: {DEFAULT_RIG}]",
        show_default=False,
    ),
]
EquationsOption = Annotated[
    str | None,
    typer.Option(
        "--model",
        metavar="NAME",
        help=f"Use these equations of motion.  [default: the rig's, or {DEFAULT_MODEL}]",
        show_default=False,
    ),
]
OwnEffectsOption = Annotated[
    list[Path] | None,
    typer.Option(
        "--effect-file", metavar="FILE.py...", help="Add the effects of these files, and run their code."
    ),
]
FromOption = Annotated[
    list[float] | None,
    typer.Option(
        "--from",
        "--from-s",
        metavar="S...",
        help="Ignore rows before this time in s: one for all fitted flights, or one each.",
    ),
]
ToOption = Annotated[
    list[float] | None,
    typer.Option(
        "--to",
        "--to-s",
        metavar="S...",
        help="Ignore rows from this time in s on: one value or several, as for --from.",
    ),
]
GapsOption = Annotated[
    bool, typer.Option("--allow-gaps", help="Skip missing rows instead of refusing the flight.")
]
LoopRateOption = Annotated[
    float | None,
    typer.Option(
        "--loop-rate",
        metavar="HZ",
        min=1.0,
        help="Correct for a log with fewer rows per second than this control loop.",
    ),
]
SkipSignCheckOption = Annotated[
    bool, typer.Option("--skip-sign-check", help="Fit even if signs, zeros, units or motion look wrong.")
]
ReportOption = Annotated[
    Path | None,
    typer.Option("--report", metavar="DIR", help="Write an HTML report with figures into this folder."),
]


class VectorFormat(StrEnum):
    """Formats of vector graphics."""

    svg = "svg"
    pdf = "pdf"


VectorOption = Annotated[
    VectorFormat | None,
    typer.Option("--vector", help="Write each figure of the report in this format too, next to the PNG."),
]


def vector_of_report(vector: VectorFormat | None, report: Path | None) -> VectorFormat | None:
    """Return the vector format of a report's figures; raise an error if there is no report."""
    if vector is not None and report is None:
        raise IdentifyError("--vector needs a report", "add --report DIR")
    return vector


SaveRigOption = Annotated[
    Path | None, typer.Option("--save-rig", metavar="FILE", help="Write the estimated rig, TOML.")
]
SeedsOption = Annotated[
    int, typer.Option("--seeds", metavar="N", min=1, max=100, help="Fly N times, with the seeds 1 to N.")
]


@dataclass(frozen=True)
class FitInputs:
    """Rig, model and flight names of a fit."""

    rig: Rig  # Prior values and tolerances
    rig_file: str  # Name or file of the rig on the command line
    model: Model  # Equations of motion with the effects of the rig and of the command line
    labels: list[str]  # Short names of the flights to fit, then of those for validation


def fit_inputs(
    flights: Sequence[Path],
    validate: Sequence[Path],
    rig: str,
    model: str | None,
    effect_files: Sequence[Path],
    effects: Sequence[str] = (),
) -> FitInputs:
    """Read the rig and build the model of a fit."""
    from heli_sim.rig import load_rig

    from heli_lab.fit.identification import short_names

    loaded_rig = load_rig(rig)
    model_with_effects = model_of(loaded_rig, model, effect_files, effects)
    return FitInputs(loaded_rig, rig, model_with_effects, short_names([*flights, *validate]))


def model_of(
    rig: Rig, model: str | None = None, effect_files: Sequence[Path] = (), effects: Sequence[str] = ()
) -> Model:
    """Build the equations `model`, by default the rig's, with the effects of rig and command line."""
    from heli_sim.model import model_named
    from heli_sim.model.effects import effects_with

    return model_named(model or rig.model or DEFAULT_MODEL, effects_with(rig, effects, effect_files))


def input_lines(inputs: FitInputs) -> tuple[str, str]:
    """State which rig and which model a fit uses: the default may be another rig than the one that flew."""
    source = " (the default of --rig)" if inputs.rig_file == DEFAULT_RIG else ""
    name = f" ({inputs.rig.name})" if inputs.rig_file != inputs.rig.name else ""
    effects = ", ".join(effect.name for effect in inputs.model.effects)
    return (
        f"rig: {inputs.rig_file}{name}{source}",
        f"model: {inputs.model.name}{f' with {effects}' if effects else ''}",
    )


def other_rig_notes(rig: Rig, rig_file: str, flown_rigs: Mapping[str, str]) -> list[str]:
    """Name the flights that another rig flew than `rig` of `rig_file`, by the flight's label and its rig."""
    from heli_lab.fit.identification import first_rig_name

    # The log of an imported or blind flight names no rig. An identified rig has the name of its own file.
    same_rigs = {"", rig.name, first_rig_name(rig), Path(rig_file).stem}
    return [
        f"note: {label} is a flight of rig {flown_rig}, and --rig is {rig_file}"
        for label, flown_rig in flown_rigs.items()
        if flown_rig not in same_rigs
    ]


def flights_line(flights: Iterable[Mapping[str, Any]]) -> str:
    """State how many seconds of each flight were fitted, and validated on."""
    used: dict[bool, list[str]] = {True: [], False: []}
    for flight in flights:
        used[flight["role"] == "train"].append(f"{flight['flight']} ({flight['seconds_used']:.0f} s used)")
    validated = f"; validated on {', '.join(used[False])}" if used[False] else "; validated on no flight"
    return f"flights: fitted {', '.join(used[True])}{validated}"


def parts(
    from_s: Sequence[float], to_s: Sequence[float], fitted: int, validated: int
) -> list[tuple[float | None, float | None]]:
    """Assign the times of --from and --to to the flights."""
    limits_by_option = []
    for option, times in (("--from", from_s), ("--to", to_s)):
        if len(times) > 1 and len(times) not in (fitted, fitted + validated):
            raise IdentifyError(
                f"{option} has {len(times)} times for {fitted} flights to fit and {validated} to validate",
                "give one time for all flights to fit, one per flight to fit, or one per flight, those of "
                "--validate last",
            )
        limits: list[float | None] = list(times) if len(times) != 1 else [*times] * fitted
        # Flights without a time are not limited.
        limits_by_option.append(limits + [None] * (fitted + validated - len(limits)))
    spans = list(zip(*limits_by_option, strict=True))
    for start_s, stop_s in spans:
        if start_s is not None and stop_s is not None and stop_s <= start_s:
            raise IdentifyError(
                f"--from {start_s:g} is not before --to {stop_s:g}", "give an earlier --from, or a later --to"
            )
    return spans


def refuse_wrong_signs(flights: Sequence[Flight], labels: Sequence[str], rig: Rig) -> None:
    """Check signs, zeros and units of flights before a fit."""
    from heli_lab.fit.records import prepare
    from heli_lab.setup.guess.signs import wrong_signs

    for flight, label in zip(flights, labels, strict=True):
        try:
            prepare(flight, rig, label)
        except NotExcited:
            # An elevation with the wrong sign is below the table during the whole flight, which then looks
            # like one that never leaves it.
            pass
        except IdentifyError:
            # Signs of an invalid flight are undefined; the fit reports what is wrong with it.
            continue
        wrong = wrong_signs(flight, rig)
        if wrong:
            raise WrongSigns(
                f"{label}: {'; '.join(sign.description for sign in wrong)}",
                f"{'; '.join(sign.remedy for sign in wrong)} (or fit it unchanged with --skip-sign-check)",
            )


def read_parts(
    paths: Sequence[Path],
    inputs: FitInputs,
    spans: Sequence[tuple[float | None, float | None]],
    allow_gaps: bool,
    skip_sign_check: bool,
    show: Callable[[str, float], None],
) -> Iterator[Flight | Record]:
    """Read flight files, refuse wrong signs, and return the part of each flight that a fit uses."""
    from heli_host.data.log.reader import read_flight

    from heli_lab.fit.records import prepare

    show("reading", 0.0)
    # Fits do not use the extra columns, which are 80 MB for ten minutes at 1 kHz.
    flights = [replace(read_flight(path, allow_gaps=allow_gaps), extra={}) for path in paths]
    flown_rigs = {
        label: flight.meta.get("rig", "") for label, flight in zip(inputs.labels, flights, strict=True)
    }
    say(*other_rig_notes(inputs.rig, inputs.rig_file, flown_rigs))
    if not skip_sign_check:
        show("checking signs and zeros", 0.0)
        refuse_wrong_signs(flights, inputs.labels, inputs.rig)
    # Flights are passed on one by one, and no list keeps them in memory: ten minutes at 1 kHz take 45 MB.
    flights.reverse()
    return (
        # The fit itself prepares a whole flight.
        flights.pop()
        if start_s is None and stop_s is None
        else prepare(flights.pop(), inputs.rig, label, start_s=start_s, stop_s=stop_s)
        for label, (start_s, stop_s) in zip(inputs.labels, spans, strict=True)
    )
