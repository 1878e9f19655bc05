"""``heli-host twin``: whether the rig is still the rig, and if not, since when and what changed."""

from __future__ import annotations

import math
import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from heli_host.cli.say import say, say_files
from heli_host.cli.simulated import DEFAULT_RIG
from heli_host.cli.verb import Verb
from heli_host.twins import HOURS

if TYPE_CHECKING:
    from heli_lab.twin.files import TwinRig
    from heli_lab.twin.follow import Followed


def twin(
    flights: Annotated[
        list[Path] | None, typer.Argument(metavar="[FLIGHT...]", help="Flights: .mcap, .csv or .csv.gz.")
    ] = None,
    rig: Annotated[
        str,
        typer.Option(
            "--rig",
            metavar="NAME|FILE",
            help=f"The rig, with its effects, or a file of --learn.  [default: {DEFAULT_RIG}]",
            show_default=False,
        ),
    ] = DEFAULT_RIG,
    healthy: Annotated[
        list[Path] | None,
        typer.Option(
            "--healthy", metavar="FLIGHT...", help="Flights in which nothing changed: they tell the weather."
        ),
    ] = None,
    learn: Annotated[
        Path | None,
        typer.Option(
            "--learn",
            metavar="FILE",
            help="Simulate healthy flights of this rig, set the alarm by them, and write it down: "
            "a twin's file, for --rig and for --twin of page and fly.",
        ),
    ] = None,
    hours: Annotated[
        float,
        typer.Option("--hours", metavar="H", min=0.01, help="Free flight with one false alarm on average."),
    ] = HOURS,
    start_s: Annotated[
        float | None, typer.Option("--from", "--from-s", metavar="S", help="Nothing before this time.")
    ] = None,
    stop_s: Annotated[
        float | None, typer.Option("--to", "--to-s", metavar="S", help="Nothing from this time on.")
    ] = None,
    json: Annotated[Path | None, typer.Option("--json", metavar="FILE", help="All numbers.")] = None,
    figure: Annotated[
        Path | None, typer.Option("--figure", metavar="FILE", help="The evidence: .png, .pdf or .svg.")
    ] = None,
) -> None:
    """Fly a model of the rig beside flights, say when the two part, and what changed.

    The same alarms at the same ticks as live, with `heli-host page --twin` or `heli-host fly --twin`.

    Example: `heli-host twin flight.mcap --rig my-rig.toml --healthy monday.mcap`
    """
    # Matrices here are small: more threads only wait for each other.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from heli_host.cli.outputs import check_result_places
    from heli_host.cli.progress_bar import WorkBar
    from heli_host.log.flight_file import read_flight

    from heli_lab.page import write_json
    from heli_lab.twin.calibration import write_calibration
    from heli_lab.twin.figure import draw_evidence
    from heli_lab.twin.files import open_rig
    from heli_lab.twin.follow import follow_file
    from heli_lab.twin.learn import is_calm, weather_of_flights
    from heli_lab.twin.learn import learn as learn_calibration

    if not flights and learn is None:
        raise typer.BadParameter("give a flight, or --learn FILE")
    if learn is not None and learn.suffix.lower() != ".toml":
        raise typer.BadParameter(f"--learn {learn} is written as TOML; give a name that ends in .toml")
    check_result_places(learn, json, figure=figure)
    chosen = open_rig(rig)
    others = healthy or []
    followed: list[Followed] = []
    with WorkBar() as bar:
        bar.show("reading", 0.0)
        read = [read_flight(path, allow_gaps=True) for path in others]
        labels = [path.name for path in others]
        if learn is not None:
            calibration = learn_calibration(chosen.model, chosen.rig, read, labels, say=bar.show)
            write_calibration(learn, calibration, chosen.name)
            chosen = replace(chosen, calibration=calibration)
        elif others:
            disturbances = weather_of_flights(chosen.model, chosen.rig, read, labels)
            chosen = replace(chosen, calibration=replace(chosen.calibration, disturbances=disturbances))
        for path in flights or ():
            bar.show(f"beside {path.name}", 0.9)
            followed.append(follow_file(chosen, path, hours, start_s, stop_s))
    written = [learn] if learn is not None else []
    for flight in followed:
        say(*(f"{flight.label}: {text}" for text in flight.sentences()))
        if flight.flown_rig not in ("", chosen.rig.name, Path(chosen.name).stem):
            say(
                f"{flight.label} is a flight of {flight.flown_rig}, "
                f"the twin one of {chosen.rig.name}: see --rig"
            )
    if others and is_calm(chosen.calibration.disturbances):
        say("the healthy flights are calmer than a quiet room: any draught will be an alarm; give others too")
    threshold_nats = chosen.calibration.threshold_nats(hours)
    say(f"alarm from {threshold_nats:.1f} nats on, {_rate(hours)}; {_source(chosen)}")
    if json is not None:
        write_json(json, _numbers(chosen, followed, hours))
        written.append(json)
    if figure is not None and followed:
        draw_evidence(followed, figure)
        written.append(figure)
    say_files(written)


def _rate(hours: float) -> str:
    return f"one false alarm in {hours:g} h of free flight"


def _source(chosen: TwinRig) -> str:
    return f"weather and alarm from {chosen.calibration.source}" if chosen.calibration.source else "as given"


def _numbers(chosen: TwinRig, flights: list[Followed], hours: float) -> dict[str, Any]:
    disturbances = chosen.calibration.disturbances
    return {
        "rig": chosen.name,
        "hours": hours,
        "threshold_nats": chosen.calibration.threshold_nats(hours),
        "disturbances": {
            "fast_std_Nm": disturbances.fast_std.tolist(),
            "correlation_time_s": disturbances.correlation_time_s.tolist(),
            "slow_std_Nm": disturbances.slow_std.tolist(),
            "quantisation": disturbances.quantisation.tolist(),
        },
        "flights": [
            {
                "flight": flight.label,
                "free_s": flight.free_s,
                "max_evidence_nats": flight.max_evidence_nats,
                "events": [
                    {
                        "kind": event.kind,
                        "t_s": event.t_s,
                        "text": event.text,
                        "onset_s": event.onset_s if math.isfinite(event.onset_s) else None,
                        "ranking": [
                            {
                                "change": candidate.change.id,
                                "words": candidate.change.words(candidate.size, candidate.std),
                                "size": candidate.size,
                                "std": candidate.std,
                                "log_evidence_nats": candidate.log_evidence,
                            }
                            for candidate in event.ranking
                        ],
                    }
                    for event in flight.events
                ],
            }
            for flight in flights
        ],
    }


VERB = Verb(twin, "Laboratory", variadic=True)
