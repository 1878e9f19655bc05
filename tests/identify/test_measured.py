"""Real machines: fit on one flight, two seconds of free run on the other of the pair.

The baseline lacks the lag of the thrust (0.09 to 0.15 s on all of them) and the air's part. Its errors are
within those that the README of the data reports of a refitted lumped model: elevation 0.4 to 1.1, pitch
1.3 to 2.9, travel 0.3 to 1.5 degrees. The exception is pitch in the three most strongly excited flights,
which turn at 100 degrees a second with the short arm at 50. A fit to the judged flight itself leaves 2.2
to 3.4 degrees there. No choice of parameters, weights or windows helps, only effects that the baseline
does not have.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from heli_host.log.flight_file import read_flight
from heli_lab.identify.run import identify
from heli_sim.model import MultibodyModel
from heli_sim.rig import load_rig

from tests.running.long import parallel_map

pytestmark = pytest.mark.slow

MEASURED = Path(__file__).resolve().parents[3] / "shared" / "data" / "measured"

# Rms errors measured in degrees, elevation, pitch and travel, and a tenth.
REACHED = {
    ("kristianhope_d4r2_t3", "kristianhope_d4r1_t3"): (0.53, 3.95, 0.56),
    ("kristianhope_d4r1_t3", "kristianhope_d4r2_t3"): (0.28, 1.04, 0.27),
    ("ksteinsland_d1_m25_ang45", "ksteinsland_d1_n25_00i"): (0.22, 1.92, 0.21),
    ("ksteinsland_d1_n25_00i", "ksteinsland_d1_m25_ang45"): (0.21, 2.12, 0.22),
    ("rendellc_P4p2_noint_pf5", "rendellc_P2p1"): (0.69, 5.38, 0.67),
    ("rendellc_P2p1", "rendellc_P4p2_noint_pf5"): (0.85, 3.47, 0.42),
    ("nicolaiadil_d4_n40", "nicolaiadil_d4_n60_q10"): (0.21, 0.47, 0.11),
    ("nicolaiadil_d4_n60_q10", "nicolaiadil_d4_n40"): (0.19, 1.08, 0.13),
}
LUMPED_WORST_DEG = (1.1, 2.9, 1.5)
BEYOND = {
    ("kristianhope_d4r2_t3", "kristianhope_d4r1_t3"),
    ("rendellc_P4p2_noint_pf5", "rendellc_P2p1"),
    ("rendellc_P2p1", "rendellc_P4p2_noint_pf5"),
}
PAIRS = parallel_map(list(REACHED), every=len(REACHED), kind=BEYOND.__contains__)
"""In `make test` one pair within what is reported, and one beyond."""


@pytest.mark.skipif(not MEASURED.exists(), reason="skipped: no shared data")
@pytest.mark.parametrize("pair", PAIRS, ids=lambda pair: pair[0])
def test_free_run_errors_on_the_other_flight_of_a_pair_stay_bounded(pair: tuple[str, str]) -> None:
    train, other = (read_flight(MEASURED / f"{name}.csv.gz") for name in pair)
    found = identify(
        MultibodyModel(),
        load_rig("quanser-course"),
        [train],
        validation=[other],
        labels=pair[:1],
        validation_labels=pair[1:],
    )
    told = found.json()
    assert told["free_run_of"] == "validation" and told["free_run_s"] == 2.0
    errors_deg = tuple(told["free_run_rms_deg"].values())
    assert all(error <= reached for error, reached in zip(errors_deg, REACHED[pair], strict=True)), errors_deg
    if pair not in BEYOND:
        assert all(error <= most for error, most in zip(errors_deg, LUMPED_WORST_DEG, strict=True)), (
            errors_deg
        )
    record = found.fit.problem.records[0]
    assert record.t_s[record.segments[0][0]] > 1.5, "the take-off is fitted"
