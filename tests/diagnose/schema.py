"""Checks the JSON of a diagnosis: keys, types and units that docs/reference/json.md promises."""

import json
import math
from typing import Any

from heli_host.fly.plan import Plan
from heli_sim.model.effects import catalogue

AXES = {"elevation", "pitch", "travel"}
VERDICTS = {"explained", "cause_found", "ambiguous", "unexplained"}


def conforms(numbers: dict[str, Any], silent: bool = False) -> None:
    """Check the whole JSON object; it is `silent`, with null for numbers, if the flights excite nothing."""
    json.dumps(numbers, allow_nan=False)
    assert numbers["verdict"] in VERDICTS
    for cause in numbers["causes"]:
        _cause(cause)
    ids = [cause["effect"] for cause in numbers["causes"]]
    assert len(ids) == len(set(ids))

    assert numbers["rig"]["name"] and numbers["rig"]["model"]
    if not silent:
        assert numbers["rig"].keys() == {"name", "model", "numbers", "constants"}
        for number in numbers["rig"]["constants"].values():
            assert number.keys() == {"value", "std", "unit"}
            assert number["std"] > 0.0
        for number in numbers["rig"]["numbers"].values():
            assert number.keys() == {"value", "std", "prior", "unit"}
            assert 0.0 < number["std"] <= number["prior"]["std"] * 1.001

    residual = numbers["residual"]
    assert residual["axis"].keys() == AXES
    for error in (*residual["axis"].values(), residual["normalised"]):
        assert all(_number(error[when], silent) for when in ("before", "after"))
    assert isinstance(residual["white"], dict)

    noise = numbers["thrust_noise"] if not silent else None
    if noise is not None:
        assert noise.keys() == {"supply", "difference"}
        for estimate in noise.values():
            assert estimate.keys() == {"std", "correlation_time_s", "log_likelihood_ratio"}

    gain = numbers["gain"]
    assert gain["metric"] in (
        "2 s free-run rms on the validation flights, deg",
        "2 s free-run rms on the fitted flights, deg",
    )
    assert gain["axis"].keys() == AXES
    assert set(gain["horizons"]) == {"0.5", "1", "2"}
    assert gain["horizons"]["2"]["axis"] == gain["axis"]
    for error in (error for horizon in gain["horizons"].values() for error in horizon["axis"].values()):
        assert all(_number(error[key], silent) for key in ("before", "after", "ratio"))
        if not silent:
            low, high = error["interval95"]
            assert low <= high
            assert math.isclose(error["ratio"], error["after"] / error["before"] if error["before"] else 1.0)

    for flight in gain["calibration"]:
        assert flight["before"].keys() == flight["after"].keys()
        for estimate in (*flight["before"].values(), *flight["after"].values()):
            assert estimate.keys() == {"value", "std", "prior", "unit"}
            assert estimate["std"] <= estimate["prior"]["std"] * 1.001
    missing = numbers["unexplained"]
    if missing is not None:
        assert missing["axis"] in AXES
        assert all(isinstance(effect, str) for effect in missing["correlates_with"])
        assert 0.0 <= missing["share_of_variance"] <= 1.0
    next_flight = numbers["next_flight"]
    if next_flight is not None:
        assert next_flight["why"].endswith(".")
        Plan.parse(next_flight["plan"], "next flight").check()


def _cause(cause: dict[str, Any]) -> None:
    """Check a cause against the declaration of its effect."""
    kind = catalogue()[cause["effect"]]
    units = {quantity.name: quantity.unit for quantity in kind.parameters}
    assert cause["parameters"].keys() == units.keys()
    for name, estimate in cause["parameters"].items():
        assert estimate.keys() == {"value", "std", "unit"}
        assert estimate["unit"] == units[name]
        assert _number(estimate["value"])
        assert estimate["std"] >= 0.0
    assert 0.0 < cause["confidence"] < 1.0
    assert cause["evidence"]
    assert all(id_ in catalogue() and id_ != cause["effect"] for id_ in cause["ambiguous_with"])


def _number(value: object, may_be_null: bool = False) -> bool:
    """Whether a value is a finite number, or null where that is allowed."""
    return (value is None and may_be_null) or (isinstance(value, float) and math.isfinite(value))
