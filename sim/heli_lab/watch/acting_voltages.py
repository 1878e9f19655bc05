"""When the voltages of a log act, estimated with a known rig.

A log that is slower than its control loop has samples of the voltages that acted, as
`heli_lab.fit.voltage_timing` describes. The parameters of the rig are known here; only constants of each
flight and disturbances are estimated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from heli_host.data.flight import Flight
from heli_sim.model.base import Model
from heli_sim.rig import Rig

from heli_lab.errors import IdentifyError
from heli_lab.explain.assessment import estimated_advance
from heli_lab.explain.screening import Screening
from heli_lab.fit.records import Record, prepare
from heli_lab.fit.voltage_timing import may_be_slower, sampled, slow_log_note, with_acting_voltages
from heli_lab.watch.disturbances import estimate_with_fixed_rig


def with_likely_advance(
    model: Model, rig: Rig, records: Sequence[Record], loop_Hz: float | None
) -> tuple[Record, ...]:
    """Return flights whose voltages act earlier within their rows, if the flights are much more likely so."""
    # `loop_Hz` is the rate of the control loop, None if it is unknown. The logs are of one logger.
    present = tuple(records) if loop_Hz is None else sampled(records, loop_Hz)
    if model.delay or not any(may_be_slower(record, loop_Hz) for record in records):
        return present
    screening = Screening(estimate_with_fixed_rig(model, rig, present).estimate)
    best = estimated_advance([screening], loop_Hz)
    screening.release()
    if not best.is_significant:
        return present
    return tuple(
        replace(record, advance_rows=best.rows if may_be_slower(record, loop_Hz) else 0.0)
        for record in records
    )


def acting_flights(
    model: Model, rig: Rig, flights: Sequence[Flight], labels: Sequence[str], loop_Hz: float | None
) -> tuple[list[Flight], list[str]]:
    """Return flights of one logger with the mean voltages that acted from row to row, and what their logs
    lack, one sentence for each kind of log.
    """
    result, notes = [], dict[str, None]()
    for flight, label in zip(flights, labels, strict=True):
        try:
            (record,) = with_likely_advance(model, rig, [prepare(flight, rig, label)], loop_Hz)
        except IdentifyError:
            result.append(flight)
            continue
        notes[slow_log_note(record)] = None
        result.append(with_acting_voltages(flight, record.advance_rows))
    return result, list(filter(None, notes))
