"""``heli-host twin``: detect changes of a rig with a model of it, and name their time and cause."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer
from heli_host.board.twins import FALSE_ALARM_INTERVAL_h
from heli_host.ui.cli.options import DEFAULT_RIG, FigureOption, JsonOption
from heli_host.ui.cli.say import data_on_stdout, say, say_files, write_result
from heli_host.ui.cli.verb import Verb

from heli_lab import fit_inputs as option

if TYPE_CHECKING:
    from heli_host.ui.cli.live import WorkBar

    from heli_lab.watch.calibration import Tail, TwinRig
    from heli_lab.watch.monitor import TwinReport
    from heli_lab.watch.twin import TwinEvent

_LEARNED_SHARE: Final = 0.9
"""Share of the work that is done once disturbances and threshold are learned."""


def twin(
    flights: Annotated[
        list[Path] | None,
        typer.Argument(metavar="[FLIGHT...]", help="Check these flights: .mcap, .csv or .csv.gz."),
    ] = None,
    rig: Annotated[
        str,
        typer.Option(
            "--rig",
            metavar="NAME|FILE",
            help=f"Compare with this rig, or a file of --learn.  [default: {DEFAULT_RIG}]",
            show_default=False,
        ),
    ] = DEFAULT_RIG,
    nominal: Annotated[
        list[Path] | None,
        typer.Option(
            "--nominal",
            metavar="FLIGHT...",
            help="Estimate disturbances from these flights of the unchanged rig.",
        ),
    ] = None,
    learn: Annotated[
        Path | None,
        typer.Option(
            "--learn",
            metavar="FILE",
            help="Set the alarm threshold from the nominal flights, and write this twin file.",
        ),
    ] = None,
    false_alarm_interval_h: Annotated[
        float,
        typer.Option(
            "--false-alarm-interval-h",
            metavar="H",
            min=0.01,
            help="Accept one false alarm in this many hours in the air.",
        ),
    ] = FALSE_ALARM_INTERVAL_h,
    start_s: Annotated[
        float | None,
        typer.Option("--from", "--from-s", metavar="S", help="Ignore rows before this time in s."),
    ] = None,
    stop_s: Annotated[
        float | None, typer.Option("--to", "--to-s", metavar="S", help="Ignore rows from this time in s on.")
    ] = None,
    loop_rate_Hz: option.LoopRateOption = None,
    json: JsonOption = None,
    figure: FigureOption = None,
) -> None:
    """Detect when a rig diverges from its model, and report what changed.

    Compares finished flights with the model. During a flight, `heli-host fly --twin` raises the same alarms.
    --learn writes a twin file for --rig and --twin. Without --learn, --json and --figure the result
    is only printed.

    Example: `heli-host twin flight.mcap --rig my-rig.toml --nominal monday.mcap`
    """
    # The matrices are small: several BLAS threads only wait for each other.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from heli_host.ui.cli.live import WorkBar
    from heli_host.ui.cli.options import check_result_places

    from heli_lab.watch.calibration import open_rig
    from heli_lab.watch.learn import has_few_disturbances
    from heli_lab.watch.monitor import draw_evidence, monitor_file

    if not flights and learn is None:
        raise typer.BadParameter("no flight is given; give one, or --learn FILE")
    if learn is not None and learn.suffix.lower() != ".toml":
        raise typer.BadParameter(f"--learn {learn} is not a TOML file; give a name that ends in .toml")
    check_result_places(learn, json, figure=figure)
    data_on_stdout(json)
    twin_rig = open_rig(rig)
    nominal_paths = nominal or []
    reports: list[TwinReport] = []
    with WorkBar() as bar:
        twin_rig, slow_log_notes = _calibrated(twin_rig, nominal_paths, learn, loop_rate_Hz, bar)
        for path in flights or ():
            bar.show(f"following {path.name}", _LEARNED_SHARE)
            reports.append(
                monitor_file(twin_rig, path, false_alarm_interval_h, start_s, stop_s, loop_rate_Hz)
            )
    say(*dict.fromkeys(filter(None, (*slow_log_notes, *(report.slow_log_note for report in reports)))))
    if reports:
        say(*_fit_lines(twin_rig, reports, false_alarm_interval_h))
    nominal_labels = [path.name for path in nominal_paths]
    for report in reports:
        say(*_report_lines(report, twin_rig, nominal_labels))
    if nominal_paths and has_few_disturbances(twin_rig.calibration.disturbances):
        say(
            "the nominal flights have almost no disturbances, so every later gust raises an alarm; "
            "give more flights"
        )
    threshold_nats = twin_rig.calibration.threshold_nats(false_alarm_interval_h)
    false_alarm_text = _false_alarm_text(twin_rig.calibration.tail, false_alarm_interval_h)
    say(
        f"alarm threshold: {threshold_nats:.1f} nats, {false_alarm_text}; "
        f"{_calibration_source(twin_rig, [] if learn is not None else nominal_labels)}"
    )
    write_result(json, _json_object(twin_rig, reports, false_alarm_interval_h))
    if figure is not None and reports:
        draw_evidence(reports, figure)
    say_files((learn, json, figure if reports else None))


def _calibrated(
    twin_rig: TwinRig,
    nominal_paths: Sequence[Path],
    twin_file: Path | None,
    loop_rate_Hz: float | None,
    bar: WorkBar,
) -> tuple[TwinRig, list[str]]:
    """Return the rig with a calibration on nominal flights, and what their logs lack. Without these flights,
    its calibration stays.

    With a `twin_file`, the alarm threshold is calibrated too, which takes minutes, and the file is written.
    """
    from heli_host.data.log.reader import read_flight

    from heli_lab.watch.calibration import write_calibration
    from heli_lab.watch.disturbances import acting_flights
    from heli_lab.watch.learn import learn, learn_rig

    bar.show("reading", 0.0)
    nominal_flights = [read_flight(path, allow_gaps=True) for path in nominal_paths]
    labels = [path.name for path in nominal_paths]
    nominal_flights, notes = acting_flights(
        twin_rig.model, twin_rig.rig, nominal_flights, labels, loop_rate_Hz
    )
    if twin_file is not None:
        calibration = learn(twin_rig.model, twin_rig.rig, nominal_flights, labels, say=bar.show)
        write_calibration(twin_file, calibration, twin_rig.name)
        return replace(twin_rig, calibration=calibration), notes
    if nominal_flights:
        disturbances, uncertainty = learn_rig(twin_rig.model, twin_rig.rig, nominal_flights, labels)
        calibration = replace(twin_rig.calibration, disturbances=disturbances, uncertainty=uncertainty)
        return replace(twin_rig, calibration=calibration), notes
    return twin_rig, notes


def _fit_lines(twin_rig: TwinRig, reports: Sequence[TwinReport], false_alarm_interval_h: float) -> list[str]:
    """State whether the model fits this machine well enough for the accepted rate of false alarms."""
    lines = []
    if not twin_rig.calibration.has_learned:
        lines.append(
            f"this twin has learned no flight of this machine: one false alarm in {false_alarm_interval_h:g} "
            "h holds for simulated flights with weak disturbances; train it with --nominal FLIGHT and --learn"
        )
    too_short = "the flight is too short to check whether the model fits"
    return lines + [
        f"{report.label}: {report.fit or too_short}"
        for report in reports
        if not any(event.kind == "contradicts" for event in report.events)
        and (report.fit or not report.alarms)
    ]


def _report_lines(report: TwinReport, twin_rig: TwinRig, nominal_labels: Sequence[str]) -> list[str]:
    """Describe the result of a flight, with a warning if the flight is of another rig than the twin, or one
    from which the twin has learned.
    """
    from heli_lab.fit.identification import is_fitted_flight

    rig = twin_rig.rig
    lines = [f"{report.label}: {sentence}" for sentence in report.sentences()]
    lines += option.other_rig_notes(rig, twin_rig.name, {report.label: report.flown_rig})
    learned_labels = [*nominal_labels, *twin_rig.calibration.source.split(", ")]
    if report.label in learned_labels or is_fitted_flight(rig, report.label):
        lines.append(f"the twin has learned from {report.label}, so it cannot detect what differs in it")
    return lines


def _false_alarm_text(tail: Tail, false_alarm_interval_h: float) -> str:
    """State the interval between false alarms that the user accepts, or the longest that the nominal flights
    support.
    """
    if tail.supported_interval_h >= false_alarm_interval_h:
        return f"one false alarm in {false_alarm_interval_h:g} h in the air"
    return (
        f"one false alarm in {tail.supported_interval_h:.1g} h in the air at best, "
        f"because {tail.healthy_s:.0f} s of healthy flight support no rarer ones"
    )


def _calibration_source(twin_rig: TwinRig, nominal_labels: Sequence[str]) -> str:
    """State the origin of disturbances and threshold. Nominal flights without --learn give no threshold."""
    source = twin_rig.calibration.source
    if nominal_labels:
        return f"disturbances from {', '.join(nominal_labels)}, threshold from {source or 'the default'}"
    return f"disturbances and threshold from {source}" if source else "default disturbances"


def _json_object(
    twin_rig: TwinRig, reports: Sequence[TwinReport], false_alarm_interval_h: float
) -> dict[str, Any]:
    """Return threshold, disturbances, alarms and rankings as a JSON object."""
    disturbances = twin_rig.calibration.disturbances
    return {
        "rig": twin_rig.name,
        "false_alarm_interval_h": false_alarm_interval_h,
        "threshold_nats": twin_rig.calibration.threshold_nats(false_alarm_interval_h),
        "disturbances": {
            "fast_std_Nm": disturbances.fast_std.tolist(),
            "correlation_time_s": disturbances.correlation_time_s.tolist(),
            "slow_std_Nm": disturbances.slow_std.tolist(),
            "quantisation": disturbances.quantisation.tolist(),
        },
        "flights": [
            {
                "flight": report.label,
                "fit": report.fit,
                "slow_log": report.slow_log_note or None,
                "free_s": report.free_s,
                "unjudged_s": report.unjudged_s,
                "max_evidence_nats": report.max_evidence_nats,
                "events": [_event_object(event) for event in report.events],
            }
            for report in reports
        ],
    }


def _event_object(event: TwinEvent) -> dict[str, Any]:
    """Return an event with its ranking of the changes as a JSON object."""
    return {
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


VERB = Verb(twin, "Laboratory", variadic=True)
