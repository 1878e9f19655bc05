"""A campaign's file makes the cases that it says, and what is wrong with it is said in one line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from heli_lab.apps.campaign.cases import Campaign
from heli_lab.apps.campaign.file import load_campaign
from heli_lab.apps.campaign.works import draw_rig
from heli_lab.code_digest import code_digest
from heli_lab.errors import CampaignError
from heli_sim.rig import load_rig
from hypothesis import given, settings
from hypothesis import strategies as st

GOOD = """
title = "Lags"
work = "fly"
worst = "-travel_rms_deg"
[cases]
rig = ["makki2024", "mine.toml"]
effects = [[], ["rotor_lag=0.1", "input_delay=0.02"]]
seed = { from = 3, to = 5 }
[draw]
"M_*" = { share = 0.03 }
[limits]
cpu_s = 20
"""


def read(folder: Path, text: str) -> Campaign:
    path = folder / "c.toml"
    path.write_text(text)
    return load_campaign(path)


def test_every_value_meets_every_other(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").touch()
    campaign = read(tmp_path, GOOD)
    assert (campaign.title, campaign.worst, campaign.limits.cpu_s) == ("Lags", "-travel_rms_deg", 20.0)
    settings = [
        (case.settings["rig"], case.settings["effects"], case.settings["seed"]) for case in campaign.cases
    ]
    mine = str((tmp_path / "mine.toml").resolve())
    lags = ["rotor_lag=0.1", "input_delay=0.02"]
    assert settings == [(r, e, s) for r in ("makki2024", mine) for e in ([], lags) for s in (3, 4, 5)]
    assert len({case.name for case in campaign.cases}) == 12
    assert campaign.cases[-1].name == "mine rotor_lag=0.1+input_delay=0.02 seed 5"
    assert all(case.settings["draw"] == {"M_*": {"share": 0.03}} for case in campaign.cases)


def test_a_case_is_another_when_a_setting_or_the_code_is(tmp_path: Path) -> None:
    first, second, *_ = read(tmp_path, GOOD).cases
    assert first.key("code") == read(tmp_path, GOOD).cases[0].key("code")
    assert len({first.key("code"), first.key("other code"), second.key("code")}) == 3


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[cases]", "[cases", "is not TOML"),
        ('work = "fly"', 'work = "swim"', "work = 'swim' is unknown"),
        ('work = "fly"', "", "work is missing"),
        ('work = "fly"', 'work = "module:"', "work = 'module:' is unknown"),
        ("seed =", "sead =", r"\[cases\] has the unknown name sead"),
        ("to = 5", "to = 1", r"\[cases\] seed is not a range"),
        ("to = 5", "to = 900000", "seed has 899998 values"),
        ("{ from = 3, to = 5 }", "[]", "seed has no value"),
        ("{ from = 3, to = 5 }", "[1, 1]", "two cases have the name"),
        ("{ from = 3, to = 5 }", '"one"', "seed = 'one' is invalid; each value is a whole number"),
        ("{ from = 3, to = 5 }", "-1", "seed = -1 is too small"),
        ("share = 0.03", "share = 3", "share = 3 is invalid"),
        ("share = 0.03", "part = 3", "needs exactly one of share, factor, range"),
        ("cpu_s = 20", "cpu_s = 0", "cpu_s = 0 is invalid"),
        ("cpu_s = 20", "cpus = 2", r"\[limits\] has the unknown name cpus"),
        ("[draw]", "[drew]", "the file has the unknown name drew"),
    ],
)
def test_what_is_wrong_is_said(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in GOOD
    with pytest.raises(CampaignError, match=message) as caught:
        read(tmp_path, GOOD.replace(old, new))
    assert "\n" not in str(caught.value)
    assert caught.value.remedy


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.sampled_from(["from", "to", "share", "range", "x"]), inner, max_size=3)
    ),
    max_leaves=8,
)
TABLES = st.dictionaries(
    st.sampled_from(["title", "work", "worst", "cases", "draw", "limits", "other"]),
    VALUES | st.dictionaries(st.sampled_from(["rig", "seed", "effects", "cpu_s"]), VALUES, max_size=3),
)


@pytest.mark.medium
@settings(max_examples=60, deadline=None)
@given(TABLES, st.sampled_from(["fly", "diagnose", "a.b:c", None]))
def test_any_table_is_a_campaign_or_refused(table: dict[str, Any], work: str | None) -> None:
    from heli_lab.apps.campaign.file import _campaign_of_table

    try:
        campaign = _campaign_of_table(Path("c.toml"), {**table, **({"work": work} if work else {})})
    except CampaignError:
        return
    assert all(isinstance(case.key("code"), str) for case in campaign.cases)


def test_rigs_are_drawn_as_said_and_a_seed_draws_the_same_again() -> None:
    rig = load_rig("makki2024")
    how: dict[str, Any] = {
        "M_*": {"share": 0.03},
        "friction_*": {"factor": 2.0},
        "rotor_lag": {"range": [0.05, 0.15]},
    }
    lags, masses, frictions = [], [], []
    for seed in range(40):
        draw = draw_rig(rig, ["rotor_lag", "input_delay=0.02"], how, seed)
        true, effects = draw.rig, draw.effects
        name, _, lag = effects[0].partition("=")
        assert (name, effects[1]) == ("rotor_lag", "input_delay=0.02")
        lags.append(float(lag))
        masses.append(true["M_w"].value / rig["M_w"].value)
        frictions.append(true["friction_travel"].value / rig["friction_travel"].value)
        assert true["thrust_gain"] == rig["thrust_gain"]
        # The table has each number that was drawn, and no other.
        changed = {name for name in rig if true[name].value != rig[name].value}
        assert set(draw.row) == {f"drawn_{name}" for name in (*changed, "rotor_lag")}
        assert draw.row["drawn_M_w"] == true["M_w"].value and draw.row["drawn_rotor_lag"] == float(lag)
    assert 0.05 <= min(lags) < 0.07 and 0.13 < max(lags) <= 0.15
    assert 0.97 <= min(masses) < 0.98 and 1.02 < max(masses) <= 1.03
    assert 0.5 <= min(frictions) < 0.65 and 1.5 < max(frictions) <= 2.0
    assert draw_rig(rig, ["rotor_lag"], how, 3) == draw_rig(rig, ["rotor_lag"], how, 3)
    with pytest.raises(CampaignError, match="no number of rig makki2024 and no effect"):
        draw_rig(rig, [], how, 1)


def test_tolerances_draw_what_the_file_says_of_each_number() -> None:
    rig = load_rig("makki2024")
    drawn_z = []
    for seed in range(60):
        draw = draw_rig(rig, [], "tolerances", seed)
        true = draw.rig
        assert draw.row["drawn_thrust_gain"] == true["thrust_gain"].value
        number = rig["thrust_gain"]
        drawn_z.append((true["thrust_gain"].value - number.value) / number.tolerance)
        assert true["g"] == rig["g"] or rig["g"].tolerance > 0.0
    rms = (sum(z**2 for z in drawn_z) / len(drawn_z)) ** 0.5
    assert 0.4 < rms < 0.6


def test_a_function_that_is_built_into_python_has_a_digest_as_any_other() -> None:
    # Frozen, built in, and with a file.
    assert len({code_digest([work]) for work in ("os:getpid", "sys:exit", "json:dumps")}) == 3
