"""Refuse files in which no voltages can be found, with the reason and a fix."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from heli_host.errors import FlightDataError

from heli_lab.setup.guess import names, thresholds
from heli_lab.setup.guess.regression.acceleration_fit import RegressionFit
from heli_lab.setup.guess.regression.assignment import ColumnAssignment

_FIX = "give a log with three angles and both motor voltages; if they are in two files, add --one-flight"


def too_few_columns(source: str, columns: Sequence[str], dropped: Mapping[str, str]) -> FlightDataError:
    """Describe a table with fewer than five columns that may be an angle or a voltage."""
    roles = {names.role_of(name) for name in (*columns, *dropped)}
    left_out = ", ".join(f"{name} ({reason})" for name, reason in dropped.items())
    detail = f"; left out: {left_out}" if left_out else ""
    if {"elevation", "pitch", "travel"} <= roles and not roles.intersection(names.VOLTAGE_ROLES):
        return FlightDataError(f"{source}: no column is a motor voltage{detail}", _FIX)
    columns_text = ", ".join(columns) or "none"
    return FlightDataError(
        f"{source}: fewer than five columns can be an angle or a voltage: {columns_text}{detail}", _FIX
    )


def names_state_voltages(assignment: ColumnAssignment) -> bool:
    """Whether the names of both voltage columns state their roles."""
    named_roles = {names.role_of(column) for column in assignment.voltages}
    return named_roles == ({"sum", "difference"} if assignment.summed else {"front", "back"})


def check_voltages(
    source: str, regressions: Mapping[str, RegressionFit], assignment: ColumnAssignment
) -> None:
    """Check that the assigned voltage columns move the axes."""
    are_other_signals = all(names.is_no_voltage(column) for column in assignment.voltages)
    nats = max(regressions[axis].log_likelihood_ratio for axis in ("elevation", "pitch"))
    if are_other_signals or nats < thresholds.DECISIVE_NATS:
        columns = " and ".join(assignment.voltages)
        reason = (
            "their names mean other signals"
            if are_other_signals
            else f"{columns} explain only {nats:.1f} nats"
        )
        raise FlightDataError(f"{source}: no two columns act like motor voltages ({reason})", _FIX)
