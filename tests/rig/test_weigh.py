"""Bench tests of a rig that MuJoCo swings, read as a person reads them, find the numbers that were hidden."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from heli_benchmark.plant import mujoco_rig
from heli_sim.bench import TEMPLATE, bench_tests_from, weigh
from heli_sim.errors import RigError
from heli_sim.rig import Rig, load_rig

from tests.cli.terminal import Terminal, refusal

pytestmark = pytest.mark.medium

mujoco = pytest.importorskip("mujoco")
HIDDEN = {"M_w": 1.571, "friction_pitch": 0.012, "L_phi": 0.032, "thrust_gain": 0.66, "dead_zone": 0.93}


def truth() -> Rig:
    return load_rig("makki2024").replace(**HIDDEN)


def swing_pitch_in_mujoco(rig: Rig, from_deg: float, swings: int) -> tuple[float, float]:
    """Let pitch go in MuJoCo, elevation and travel held: time of so many swings, and the amplitude then."""
    model = mujoco_rig(rig)
    data = mujoco.MjData(model)
    data.joint("pitch").qpos[0] = np.deg2rad(from_deg)
    angles = []
    for _ in range(30_000):
        for held in ("elevation", "travel"):
            data.joint(held).qpos[0] = data.joint(held).qvel[0] = 0.0
        mujoco.mj_step(model, data)
        angles.append(float(np.rad2deg(data.joint("pitch").qpos[0])))
    seen = np.array(angles)
    tops = np.flatnonzero((seen[1:-1] > seen[:-2]) & (seen[1:-1] >= seen[2:])) + 1
    return float(tops[swings - 1]) * 1e-3, float(seen[tops[swings - 1]])


def balanced_deg(rig: Rig) -> float:
    """Where the arm stays in MuJoCo, its fall much braked."""
    model = mujoco_rig(rig.replace(friction_elevation=2.0))
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 40_000)
    return float(np.rad2deg(data.joint("elevation").qpos[0]))


def bench(rig: Rig) -> dict[str, Any]:
    volts = [2.0, 3.0, 4.5]
    grams = [round(1e3 * rig["thrust_gain"].value * (v - rig["dead_zone"].value) / 9.81) for v in volts]
    seconds, to_deg = swing_pitch_in_mujoco(rig, 10.0, 3)
    return {
        "thrust": {"volts_V": volts, "front_g": grams, "back_g": grams},
        "balance": {"elevation_deg": round(balanced_deg(rig), 1)},
        "swing": [
            {
                "axis": "pitch",
                "swings": 3,
                "seconds": round(seconds, 1),
                "from_deg": 10.0,
                "to_deg": round(to_deg, 1),
            }
        ],
    }


def test_numbers_that_were_hidden_are_found_within_their_tolerances() -> None:
    known = load_rig("makki2024")
    weighed = weigh(known, *bench_tests_from(bench(truth())))
    assert {"thrust_gain", "dead_zone", "friction_pitch"} <= set(weighed.determined)
    for name in weighed.determined:
        number = weighed.rig[name]
        assert abs(number.value - truth()[name].value) <= 1.3 * number.tolerance, name
        assert number.tolerance < known[name].tolerance
        assert "bench" in number.source
    assert weighed.rig["thrust_gain"].tolerance < 0.02
    # The tests together show more than any single number.
    assert all(test.off < 0.5 for test in weighed.tested if "thrust" not in test.what)
    before = {test.what: abs(test.before - test.read) / test.tolerance for test in weighed.tested}
    assert before["elevation of balance"] > 1.0 and before["decrement of pitch"] > 1.0


def filled() -> str:
    """The template with the readings of a rig like the paper's."""
    table = TEMPLATE
    for blank, reading in (
        ('front_g = ["?", "?", "?"]', "front_g = [60, 119, 179]"),
        ('back_g = ["?", "?", "?"]', "back_g = [59, 119, 178]"),
        ('elevation_deg = "?"', "elevation_deg = -22.1"),
        ('swings = "?"', "swings = 5"),
        ('seconds = "?"', "seconds = 13.2"),
        ('from_deg = "?"', "from_deg = 13"),
        ('to_deg = "?"', "to_deg = 4"),
    ):
        assert blank in table
        table = table.replace(blank, reading)
    return table


