"""A split of a few cases with flights of a second, for tests of formats, runs and scores."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from heli_host.data.flight import Flight
from heli_sim.rig import load_rig

from heli_benchmark.splits import causes_content
from heli_benchmark.task import NOTHING, UNLISTED, Answer, Estimate, Split, read_split, write_case

LAG = {"rotor_lag": {"visibility_std": 80.0, "parameters": {"rotor_lag_s": 0.1}}}
FRICTION = {
    "coulomb_friction.travel": {"visibility_std": 30.0, "parameters": {"coulomb_friction_travel_Nm": 0.02}}
}
FAINT = {"axis_tilt": {"visibility_std": 9.0, "parameters": {"axis_tilt_x_rad": 0.01}}}
TRUTHS: tuple[tuple[dict[str, Any], dict[str, float]], ...] = (
    ({}, {}),
    (LAG, {}),
    (LAG | FRICTION, {}),
    (LAG | FAINT, {}),
    ({}, {"draught": 40.0}),
    ({}, {}),
)
"""Listed causes and unlisted equations of each case."""


def make(folder: Path, cases: int = len(TRUTHS)) -> Split:
    """Write the first `cases` of the split."""
    for name in ("cases", "truth"):
        (folder / name).mkdir(parents=True)
    content = {"schema": 1, "split": "small", "seed": 0, "causes": causes_content()}
    (folder / "causes.json").write_text(json.dumps(content))
    t_s = 0.01 * np.arange(100.0)
    flight = Flight(t_s, 1.5 + 0.0 * t_s, 1.5 + 0.0 * t_s, 0.1 * np.sin(t_s), 0.0 * t_s, 0.0 * t_s)
    for number, (causes, unlisted) in enumerate(TRUTHS[:cases], 1):
        place = folder / "cases" / f"case-{number:03d}"
        place.mkdir()
        write_case(place, load_rig("makki2024"), (flight,), (flight,))
        truth = {"schema": 1, "case": place.name, "causes": causes, "unlisted": unlisted}
        (folder / "truth" / f"{place.name}.json").write_text(json.dumps(truth))
    return read_split(folder)


def informed(truth: dict[str, Any]) -> Answer:
    """Answer of a method that knows the truth."""
    names = [*truth["causes"], *([UNLISTED] if truth["unlisted"] else [])]
    sizes = {name: value for of in truth["causes"].values() for name, value in of["parameters"].items()}
    return Answer(
        dict.fromkeys(names or [NOTHING], 1.0),
        {name: Estimate(value, 0.01 * abs(value) or 1e-6) for name, value in sizes.items()},
    )
