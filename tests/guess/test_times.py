"""The clock of a table is found, with its unit, or what it could be."""

from __future__ import annotations

import numpy as np
import pytest
from heli_host.data.tables import Column, Table
from heli_lab.setup.guess.times import clock_of


def table(name: str, step: float, unit: str = "") -> Table:
    rising = Column(np.array([7.0 + k * step for k in range(200)]), unit)
    return Table("a.csv", {"x": Column(np.sin(np.arange(200.0))), name: rising})


@pytest.mark.parametrize(
    ("name", "step", "unit", "expected_unit", "sure"),
    [
        ("t_s", 0.002, "", "s", True),
        ("Time [ms]", 2.0, "", "ms", True),
        ("t", 0.01, "", "s", True),
        ("time", 4.0, "", "ms", True),
        ("time", 4000.0, "", "us", True),
        ("time", 2e6, "", "ns", True),
        ("whatever", 0.005, "", "s", True),
        ("time", 1.0, "", "ms", False),
        ("index", 1.0, "", "ms", False),
        ("t_s", 10000.0, "", "us", False),
        ("x2", 5.0, "ms", "ms", True),
    ],
)
def test_a_clock(name: str, step: float, unit: str, expected_unit: str, sure: bool) -> None:
    clock = clock_of(table(name, step, unit))
    assert (clock.column, clock.unit, clock.sure) == (name, expected_unit, sure)
    assert sure or clock.alternative


def test_no_clock() -> None:
    assert not clock_of(Table("a.csv", {"x": Column(np.sin(np.arange(200.0)))})).column
    assert not clock_of(table("t_s", 1e12)).unit
