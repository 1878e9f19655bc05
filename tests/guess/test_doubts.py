"""Delays and limits that a file does not decide are doubted, and the doubt names the other value."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from heli_host.data.arrays import Floats
from heli_host.data.tables import Angle, Column, Profile, Table, Voltage
from heli_lab.setup.guess.evidence import pooled_fits
from heli_lab.setup.guess.lags import lag_ambiguities
from heli_lab.setup.guess.limits import limited, one_way_nats
from heli_lab.setup.guess.regression.acceleration_fit import RegressionFit
from heli_lab.setup.guess.regression.reference import Reference
from heli_lab.setup.guess.regression.scales import AXES

REVERSING = Reference({}, {}, 6.0, -25.0, 1.0, {}, 12.0, reverses=True)
ONE_WAY = replace(REVERSING, reverses=False)
PROFILE = Profile(
    {axis: Angle(axis) for axis in AXES}, {"front": Voltage("front"), "back": Voltage("back")}, "t"
)


def fits(elevation_s: float, range_s: tuple[float, float], pitch_s: float = 0.1) -> dict[str, RegressionFit]:
    return {
        "elevation": RegressionFit(40.0, 1.0, elevation_s, range_s),
        "pitch": RegressionFit(40.0, 1.0, pitch_s, (pitch_s, pitch_s)),
        "travel": RegressionFit(40.0, 1.0, 0.0, (-0.02, 0.02)),
    }


def subjects(regressions: dict[str, RegressionFit]) -> list[str]:
    return [ambiguity.subject for ambiguity in lag_ambiguities(regressions)[0]]


def test_a_short_delay_of_elevation_is_doubted_if_the_motion_excludes_the_lag_of_pitch() -> None:
    assert subjects(fits(0.18, (0.16, 0.20))) == ["elevation's time"]
    assert subjects(fits(0.18, (0.04, 0.30))) == []
    assert subjects(fits(0.16, (0.14, 0.18))) == []
    assert subjects(fits(0.02, (0.0, 0.04))) == []


def test_a_doubt_of_a_weakly_excited_elevation_names_the_possible_delays() -> None:
    (ambiguity,), _ = lag_ambiguities(fits(0.22, (0.06, 0.40)))
    assert ambiguity.alternative == "0.12 s later than pitch (-0.04 to 0.30 s are possible)"
    (ambiguity,), _ = lag_ambiguities(fits(0.24, (0.22, 0.26)))
    assert ambiguity.alternative == "0.14 s later than pitch"


def test_voltages_that_act_without_any_lag_were_logged_late() -> None:
    (ambiguity,), _ = lag_ambiguities(fits(0.0, (0.0, 0.0), pitch_s=0.0))
    assert ambiguity.alternative == "late by about 0.10 s relative to the angles"
    assert "as only a simulation without rotor lag does" in ambiguity.reason
    assert subjects(fits(0.04, (0.04, 0.04), pitch_s=0.04)) == []


def test_the_possible_lags_of_several_files_are_averaged_by_their_weight() -> None:
    weak, strong = (
        {axis: RegressionFit(nats, 1.0, 0.1, (0.1 - half_s, 0.1 + half_s)) for axis in AXES}
        for nats, half_s in ((10.0, 0.08), (30.0, 0.04))
    )
    assert pooled_fits([weak, strong])["elevation"].lag_range_s == pytest.approx((0.05, 0.15))


def table(front_V: float, back_V: float) -> Table:
    """Rows that have these voltages in every tenth row, and 3 V in all others."""
    rows: Floats = np.arange(200, dtype=np.float64)
    columns = {name: Column(np.sin(0.01 * rows)) for name in AXES}
    for name, volts_V in (("front", front_V), ("back", back_V)):
        values: Floats = np.full(rows.size, 3.0)
        values[::10] = volts_V
        columns[name] = Column(values)
    return Table("x.csv", {"t": Column(0.01 * rows, "s"), **columns})


@pytest.mark.parametrize(
    ("nats", "reverses", "clip_V", "chosen"),
    [
        (1.0, True, None, None),
        (7.0, True, None, "as logged, down to -4.0 V"),
        (-1.0, False, (0.0, 12.0), "clipped to 0 V"),
        (-7.0, False, None, None),
    ],
)
def test_commands_below_zero_are_limited_as_the_motion_and_the_rig_say(
    nats: float, reverses: bool, clip_V: tuple[float, float] | None, chosen: str | None
) -> None:
    reference = REVERSING if reverses else ONE_WAY
    profile, ambiguities = limited([table(-4.0, 5.0)], PROFILE, reference, lambda: nats)
    assert profile.clip_V == clip_V
    assert [ambiguity.chosen for ambiguity in ambiguities] == ([chosen] if chosen else [])
    for ambiguity in ambiguities:
        assert {ambiguity.chosen, ambiguity.alternative} == {"clipped to 0 V", "as logged, down to -4.0 V"}
        assert "set clip_V to [0, 12]" in ambiguity.reason


def test_motors_that_seem_to_push_down_most_of_the_time_raise_no_question_of_limits() -> None:
    assert limited([table(-4.0, -5.0)], PROFILE, ONE_WAY, lambda: 0.0)[1] != []
    upside_down = {role: replace(voltage, sign=-1.0) for role, voltage in PROFILE.voltages.items()}
    assert limited([table(0.0, 5.0)], replace(PROFILE, voltages=upside_down), ONE_WAY, lambda: 0.0)[1] == []


def test_a_log_without_commands_below_zero_asks_no_question() -> None:
    def unused() -> float:
        raise AssertionError

    assert limited([table(0.0, 5.0)], PROFILE, ONE_WAY, unused) == (PROFILE, [])


def test_commands_below_zero_keep_the_limit_of_the_supply() -> None:
    profile, ambiguities = limited([table(-4.0, 15.0)], PROFILE, ONE_WAY, lambda: 7.0)
    assert profile.clip_V == (0.0, 12.0)
    assert [ambiguity.subject for ambiguity in ambiguities] == [
        "the voltages' limit",
        "the voltages' lower limit",
    ]


def test_the_better_explained_axes_decide_whether_motors_reverse() -> None:
    def regress(limits: tuple[float, float]) -> Mapping[str, RegressionFit]:
        nats = 30.0 if limits[0] == 0.0 else 20.0
        return {"elevation": RegressionFit(nats, 1.0), "pitch": RegressionFit(2.0 * nats, 1.0)}

    assert one_way_nats(regress, (-5.0, 5.0)) == 30.0
