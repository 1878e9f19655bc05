"""Diagnoses are read and pooled, and give a prior for another rig; further flights lower standard errors."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from heli_lab.apps.pool import (
    ParameterEstimate,
    RigPopulation,
    der_simonian_laird,
    pool,
    read_rig_diagnosis,
    share,
    without_prior,
)
from heli_lab.errors import PoolError
from heli_sim.model.effects import effects_of
from heli_sim.rig import load_rig, write_rig
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.cli.terminal import Terminal
from tests.pool.coverage import BY_FLIGHTS, FLIGHTS, normalised_errors, shares_of_one
from tests.running.long import samples

RIG = load_rig("makki2024")


def number(value: float, std: float, mean: float, prior_std: float, unit: str) -> dict[str, Any]:
    return {"value": value, "std": std, "prior": {"value": mean, "std": prior_std}, "unit": unit}


def diagnosis(gain: float, lag_s: float | None, hidden: tuple[str, ...] = ()) -> dict[str, Any]:
    """Diagnosis of a rig: the prior of the rig file combined with a measurement of the gain to 2 %."""
    was = RIG["thrust_gain"]
    before, flights = 0.5 * was.tolerance, 0.02 * was.value
    precision = before**-2.0 + flights**-2.0
    value = (was.value * before**-2.0 + gain * flights**-2.0) / precision
    heavy = RIG["M_f"].tolerance
    numbers = {
        "thrust_gain": number(value, precision**-0.5, was.value, before, was.unit),
        "M_f": number(RIG["M_f"].value, 0.4999 * heavy, RIG["M_f"].value, 0.5 * heavy, "kg"),
    }
    causes = []
    if lag_s is not None:
        numbers["rotor_lag_s"] = number(lag_s, 0.002, 0.05, 0.1, "s")
        causes = [
            {"effect": "rotor_lag", "confidence": 0.97},
            {"effect": "backlash.pitch", "confidence": 0.5},
        ]
    return {
        "verdict": "cause_found" if causes else "explained",
        "causes": causes,
        "undetectable": list(hidden),
        "rig": {"name": "makki2024", "model": "multibody", "numbers": numbers},
    }


def population(folder: Path, *machines: dict[str, Any]) -> RigPopulation:
    paths = [folder / f"machine{n}.json" for n in range(len(machines))]
    for path, content in zip(paths, machines, strict=True):
        path.write_text(json.dumps(content))
    return pool([read_rig_diagnosis(path) for path in paths])


def test_the_prior_is_taken_out_of_what_machines_share(tmp_path: Path) -> None:
    gains = [1.05 * RIG["thrust_gain"].value, 1.09 * RIG["thrust_gain"].value]
    made = population(tmp_path, *(diagnosis(gain, None) for gain in gains))
    for machine, gain in zip(made.diagnoses, gains, strict=True):
        assert machine.parameters["thrust_gain"].value == pytest.approx(gain)
        assert machine.parameters["thrust_gain"].std == pytest.approx(0.02 * RIG["thrust_gain"].value)
    assert made.parameters["thrust_gain"].mean == pytest.approx(np.mean(gains))


def test_a_number_that_flights_do_not_inform_is_left_out() -> None:
    prior = ParameterEstimate(1.0, std=0.1, unit="1")
    assert without_prior(1.0, 0.0999, prior) is None
    assert without_prior(1.01, 0.05, prior) is not None


def test_a_cause_is_counted_among_the_machines_that_would_show_it(tmp_path: Path) -> None:
    gain = RIG["thrust_gain"].value
    blind = diagnosis(gain, None, hidden=("rotor_lag",))
    made = population(
        tmp_path, *(diagnosis(gain, lag) for lag in (0.08, 0.09, 0.1)), diagnosis(gain, None), blind
    )
    counted = made.causes["rotor_lag"]
    assert (counted.present, counted.detectable) == (3, 4)
    assert counted.interval == pytest.approx((0.1941, 0.9937), abs=1e-4)
    # A cause that was named with low confidence is neither there nor not.
    unsure = made.causes["backlash.pitch"]
    assert (unsure.present, unsure.detectable, unsure.undecided) == (0, 2, 3)
    assert next(iter(made.causes)) == "rotor_lag"


def test_the_next_machine_is_expected_where_the_others_are(tmp_path: Path) -> None:
    was = RIG["thrust_gain"]
    gains = [1.2 * was.value * (1.0 + 0.01 * z) for z in (-1.0, 0.0, 1.0, 0.5, -0.5)]
    made = population(tmp_path, *(diagnosis(gain, 0.09 + 0.001 * n) for n, gain in enumerate(gains)))
    prior = made.prior_rig(RIG, "pooled")
    assert prior["thrust_gain"].value == pytest.approx(1.2 * was.value, rel=0.02)
    assert prior["thrust_gain"].tolerance < 0.6 * was.tolerance
    assert prior["M_f"] == RIG["M_f"], "no flight is informative about it"
    assert "before:" in prior["thrust_gain"].source
    lag = prior.effects["rotor_lag"]["s"]
    assert lag.value == pytest.approx(0.092, abs=0.004)
    assert "backlash.pitch" not in prior.effects
    path = tmp_path / "make.toml"
    write_rig(prior, path)
    (effect,) = effects_of(load_rig(path))
    assert effect.priors["rotor_lag_s"].mean == pytest.approx(lag.value, rel=1e-6)
    assert effect.priors["rotor_lag_s"].std == pytest.approx(0.5 * lag.tolerance, rel=1e-6)


def test_one_machine_says_less_of_the_next_than_several_alike(tmp_path: Path) -> None:
    gain = 1.1 * RIG["thrust_gain"].value
    tolerances = [
        population(tmp_path, *(diagnosis((1.0 + 1e-6 * number) * gain, None) for number in range(count)))
        .prior_rig(RIG, "pooled")["thrust_gain"]
        .tolerance
        for count in (1, 2, 5)
    ]
    assert tolerances[0] > 1.2 * tolerances[1] > 1.4 * tolerances[2]
    assert tolerances[0] < RIG["thrust_gain"].tolerance


def test_rigs_of_a_type_that_differ_is_expected_to_differ(tmp_path: Path) -> None:
    """The parameter of the next rig is within two predicted standard deviations in about 95 % of cases."""
    random = np.random.default_rng(1)
    was, held = RIG["thrust_gain"], 0
    spread = 0.3 * 0.5 * was.tolerance
    for _ in range(60):
        gains = 1.1 * was.value + spread * random.standard_normal(5)
        seen = gains[:4] + 0.02 * was.value * random.standard_normal(4)
        prior = population(tmp_path, *(diagnosis(float(gain), None) for gain in seen)).prior_rig(RIG, "m")[
            "thrust_gain"
        ]
        held += abs(gains[4] - prior.value) < prior.tolerance
    assert held / 60 > 0.88


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is not JSON"),
        ("[]", "is not a diagnosis"),
        ("{}", "is not a diagnosis"),
        ('{"rig": null, "causes": [], "undetectable": []}', "is not a diagnosis"),
    ],
)
def test_what_is_no_diagnosis_is_refused_in_a_line(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "x.json"
    path.write_text(text)
    with pytest.raises(PoolError, match=message) as caught:
        read_rig_diagnosis(path)
    assert "x.json" in str(caught.value)


def test_rigs_of_two_types_and_of_one_name_are_refused(tmp_path: Path) -> None:
    item, other = diagnosis(1.0, None), diagnosis(1.0, None)
    other["rig"]["name"] = "quanser-course"
    with pytest.raises(PoolError, match="not of one type: machine0: rig makki2024"):
        population(tmp_path, item, other)
    machine = population(tmp_path, item).diagnoses[0]
    with pytest.raises(PoolError, match="two diagnoses have the name machine0"):
        pool([machine, machine])
    with pytest.raises(PoolError, match="machine0 and again are the same diagnosis"):
        pool([machine, replace(machine, label="again")])
    with pytest.raises(PoolError, match="no diagnosis to pool"):
        pool([])


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


def test_machines_are_pooled_and_a_prior_is_left(terminal: Terminal, tmp_path: Path) -> None:
    gain = 1.1 * RIG["thrust_gain"].value
    paths = [tmp_path / f"lab{n}.json" for n in range(3)]
    for path, lag_s in zip(paths, (0.08, 0.09, 0.1), strict=True):
        path.write_text(json.dumps(diagnosis(gain, lag_s)))
    unexplained = {**json.loads(paths[2].read_text()), "verdict": "unexplained"}
    paths[2].write_text(json.dumps(unexplained))
    out, numbers = tmp_path / "pooled.toml", tmp_path / "pooled.json"
    result = terminal("pool", *paths, "--save-rig", out, "--json", numbers)
    assert result.code == 0, result.err
    assert "3 rigs of type makki2024, model multibody" in result.out
    assert "rotor_lag: on 3 of 3 rigs that could show it; 29 to 100 % of all rigs of this type" in result.out
    assert "backlash.pitch: on 0 of 0 rigs that could show it; 0 to 100 % of all rigs" in result.out
    assert "caution: unexplained, so their parameters may be biased: lab2" in result.out
    assert "undecided on 3 more: confidence below 0.9; diagnose with --validate" in result.out
    assert load_rig(out)["thrust_gain"].value > 1.05 * RIG["thrust_gain"].value
    content = json.loads(numbers.read_text())
    assert content["numbers"]["rotor_lag_s"]["machines"] == 3
    assert content["causes"]["rotor_lag"]["share"] == 1.0


def test_what_is_no_diagnosis_is_one_line(terminal: Terminal, tmp_path: Path) -> None:
    result = terminal("pool", tmp_path / "none.json")
    assert result.code == 2
    assert result.err.count("\n") == 1 and "none.json" in result.err


RIGS = range(1, 1 + samples(12, 4))


@pytest.mark.slow
@pytest.mark.parametrize("name", BY_FLIGHTS)
def test_the_standard_error_falls_with_the_root_of_the_number_of_flights(name: str) -> None:
    assert 0.8 < float(np.mean(shares_of_one(name, RIGS))) < 1.2


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, FLIGHTS])
def test_flights_hold_the_truth_within_two_standard_errors(count: int) -> None:
    assert np.mean(np.abs(normalised_errors(count, RIGS)) < 2.0) > 0.85