def test_reading_that_no_such_rig_gives_is_said(terminal: Terminal) -> None:
    Path("bench.toml").write_text(filled().replace("seconds = 13.2", "seconds = 60.0"))
    Path("good.toml").write_text(filled())
    result = terminal("rig", "weigh", "makki2024", "bench.toml", "--save-rig", "new.toml")
    assert result.code == 0, result
    # A pendulum of 12 s hangs from its own middle: lengths and masses would have to be far from stated.
    assert "tolerances off: a wrong reading" in result.out
    assert "tolerances off" not in terminal("rig", "weigh", "makki2024", "good.toml").out
    assert load_rig("new.toml").name == "new"


def test_template_is_refused_until_it_is_filled_in(terminal: Terminal) -> None:
    assert terminal("rig", "weigh", "makki2024", "--template", "bench.toml").code == 0
    arguments = ("rig", "weigh", "makki2024", "bench.toml", "--save-rig", "new.toml")
    line = refusal(terminal(*arguments), code=2)
    assert "[thrust] front_g is not filled in yet; write your reading" in line
    lines = filled().splitlines()
    # Without the line of the digest, which the program adds.
    template = Path("bench.toml").read_text().splitlines()[: len(lines)]
    changed = [k for k, (old, new) in enumerate(zip(template, lines, strict=True)) if old != new]
    for k in changed:
        Path("bench.toml").write_text("\n".join([*lines[:k], template[k], *lines[k + 1 :]]))
        name = template[k].partition(" ")[0]
        assert f"{name} is not filled in yet" in refusal(terminal(*arguments), code=2)
    assert len(changed) == 7 and not Path("new.toml").exists()


def test_template_filled_in_is_read(terminal: Terminal) -> None:
    Path("bench.toml").write_text(filled())
    result = json.loads(terminal("rig", "weigh", "makki2024", "bench.toml", "--json", "-").out)
    assert result["numbers"]["thrust_gain"]["unit"] == "N/V"
    assert {test["what"] for test in result["tests"]} >= {"elevation of balance", "5 swings of pitch"}


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ("", "no bench test"),
        ("[trust]\n", "unknown bench test [trust]"),
        ("thrust = 3", "is not a table"),
        ("[thrust]\nvolts_V = [1, 2]\n", "needs volts_V"),
        ("[thrust]\nvolts_V = [1, 2]\nfront_g = [1]\n", "same length"),
        ("[thrust]\nvolts_V = [1, 2]\nfront_g = [0, 0]\n", "too few for a line"),
        ("[thrust]\nvolts_V = ['a']\nfront_g = [1]\n", "not a list of numbers"),
        ("[balance]\n", "lacks elevation_deg"),
        ("[balance]\nelevation_deg = true\n", "is not a number"),
        ("[balance]\nelevation_deg = nan\n", "is not a number"),
        ("[balance]\nelevation_deg = -20\ntolerance_deg = 0\n", "above 0"),
        ("[[swing]]\naxis = 'travel'\n", "travel has no rest"),
        (
            "[[swing]]\naxis = 'pitch'\nswings = 2\nseconds = 5\nfrom_deg = 3\nto_deg = 4\n",
            "has a growing amplitude",
        ),
        ("[swing]\naxis = 'pitch'\n", "must be a list"),
        ("[balance", "is not TOML"),
    ],
)
def test_tests_that_cannot_be_are_refused_in_one_line(terminal: Terminal, table: str, message: str) -> None:
    Path("bench.toml").write_text(table)
    assert message in refusal(terminal("rig", "weigh", "makki2024", "bench.toml"), code=2)


def test_arm_that_does_not_balance_is_said() -> None:
    with pytest.raises(RigError, match="does not balance"):
        weigh(
            load_rig("makki2024").replace(L_theta=-0.03, L_phi=0.01),
            *bench_tests_from({"balance": {"elevation_deg": -20.0}}),
        )
