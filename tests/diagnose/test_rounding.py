"""A diagnosis does not depend on how the processor rounds."""

from __future__ import annotations

import numpy as np
import pytest
from heli_host.data.arrays import Floats
from heli_lab.diagnose import Diagnosis, diagnose, to_json
from heli_lab.fit import _kalman
from heli_lab.fit.model_functions import AlongTrajectory, Trajectory
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import catalogue
from heli_sim.rig import load_rig

from tests.diagnose.hidden import flights

pytestmark = pytest.mark.diagnosis

TRIED = ("rotor_lag", "input_delay", "thrust_asymmetry", "coulomb_friction.travel")
ROUNDING = 4e-16
"""Twice the rounding error of a double."""


def diagnosed() -> Diagnosis:
    """Diagnose flights with a hidden lag; the catalogue has the effects `TRIED` only."""
    fit, held_out = flights("rotor_lag=0.06")
    kinds = {id_: kind for id_, kind in catalogue().items() if id_ in TRIED}
    return diagnose(MultibodyModel(), load_rig("makki2024"), [fit], [held_out], kinds=kinds)


def test_verdict_and_likelihoods_do_not_depend_on_rounding(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    plain = diagnosed()
    rng, along, filtered = np.random.default_rng(5), AlongTrajectory.__call__, _kalman.filter
    rounded = 0

    def with_rounding_error(values: Floats) -> Floats:
        nonlocal rounded
        rounded += 1
        return values * (1.0 + ROUNDING * rng.uniform(-1.0, 1.0, values.shape))

    def rounds_differently(self: AlongTrajectory, trajectory: Trajectory) -> list[Floats]:
        return [with_rounding_error(output) for output in along(self, trajectory)]

    def filters_differently(*system: Floats) -> tuple[Floats, ...]:
        return tuple(with_rounding_error(np.asarray(array)) for array in filtered(*system))

    monkeypatch.setattr(AlongTrajectory, "__call__", rounds_differently)
    monkeypatch.setattr(_kalman, "filter", filters_differently)
    other = diagnosed()
    assert rounded > 100
    assert other.label == plain.label == "cause_found"
    assert [cause.candidate.id for cause in other.verdict.causes] == ["rotor_lag"]
    log_likelihoods, other_log_likelihoods = _refit_log_likelihoods(plain), _refit_log_likelihoods(other)
    assert other_log_likelihoods.keys() == log_likelihoods.keys()
    for id_, log_likelihood in log_likelihoods.items():
        assert other_log_likelihoods[id_] == pytest.approx(log_likelihood, abs=0.1), id_
    gain, other_gain = (to_json(diagnosis)["gain"]["axis"] for diagnosis in (plain, other))
    for axis, reduction in gain.items():
        assert other_gain[axis]["ratio"] == pytest.approx(reduction["ratio"], rel=0.01)


def _refit_log_likelihoods(diagnosis: Diagnosis) -> dict[str, float]:
    """Return the log-likelihood of the last refit of each candidate in the search."""
    return {
        refit.candidate.id: refit.hypothesis.log_likelihood
        for round_ in diagnosis.search.rounds
        for refit in round_.refits
    }
