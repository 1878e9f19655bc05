"""The estimate of DerSimonian and Laird equals that of statsmodels and has its nominal coverage."""

from __future__ import annotations

import math

import numpy as np
import pytest
from heli_lab.apps.pool import der_simonian_laird, share
from hypothesis import given, settings
from hypothesis import strategies as st

MEASURED = st.tuples(st.floats(-10.0, 10.0), st.floats(0.05, 5.0))


@given(st.lists(MEASURED, min_size=2, max_size=12))
@settings(max_examples=25, deadline=None)
@pytest.mark.medium
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
def test_it_is_what_statsmodels_has(measured: list[tuple[float, float]]) -> None:
    from statsmodels.stats.meta_analysis import combine_effects

    values, stds = (np.array(item) for item in zip(*measured, strict=True))
    ours = der_simonian_laird(values.tolist(), stds.tolist())
    theirs = combine_effects(values, stds**2, method_re="dl", use_t=True)
    assert ours.tau**2 == pytest.approx(max(0.0, theirs.tau2), abs=1e-9)
    # Theirs is a difference of sums as large as this one, and rounds as they do.
    rounding = 2.0 * np.finfo(float).eps * float(np.sum((values / stds) ** 2))
    assert ours.q == pytest.approx(theirs.q, rel=1e-9, abs=max(1e-12, rounding))
    # Scatter below what the errors say is no variance below 0: they leave that to the reader.
    kind = "random effect" if theirs.tau2 > 0.0 else "fixed effect"
    row = theirs.summary_frame().loc[kind]
    assert ours.mean == pytest.approx(row["eff"], abs=1e-9)
    assert ours.std == pytest.approx(row["sd_eff"], rel=1e-9)
    # The interval of Hartung and Knapp in statsmodels may be narrower than the standard errors allow.
    scaled = theirs.summary_frame().loc[f"{kind} wls"]
    wider = scaled if scaled["sd_eff"] > row["sd_eff"] else row
    assert ours.interval == pytest.approx((wider["ci_low"], wider["ci_upp"]), abs=1e-6)


def test_the_intervals_hold_the_make_and_the_next_machine() -> None:
    random = np.random.default_rng(3)
    held_mean = held_next = 0
    for _ in range(400):
        stds = random.uniform(0.5, 1.5, 12)
        machines = random.normal(5.0, 1.0, 13)
        seen = machines[:12] + stds * random.standard_normal(12)
        estimate = der_simonian_laird(seen.tolist(), stds.tolist())
        assert estimate.prediction is not None
        held_mean += estimate.interval[0] < 5.0 < estimate.interval[1]
        held_next += estimate.prediction[0] < machines[12] < estimate.prediction[1]
    assert 0.92 < held_mean / 400 < 0.98
    # The rigs differ as much as their standard errors, so that tau is uncertain.
    assert 0.84 < held_next / 400 < 0.99


def test_one_machine_is_itself_and_machines_that_agree_differ_by_nothing() -> None:
    one_rig = der_simonian_laird([3.0], [0.2])
    assert (one_rig.mean, one_rig.std, one_rig.tau, one_rig.prediction) == (
        3.0,
        pytest.approx(0.2),
        0.0,
        None,
    )
    same = der_simonian_laird([3.0, 3.0, 3.0], [0.3, 0.3, 0.3])
    assert (same.tau, same.i2) == (0.0, 0.0)
    assert same.std == pytest.approx(0.3 / math.sqrt(3.0))


@pytest.mark.parametrize(
    ("present", "detectable", "low", "high"),
    # Table values of the exact interval: all of n has the lower end 0.025^(1/n).
    [(5, 5, 0.025**0.2, 1.0), (0, 5, 0.0, 1.0 - 0.025**0.2), (1, 2, 0.01258, 0.98742)],
)
def test_a_share_has_its_exact_interval(present: int, detectable: int, low: float, high: float) -> None:
    estimated_share = share(present, detectable)
    assert estimated_share.interval == pytest.approx((low, high), abs=1e-4)
    assert estimated_share.share == present / detectable
