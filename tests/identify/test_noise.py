"""`identify` refuses sensor noise that no voltage explains, and accepts a hover, also under disturbances."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from heli_host.data.arrays import Floats
from heli_host.data.flight import Flight
from heli_host.data.log.table import write_csv
from heli_host.fly.plan import Plan
from heli_lab.errors import NotExcited
from heli_lab.fit.identification import identify
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import parse_effects
from heli_sim.rig import load_rig

from tests.cli.terminal import Terminal, refusal
from tests.identify.made import flown_by_plan, perturbed

ROWS, STEP_S = 6000, 0.002
COUNT_RAD = 2.0 * np.pi / 4096
HOLD = 'title = "hold"\n[[segment]]\nkind = "hold"\nduration_s = 12\n'
STRONGEST = ("random_torque.elevation=0.02", "random_torque.pitch=0.006", "random_torque.travel=0.012")
"""The strongest disturbances of heli_benchmark, N m."""


def smoothed(values: Floats, pole: float) -> Floats:
    """Filter each column by a first-order low-pass with a pole, without normalising the gain."""
    outputs = np.empty_like(values)
    state = np.zeros(values.shape[1])
    for k, row in enumerate(values):
        state = pole * state + row
        outputs[k] = state
    return outputs


def noise(kind: str, seed: int, *, in_counts: bool = False) -> Flight:
    """Make twelve seconds of angles of an IMU that lies still, with voltages that are independent of them.

    Kinds are white noise, a random walk, slow noise, and a random walk of the rate ("drift").
    """
    random = np.random.default_rng(seed)
    white = random.standard_normal((ROWS, 3))
    angles = {
        "white": lambda: np.radians(2.0) * white,
        "walk": lambda: np.radians(0.05) * np.cumsum(white, axis=0),
        "slow": lambda: np.radians(0.2) * smoothed(white, 0.995),
        "drift": lambda: np.radians(0.004) * np.cumsum(smoothed(white, 0.98), axis=0),
    }[kind]()
    if in_counts:
        angles = COUNT_RAD * np.round(angles / COUNT_RAD)
    t_s: Floats = STEP_S * np.arange(ROWS, dtype=np.float64)
    sine = 1.7 + 0.3 * np.sin(2.0 * np.pi * np.column_stack((t_s / 3.0, t_s / 3.0 + 0.2)))
    volts: Floats = sine if seed % 2 else 1.7 + 0.2 * random.standard_normal((ROWS, 2))
    columns = np.array([*volts.T, *angles.T], np.float64)
    return Flight(t_s, columns[0], columns[1], columns[2], columns[3], columns[4])


@pytest.mark.medium
@pytest.mark.parametrize("rig", ["makki2024", "quanser-course"])
@pytest.mark.parametrize("kind", ["white", "walk", "slow", "drift"])
def test_noise_is_not_accepted_as_a_flight(kind: str, rig: str) -> None:
    for seed in (101, 102):
        log = noise(kind, seed, in_counts=seed == 102)
        with pytest.raises(NotExcited, match="the voltages do not explain the motion"):
            identify(MultibodyModel(), load_rig(rig), [log], max_fit_s=20.0)


@pytest.mark.medium
def test_noise_is_refused_in_a_line_and_writes_no_rig(terminal: Terminal, tmp_path: Path) -> None:
    write_csv(noise("white", 103), tmp_path / "imu.csv")
    arguments = ("identify", "imu.csv", "--save-rig", "new.toml", "--free", "thrust_gain")
    line = refusal(terminal(*arguments), code=2)
    assert line.startswith("error: imu.csv: the voltages do not explain the motion: ")
    assert not (tmp_path / "new.toml").exists()
    assert terminal(*arguments, "--skip-sign-check").code == 0 and (tmp_path / "new.toml").exists()


@pytest.mark.slow
@pytest.mark.parametrize("effects", [(), STRONGEST], ids=["no disturbances", "the strongest disturbances"])
def test_hover_is_accepted_as_a_flight(effects: tuple[str, ...]) -> None:
    # With two free parameters the others keep their errors, but the shape of the motion is explained.
    for seed in (201, 202):
        rig = load_rig("makki2024") if effects else perturbed(seed)
        model = MultibodyModel(parse_effects(effects)) if effects else None
        hover = flown_by_plan(rig, seed, Plan.parse(HOLD, "hold"), model)
        known = load_rig("makki2024")
        identified = identify(MultibodyModel(), known, [hover], free=("thrust_gain", "friction_pitch"))
        assert identified.training[0].seconds_used > 8.0


@pytest.mark.slow
def test_validation_on_noise_is_refused_with_the_name_of_the_noise() -> None:
    hover = flown_by_plan(perturbed(203), 203, Plan.parse(HOLD, "hold"))
    with pytest.raises(NotExcited, match=r"^validation 1: the voltages do not explain"):
        identify(
            MultibodyModel(),
            load_rig("makki2024"),
            [hover],
            validation=[noise("white", 104)],
            free=("thrust_gain",),
        )
