"""Real flights in pairs: a model that is fitted to one flight predicts the other in free runs of 2 s.

The baseline lacks the lag of the thrust, which is 0.09 to 0.15 s on all rigs, and the aerodynamics. Its
errors are within those of a refitted lumped model in the README of the data: 0.4 to 1.1 degrees in elevation,
1.3 to 2.9 in pitch, and 0.3 to 1.5 in travel.

The exception is pitch in the three most strongly excited flights, which travel at 100 degrees per second with
pitch at 50 degrees. Even a fit to the predicted flight itself has errors of 2.2 to 3.4 degrees there. Only
effects that the baseline lacks reduce them, and no choice of parameters, weights or windows.
"""

import pytest
from heli_host.data.log.reader import read_flight
from heli_lab.fit.identification import identify
from heli_sim.model import MultibodyModel
from heli_sim.rig import load_rig

from tests.measured.pairs import MEASURED, MODELS, PairFit, fit_pair
from tests.running.long import LONG, samples, select_cases

HALF = 0.5

pytestmark = pytest.mark.skipif(not MEASURED.exists(), reason="skipped: no shared data")


@pytest.fixture(scope="module")
def liveliest() -> list[PairFit]:
    """Baseline; lag, gyroscopic torque and edgewise flow. In `make long` from two starts each, and lag and
    gyroscopic torque alone between them.
    """
    return fit_pair("rendellc", [MODELS[0], *MODELS[2:3][: samples(1, 0)], MODELS[3]], once=not LONG)


@pytest.mark.diagnosis
def test_on_the_liveliest_pair_three_effects_halve_the_error_of_pitch_and_travel_ahead(
    liveliest: list[PairFit],
) -> None:
    all_three = liveliest[-1]
    for axis in ("pitch", "travel"):
        assert all_three.gain["2"][axis].ratio <= HALF
        error_deg = [pair.gain["2"][axis].after_deg for pair in liveliest]
        assert error_deg == sorted(error_deg, reverse=True)
    fit = all_three.fit
    for name in ("rotor_lag_s", "gyroscopic_torque_m_s", "edgewise_flow_s_per_m"):
        assert fit.params[name] > 10.0 * fit.std[name]


# Upper limits of the rms errors of elevation, pitch and travel in degrees: measured values plus a tenth.
MAX_ERRORS_DEG = {
    ("kristianhope_d4r2_t3", "kristianhope_d4r1_t3"): (0.53, 3.95, 0.56),
    ("kristianhope_d4r1_t3", "kristianhope_d4r2_t3"): (0.28, 1.04, 0.27),
    ("ksteinsland_d1_m25_ang45", "ksteinsland_d1_n25_00i"): (0.22, 1.92, 0.21),
    ("ksteinsland_d1_n25_00i", "ksteinsland_d1_m25_ang45"): (0.21, 2.12, 0.22),
    ("rendellc_P4p2_noint_pf5", "rendellc_P2p1"): (0.69, 5.38, 0.67),
    ("rendellc_P2p1", "rendellc_P4p2_noint_pf5"): (0.85, 3.47, 0.42),
    ("nicolaiadil_d4_n40", "nicolaiadil_d4_n60_q10"): (0.21, 0.47, 0.11),
    ("nicolaiadil_d4_n60_q10", "nicolaiadil_d4_n40"): (0.19, 1.08, 0.13),
}
# Largest errors of the lumped model, and the pairs whose pitch error is larger.
LUMPED_MAX_DEG = (1.1, 2.9, 1.5)
ABOVE_LUMPED = {
    ("kristianhope_d4r2_t3", "kristianhope_d4r1_t3"),
    ("rendellc_P4p2_noint_pf5", "rendellc_P2p1"),
    ("rendellc_P2p1", "rendellc_P4p2_noint_pf5"),
}
PAIRS = select_cases(list(MAX_ERRORS_DEG), every=len(MAX_ERRORS_DEG), kind=ABOVE_LUMPED.__contains__)
"""`make test` runs one pair with errors below those of the lumped model, and one pair above."""


@pytest.mark.slow
@pytest.mark.parametrize("pair", PAIRS, ids=lambda pair: pair[0])
def test_free_run_errors_on_the_other_flight_of_a_pair_stay_bounded(pair: tuple[str, str]) -> None:
    train, other = (read_flight(MEASURED / f"{name}.csv.gz") for name in pair)
    identified = identify(
        MultibodyModel(),
        load_rig("quanser-course"),
        [train],
        validation=[other],
        labels=pair[:1],
        validation_labels=pair[1:],
    )
    numbers = identified.json()
    assert numbers["free_run_of"] == "validation" and numbers["free_run_s"] == 2.0
    errors_deg = tuple(numbers["free_run_rms_deg"].values())
    assert all(error <= limit for error, limit in zip(errors_deg, MAX_ERRORS_DEG[pair], strict=True)), (
        errors_deg
    )
    if pair not in ABOVE_LUMPED:
        assert all(error <= limit for error, limit in zip(errors_deg, LUMPED_MAX_DEG, strict=True)), (
            errors_deg
        )
    record = identified.fit.problem.records[0]
    assert record.t_s[record.segments[0][0]] > 1.5, "the take-off is fitted"
