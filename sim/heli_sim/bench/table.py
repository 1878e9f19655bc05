"""Bench tests as a TOML table, and a template to fill in."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from heli_sim.bench.weigh import SCALE_N, Balance, Swing, Thrust, ThrustCurve
from heli_sim.errors import RigError

BLANK: Final = "?"
"""A reading of the template that is not filled in yet."""
TEMPLATE: Final = """\
# Bench tests of a rig, for: heli-host rig weigh RIG THIS.toml --save-rig NEW.toml
# Write a number for each "?". Remove a table whose test was not done.
# Tolerances are half widths that hold the truth with 95 %.

# A scale under each rotor, the arm held; run the motors; read at three voltages or more.
[thrust]
volts_V = [2, 3, 4]
front_g = ["?", "?", "?"]
back_g = ["?", "?", "?"]
scale_g = 1

# Motors off, pitch level: where the arm stays in the air. Leave this out where it rests on the table.
[balance]
elevation_deg = "?"
tolerance_deg = 0.5

# Motors off, elevation and travel held: let pitch go, time whole swings, read the amplitude before and after.
[[swing]]
axis = "pitch"
swings = "?"
seconds = "?"
tolerance_s = 0.3
from_deg = "?"
to_deg = "?"
tolerance_deg = 0.5
"""


def bench_tests_from(table: Mapping[str, Any]) -> tuple[Thrust | None, Balance | None, list[Swing]]:
    """Read bench tests from a TOML `table`; docs/how-to/describe-your-rig.md shows one."""
    unknown = sorted(table.keys() - {"thrust", "balance", "swing"})
    if unknown:
        raise RigError(f"unknown bench test [{unknown[0]}]", "give [thrust], [balance] or [[swing]]")
    _refuse_blanks(table)
    thrust = _read_thrust_test(_subtable(table, "thrust")) if "thrust" in table else None
    balance = None
    if "balance" in table:
        balance = Balance(
            **_numbers_by_name(
                "[balance]", _subtable(table, "balance"), ("elevation_deg",), ("tolerance_deg",)
            )
        )
        _check_positive("[balance]", tolerance_deg=balance.tolerance_deg)
    swing_tables = table.get("swing", [])
    if not isinstance(swing_tables, list) or not all(isinstance(swing, dict) for swing in swing_tables):
        raise RigError("swing must be a list of tables", "write [[swing]] above each")
    return thrust, balance, [_read_swing_test(swing) for swing in swing_tables]


def _refuse_blanks(table: Mapping[str, Any]) -> None:
    """Refuse a table in which a reading of the template is still empty."""
    for name, value in table.items():
        table_name = f"[[{name}]]" if isinstance(value, list) else f"[{name}]"
        for entry in value if isinstance(value, list) else [value]:
            for key, reading in entry.items() if isinstance(entry, dict) else ():
                if BLANK in (reading if isinstance(reading, list) else [reading]):
                    raise RigError(
                        f"{table_name} {key} is not filled in yet",
                        f'write your reading in place of each "{BLANK}", or remove {table_name}',
                    )


def _read_thrust_test(table: Mapping[str, Any]) -> Thrust:
    """Read the thrust test: voltages [V] and readings of a scale [g] for one or both rotors."""
    allowed = {"volts_V", "front_g", "back_g", "scale_g"}
    if set(table) - allowed or "volts_V" not in table or not {"front_g", "back_g"} & set(table):
        raise RigError(
            "[thrust] needs volts_V, and front_g or back_g or both", f"give only {', '.join(sorted(allowed))}"
        )
    volts = _list_of_readings("volts_V", table["volts_V"])
    sides = [_list_of_readings(name, table[name]) for name in ("front_g", "back_g") if name in table]
    if any(len(side) != len(volts) for side in sides):
        raise RigError("[thrust] needs one reading per voltage", "give lists of the same length")
    scale_g = float(
        _numbers_by_name("[thrust]", {"scale_g": table.get("scale_g", 1.0)}, ("scale_g",), ())["scale_g"]
    )
    _check_positive("[thrust]", scale_g=scale_g)
    # If only one rotor was on the scale, both are assumed equal.
    grams = np.array([sides[0], sides[-1]]).T
    curve = ThrustCurve(np.repeat(np.array(volts)[:, None], 2, axis=1), grams * SCALE_N)
    if len(sides) == 1:
        curve = ThrustCurve(curve.volts_V[:, :1], curve.thrust_N[:, :1])
    return Thrust(curve, scale_g * SCALE_N)


def _read_swing_test(table: Mapping[str, Any]) -> Swing:
    """Read a swing test: the time of some swings [s], and the amplitudes before and after them [deg]."""
    axis = table.get("axis")
    if axis not in ("elevation", "pitch"):
        raise RigError(
            f"[[swing]] has axis = {axis!r}",
            'give "elevation" or "pitch", because travel has no rest position',
        )
    needed = ("swings", "seconds", "from_deg", "to_deg")
    optional = ("tolerance_s", "tolerance_deg", "elevation_deg")
    number_table = {name: value for name, value in table.items() if name != "axis"}
    numbers = _numbers_by_name("[[swing]]", number_table, needed, optional)
    swing = Swing(axis, swings=round(numbers.pop("swings")), **numbers)
    _check_positive(
        "[[swing]]",
        swings=swing.swings,
        seconds=swing.seconds,
        to_deg=swing.to_deg,
        tolerance_s=swing.tolerance_s,
        tolerance_deg=swing.tolerance_deg,
    )
    if swing.from_deg <= swing.to_deg:
        raise RigError(
            "[[swing]] has a growing amplitude",
            "give the larger amplitude as from_deg, before the timed swings",
        )
    return swing


def _subtable(table: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    """Return a table within a `table`; a RigError if the entry is something else."""
    entry = table[name]
    if not isinstance(entry, dict):
        raise RigError(f"{name} is not a table", f"write [{name}] above its numbers")
    return entry


def _list_of_readings(name: str, value: object) -> list[float]:
    """Return a list of readings; a RigError if `value` is something else."""
    if not isinstance(value, list) or not value or not all(_is_number(number) for number in value):
        raise RigError(f"[thrust] {name} is not a list of numbers", "write it as [2, 4, 6]")
    return [float(number) for number in value]


def _numbers_by_name(
    table_name: str, table: Mapping[str, Any], needed: Sequence[str], optional: Sequence[str]
) -> dict[str, float]:
    """Return the numbers of a table by name; a RigError names a missing, unknown or invalid key."""
    for name in needed:
        if name not in table:
            raise RigError(f"{table_name} lacks {name}", "add it")
    for name, value in table.items():
        if name not in (*needed, *optional):
            raise RigError(f"{table_name} has no {name}", f"give only {', '.join((*needed, *optional))}")
        if not _is_number(value):
            raise RigError(f"{table_name} {name} = {value!r} is not a number", "give a number")
    return {name: float(value) for name, value in table.items()}


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and bool(np.isfinite(value))


def _check_positive(table_name: str, **values: float) -> None:
    """Raise a RigError for the first of the `values` that is not positive."""
    for name, value in values.items():
        if not value > 0.0:
            raise RigError(f"{table_name} {name} = {value:g} is not positive", "give a number above 0")
