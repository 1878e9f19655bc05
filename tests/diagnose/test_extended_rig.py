"""The extended rig has the means of parameters that differ between flights."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from heli_lab.explain.result import extended_rig
from heli_lab.fit.flight_model import RigParameters
from heli_lab.fit.problem import Fit, Problem
from heli_lab.fit.records import Record
from heli_sim.model import MultibodyModel
from heli_sim.rig import load_rig

pytestmark = pytest.mark.medium


def test_extended_rig_of_several_flights_has_the_means_of_their_zeros_and_torques() -> None:
    rig, model = load_rig("makki2024"), MultibodyModel()
    records = [cast(Record, SimpleNamespace(label=label)) for label in "ab"]
    vector = RigParameters(model, rig, records)
    per_flight = {
        "offset_pitch[a]": 0.5,
        "offset_pitch[b]": 0.3,
        "torque_pitch[a]": 0.01,
        "torque_pitch[b]": 0.03,
    }
    problem = SimpleNamespace(
        rig=rig, model=model, records=records, free=vector.free, names=vector.names, parameter_vector=vector
    )
    fit = Fit(
        problem=cast(Problem, problem),
        theta=vector.started_from(per_flight),
        covariance=1e-8 * np.eye(len(vector.free)),
        information=1e8 * np.eye(len(vector.free)),
        states=(),
        variance=(),
        weights=(),
        cost=0.0,
        at_bound=(),
        evaluations=0,
        elapsed_s=0.0,
        converged=True,
    )
    numbers = extended_rig("extended", fit, {}, {}, None).numbers
    assert numbers["offset_pitch"].value == pytest.approx(0.4)
    assert numbers["torque_pitch"].value == pytest.approx(0.02)
    # The next flight has other zeros: the scatter of two, and never less than the rig file states.
    assert numbers["offset_pitch"].tolerance == pytest.approx(2.0 * np.std([0.5, 0.3], ddof=1))
    assert numbers["offset_elevation"].tolerance == rig["offset_elevation"].tolerance
