"""Simulate how the elevation step response depends on P_1 to P_6 of (30), for Fig. 19."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

import numpy as np
from heli_host.arrays import Floats
from heli_sim.runge_kutta import runge_kutta_step

from heli_lab.apps.paper.bench_tests import TABLE_DEG, BenchTest

_STEP_s: Final = 0.01
"""Longest step of the integration [s]."""


@dataclass(frozen=True)
class SensitivityCase:
    """One curve of the figure: a step response with some coefficients changed."""

    label: str  # Text in the legend
    changes: Mapping[str, float]  # Factors on coefficients, by name; 0 neglects a coefficient


CASES: Final[tuple[SensitivityCase, ...]] = (
    SensitivityCase("as in Table 2", {}),
    SensitivityCase("case 1: gravity moment P_2 + 10 %", {"P_2": 1.1}),
    SensitivityCase("case 2: thrust P_6 + 10 %", {"P_6": 1.1}),
    SensitivityCase("pendulum P_3 neglected", {"P_3": 0.0}),
    SensitivityCase("friction P_4 neglected", {"P_4": 0.0}),
    SensitivityCase("dead zone P_1 neglected", {"P_1": 0.0}),
)
"""The paper's text mentions small changes in its cases 1 and 2, and neglected parameters."""


def response_deg(coefficients: Mapping[str, float], test: BenchTest, t_s: Floats) -> Floats:
    """Simulate the elevation of (30) after a step of both voltages, with pitch and travel locked. Shapes:
    `t_s` (n,); returns (n,).

    The arm starts on its table; there is no upper stop. The integration is a fourth-order Runge-Kutta method.
    """
    p, sum_V = coefficients, test.front_V + test.back_V
    table_rad = math.radians(TABLE_DEG)
    constant_rad_s2 = p["P_1"] + p["P_5"] + p["P_6"] * sum_V

    def derivative(state: Floats, _: float) -> Floats:
        """Return rate and acceleration of elevation from elevation [rad] and its rate [rad/s]."""
        elevation_rad, rate_rad_s = state
        acceleration_rad_s2 = (
            constant_rad_s2
            + p["P_2"] * math.cos(elevation_rad)
            + p["P_3"] * math.sin(elevation_rad)
            + p["P_4"] * rate_rad_s
        )
        return np.array([rate_rad_s, acceleration_rad_s2])

    state = np.array([table_rad, 0.0])
    row_s = float(t_s[1] - t_s[0])
    substeps = max(1, math.ceil(row_s / _STEP_s))
    elevations_rad = np.empty(t_s.size)
    for row in range(t_s.size):
        elevations_rad[row] = state[0]
        for _ in range(substeps):
            state = runge_kutta_step(derivative, state, row_s / substeps)
            if state[0] <= table_rad:
                # The table stops a falling arm, and does not hold one that rises.
                state = np.array([table_rad, max(state[1], 0.0)])
    return np.degrees(elevations_rad)
