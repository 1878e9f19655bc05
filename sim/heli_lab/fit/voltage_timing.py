"""When logged voltages act, if the log is slower than the control loop.

A log at the rate of the control loop has every voltage, and each acts from its row to the next. A slower log
has a sample of the voltage per row; between its rows, the controller changes the voltage several times. The
motion shows the mean voltage over a row. The samples at both ends of the row are its best linear estimate:

    mean over row k = (1 - a) u_k + a u_k+1,  a = (n - 1) / 2 n  for n periods of the loop per row.

The *advance* a says when a voltage acts on average: 0 if it acts from its row to the next, and 1 if it acted
from the row before until its row. The innovations of a model decide. An advance is a negative delay, which no
rig has. It is therefore estimated between 0 and 1 only, and after the search for causes. Otherwise a delay or
a lag of the rotors would change it. The rest of the voltages between rows has no memory from one row to the
next, and counts as a disturbance. On four simulated healthy flights, each logged with rows of 2, 4 and 10 ms,
the estimate added 3 to 73 nats and was within two standard errors of (n - 1) / 2 n (2026-11).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from heli_host.data.arrays import Floats
from heli_host.data.flight import Flight

from heli_lab.fit.grey_box import Recording
from heli_lab.fit.linearised_flight import LinearisedFlight
from heli_lab.fit.records import Record, averaged_over_rows

FASTEST_ROWS_s: Final = 1.05e-3
"""Rows that are at most so far apart are those of the control loop, s: the board's loop has 1 kHz, and few
laboratories have a faster one. Longer: logs of a loop of 1 kHz are tested in vain. Shorter: jitter of the
clock decides."""
MIN_NATS: Final = 10.0
"""Log-likelihood that an advance must add, nats: 6 as for a cause, and the BIC penalty of its parameter for a
minute of flight. Lower: chance advances the voltages of logs at loop rate. Higher: a dependence of the
innovations on past thrusts becomes significant first, at 22 nats."""

_SMALLEST_ADVANCE_rows: Final = 0.25
"""Advance of a log with every second voltage of its loop, rows: a log that is slower has this one or a larger
one. Without it, eight of eleven logs at the rate of their loop were called slow, for an advance of 0.06 to
0.15 rows that came from another integration method."""
_STD: Final = 2.0
"""Standard errors by which an estimate may be below it. Fewer: chance hides slow logs in gusts. More: as
without it, in logs that hardly show the advance."""


def sampled_advance(record: Recording, loop_Hz: float) -> float:
    """Return the advance of a log whose voltages are samples of a loop of `loop_Hz`; 0 at loop rate."""
    periods = max(1, round(record.step_s * loop_Hz))
    return (periods - 1) / (2 * periods)


def may_be_slower(record: Recording, loop_Hz: float | None) -> bool:
    """Whether the voltages of a log may be samples of those that acted; `loop_Hz` is None if unknown."""
    return record.step_s > FASTEST_ROWS_s if loop_Hz is None else sampled_advance(record, loop_Hz) > 0.0


def sampled(records: Sequence[Record], loop_Hz: float) -> tuple[Record, ...]:
    """Return flights whose voltages are samples of a control loop of `loop_Hz`."""
    return tuple(replace(record, advance_rows=sampled_advance(record, loop_Hz)) for record in records)


def with_acting_voltages(flight: Flight, advance_rows: float) -> Flight:
    """Return a flight whose voltages are the means that acted from each row to the next."""
    front_V, back_V = averaged_over_rows(flight.voltages_V, advance_rows, tuple(map(int, flight.gaps))).T
    return replace(flight, front_V=front_V, back_V=back_V)


@dataclass(frozen=True)
class AdvanceEstimate:
    """Advance of the voltages of some flights, and the log-likelihood that it adds."""

    rows: float  # Advance in rows, 0 to 1
    nats: float  # Log-likelihood of the flights with it, minus that with their present voltages

    @property
    def is_significant(self) -> bool:
        """Whether the flights are much more likely with it."""
        return self.nats > MIN_NATS


def most_likely_advance(
    present_rows: float, score: float, information: float, candidates_rows: Sequence[float] = ()
) -> AdvanceEstimate:
    """Return the most likely advance, given the present one and the derivatives of the log-likelihood
    there.

    The result is the present one if the most likely advance is smaller than that of any slower log. With
    `candidates_rows`, the result is the most likely of these.
    """
    if information <= 0.0:
        return AdvanceEstimate(present_rows, 0.0)
    peak = min(max(present_rows + score / information, 0.0), 1.0)
    if not candidates_rows and peak + _STD * information**-0.5 < _SMALLEST_ADVANCE_rows:
        return AdvanceEstimate(present_rows, 0.0)
    candidates = np.array(candidates_rows or (peak,), float)
    changes = candidates - present_rows
    nats = score * changes - 0.5 * information * changes**2
    highest = int(np.argmax(nats))
    return AdvanceEstimate(float(candidates[highest]), float(nats[highest]))


def advance_rates(linearised: LinearisedFlight) -> Floats:
    """Differentiate the rates of the state by the advance of a flight's voltages, shape (n, states, 1)."""
    # The result is a secant over the range of the advance, because voltages that cross the dead zone make the
    # rates nonlinear.
    reference, trajectory, functions = linearised.reference, linearised.trajectory, linearised.functions
    record = reference.record
    assert isinstance(record, Record)
    low, high = max(record.advance_rows - 0.5, 0.0), min(record.advance_rows + 0.5, 1.0)

    def rates(advance_rows: float) -> Floats:
        """Rates of the state with another advance, shape (n, states)."""
        acting = linearised.model.acting_inputs(
            replace(record, advance_rows=advance_rows),
            reference.every,
            len(reference.predicted),
            trajectory.parameters,
            functions.free,
        )
        along = functions.along(replace(trajectory, inputs=acting.mean[reference.rows]))
        return np.asarray(along.rates[:, :, 0], float)

    return (rates(high) - rates(low))[:, :, None] / (high - low)


def slow_log_note(record: Record) -> str:
    """State what a log that is slower than the control loop lacks, and how its voltages are understood; empty
    if all voltages of the log act from their row to the next.
    """
    if record.advance_rows == 0.0:
        return ""
    row_ms = 1e3 * record.step_s
    return (
        "the log is slower than the control loop: the voltages between its rows are not known, and effects "
        f"faster than {2.0 * row_ms:.3g} ms cannot be seen (rows of {row_ms:.3g} ms; {_timing(record)})"
    )


def slow_log_notes(records: Iterable[Record]) -> list[str]:
    """List the notes of `slow_log_note` on several flights; logs of one logger share a note."""
    return list(dict.fromkeys(filter(None, map(slow_log_note, records))))


def _timing(record: Record) -> str:
    """Describe when the voltages of a log act."""
    rows = record.advance_rows
    if rows > 1.0 - _ADVANCE_EDGE_rows:
        return "a voltage acts until its row"
    kind = "a voltage is a sample" if rows < 0.5 + _ADVANCE_EDGE_rows else "a voltage"
    return f"{kind} that acts {1e3 * rows * record.step_s:.2g} ms early on average"


_ADVANCE_EDGE_rows: Final = 0.1
"""Difference from 0.5 and 1 within which an advance is described as theirs, rows. For legibility only: most
advances are known to 0.04."""
