"""The Rig class, its encoders, and its TOML files."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from heli_host.data.arrays import Floats
from heli_host.data.files import TOML_BYTES, decode_text, parse_toml, read_file, toml_string, write_signed
from heli_host.errors import file_remedy

from heli_sim.errors import RigError
from heli_sim.rig.schema import (
    COMMON_COUNTS,
    ENCODER_COUNTS,
    ENCODER_DIRECTIONS,
    RIG_QUANTITIES,
    STATED_INERTIAS,
    TRAVEL_RATIO,
    UNSTATED,
    check_size,
    inertia_range_kg_m2,
)

_FOLDER: Final = Path(__file__).parent
_FIELDS: Final = ("value", "unit", "tolerance", "source")
_TEXTS: Final = ("name", "description")
# Everything else is a length, a mass, a gain or a limit of which there must be some.
_MAY_BE_ZERO: Final = frozenset(
    {
        "M_h",
        "M_l",
        "dead_zone",
        "friction_elevation",
        "friction_pitch",
        "friction_travel",
        "reverse_thrust",
        "air_density",
        "drag_area_arm",
        "drag_area_body",
        "table_damping",
        "driver_dead_band",
        *ENCODER_DIRECTIONS,
    }
)
_MAY_BE_NEGATIVE: Final = frozenset(
    {
        *("elevation_min", "L_x", "L_phi", "L_theta", "torque_elevation", "torque_pitch", "torque_travel"),
        *("offset_elevation", "offset_pitch", *ENCODER_DIRECTIONS),
    }
)


@dataclass(frozen=True)
class Number:
    """A parameter's value with tolerance and source.

    Parameters
    ----------
    value : float
        The value, in `unit`.
    unit : str
        Unit, as declared for this name in `RIG_QUANTITIES`.
    tolerance : float
        Half width, in `unit`, of the interval that holds the true value with about 95 % confidence.
    source : str
        Where the value comes from: table, equation, measurement or assumption.
    """

    value: float
    unit: str
    tolerance: float
    source: str


@dataclass(frozen=True, repr=False)
class Rig(Mapping[str, Number]):
    """A rig: an immutable mapping from the names of `RIG_QUANTITIES` to numbers.

    Parameters
    ----------
    name : str
        Short name.
    description : str
        One line.
    numbers : Mapping[str, Number]
        One entry for each quantity of `RIG_QUANTITIES`; those of `UNSTATED` may be left out. `encoder_counts`
        holds for each encoder whose counts have no entry.
    effects : Mapping[str, Mapping[str, Number]]
        Effects beyond the model, by their ids (`heli_sim.model.effects`), each with its own numbers.
    model : str
        Name of the model whose numbers these are; empty if any model may use them.

    Raises
    ------
    RigError
        When a number is missing, unknown, not finite, out of range or in another unit.
    """

    name: str
    description: str
    numbers: Mapping[str, Number]
    effects: Mapping[str, Mapping[str, Number]] = field(default_factory=dict)
    model: str = ""

    def __post_init__(self) -> None:
        numbers = counts_by_encoder(self.name, self.numbers)
        for name, unstated in UNSTATED.items():
            unit = next(quantity.unit for quantity in RIG_QUANTITIES if quantity.name == name)
            numbers.setdefault(name, Number(unstated.value, unit, unstated.tolerance, unstated.source))
        _check_numbers(self.name, numbers)
        object.__setattr__(self, "numbers", MappingProxyType(numbers))

    def __reduce__(self) -> tuple[type[Rig], tuple[Any, ...]]:
        # The view of the numbers that nobody can write to does not pickle.
        return Rig, (self.name, self.description, dict(self.numbers), self.effects, self.model)

    def __repr__(self) -> str:
        effects = f", effects {', '.join(self.effects)}" if self.effects else ""
        return f"<Rig '{self.name}': {self.description}; {len(self)} numbers{effects}>"

    def __getitem__(self, name: str) -> Number:
        return self.numbers[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.numbers)

    def __len__(self) -> int:
        return len(self.numbers)

    @staticmethod
    def may_be_negative(name: str) -> bool:
        """Return whether the parameter `name` may be below 0. Masses, distances, gains and similar quantities
        may not.
        """
        return name in _MAY_BE_NEGATIVE

    def replace(self, **values: float) -> Rig:
        """Return a copy with other values; units, tolerances and sources stay.

        Parameters
        ----------
        **values : float
            New values by name, each in the unit of its name.

        Raises
        ------
        RigError
            When a name is unknown or a value is not allowed.
        """
        numbers = dict(self.numbers)
        for name, value in values.items():
            if name not in numbers:
                raise _unknown(self.name, name)
            numbers[name] = replace(numbers[name], value=float(value))
        return replace(self, numbers=numbers)


def counts_by_encoder(rig: str, numbers: Mapping[str, Number]) -> dict[str, Number]:
    """Write the short form `encoder_counts`, and the ratio of older files, as one entry per encoder."""
    numbers = dict(numbers)
    if COMMON_COUNTS.name not in numbers:
        return numbers
    common, ratio = numbers.pop(COMMON_COUNTS.name), numbers.pop(TRAVEL_RATIO.name, None)
    for name in ENCODER_COUNTS:
        numbers.setdefault(name, common)
    if ratio is not None:
        if ratio.unit != TRAVEL_RATIO.unit:
            raise RigError(
                f"rig '{rig}': {TRAVEL_RATIO.name} is in '{ratio.unit}'", f"give it in '{TRAVEL_RATIO.unit}'"
            )
        travel = ENCODER_COUNTS[-1]
        if numbers[travel] is common:
            numbers[travel] = replace(
                common, value=common.value * ratio.value, source=f"{common.source}; {ratio.source}"
            )
    return numbers


def counts_per_turn(rig: Rig) -> Floats:
    """Return the counts of each encoder for one revolution of its axis, positive, shape (3,)."""
    return np.array([rig[name].value for name in ENCODER_COUNTS])


def count_rad(rig: Rig) -> Floats:
    """Return the angle of one count of each encoder [rad], shape (3,)."""
    return 2.0 * np.pi / counts_per_turn(rig)


def directions(rig: Rig) -> Floats:
    """Return 1 for each encoder that counts up with its angle or whose direction is not known, and -1 for
    each that counts down, shape (3,).
    """
    return np.array([rig[name].value or 1.0 for name in ENCODER_DIRECTIONS])


def direction_is_known(rig: Rig) -> tuple[bool, ...]:
    """Return whether the rig file states the direction of each encoder, shape (3,)."""
    return tuple(rig[name].value != 0.0 for name in ENCODER_DIRECTIONS)


def rig_names() -> list[str]:
    """Sorted names of the rigs that come with the package; `load_rig` accepts each."""
    return sorted(path.stem for path in _FOLDER.glob("*.toml"))


def load_rig(name_or_path: str | Path) -> Rig:
    """Read a rig by name or from a file.

    Parameters
    ----------
    name_or_path : str or Path
        A name of `rig_names`, or the path of a TOML file.

    Raises
    ------
    RigError
        When there is no such rig, or its file is not a complete and valid rig.
    """
    path = _FOLDER / f"{name_or_path}.toml"
    if str(name_or_path) not in rig_names():
        path = Path(name_or_path)
    try:
        text = decode_text(read_file(path, TOML_BYTES))
    except (OSError, UnicodeDecodeError) as error:
        if isinstance(error, OSError) and path.suffix == ".toml":
            raise RigError(f"cannot read rig file {path}: {error.strerror}", file_remedy(error)) from None
        known = ", ".join(rig_names())
        raise RigError(f"unknown rig '{name_or_path}'", f"give a TOML file or one of: {known}") from None
    try:
        table = parse_toml(text)
    except ValueError as error:
        raise RigError(f"rig file {path} is not TOML: {error}", "correct that line") from None
    return _rig_from_table(path, table)


def _rig_from_table(path: Path, table: Mapping[str, Any]) -> Rig:
    """Build a rig from the content of its file."""
    texts: dict[str, str] = {}
    for key in _TEXTS:
        value = table.get(key)
        if not isinstance(value, str):
            raise RigError(f'rig file {path} lacks {key} = "..."', "add it at the top")
        texts[key] = value
    keys_of_no_number = {*_TEXTS, "effects", "model"}
    numbers = {
        name: _number_of_table(path, name, entry)
        for name, entry in table.items()
        if name not in keys_of_no_number
    }
    stated_inertias = {q.name: numbers.pop(q.name) for q in STATED_INERTIAS if q.name in numbers}
    model = table.get("model", "")
    if not isinstance(model, str):
        raise RigError(
            f"rig file {path}: model must be a text, not {model!r}", "give a model's name in quotes"
        )
    rig = Rig(
        texts["name"], texts["description"], numbers, _effects_of_table(path, table.get("effects", {})), model
    )
    _check_inertias(rig, stated_inertias)
    return rig


def _effects_of_table(path: Path, table: object) -> dict[str, dict[str, Number]]:
    """Read the effects of a rig file: numbers by effect and name."""
    if not isinstance(table, dict):
        raise RigError(
            f"rig file {path}: effects must hold one table for each effect", "write [effects.NAME.NUMBER]"
        )
    for name, numbers in table.items():
        # If the level NUMBER is missing, the fields of a number stand in its place.
        if not isinstance(numbers, dict) or any(field in numbers for field in _FIELDS):
            raise RigError(
                f"rig file {path}: effect {name} has no tables",
                f'write [effects."{name}".NUMBER] for each number of it',
            )
    return {
        name: {
            short_name: _number_of_table(path, f"effects.{name}.{short_name}", entry)
            for short_name, entry in numbers.items()
        }
        for name, numbers in table.items()
    }


def _number_of_table(path: Path, name: str, entry: object) -> Number:
    """Read a number of a rig file: value, unit, tolerance and source."""
    where = f"rig file {path}: {name}"
    if not isinstance(entry, dict):
        raise RigError(f"{where} is not a table", f"write a table with {', '.join(_FIELDS)}")
    missing = [field for field in _FIELDS if field not in entry]
    unknown = [field for field in entry if field not in _FIELDS]
    if missing or unknown:
        raise RigError(
            f"{where} has missing or unknown keys: {', '.join(missing + unknown)}",
            f"give exactly {', '.join(_FIELDS)}",
        )
    for key in ("value", "tolerance"):
        if isinstance(entry[key], bool) or not isinstance(entry[key], int | float):
            raise RigError(f"{where}: {key} must be a number, not {entry[key]!r}", "write it without quotes")
    for key in ("unit", "source"):
        if not isinstance(entry[key], str) or not entry[key]:
            raise RigError(f"{where}: {key} must be a text, not {entry[key]!r}", "put it in quotes")
    number = Number(float(entry["value"]), entry["unit"], float(entry["tolerance"]), entry["source"])
    # Numbers that are not finite are reported later, by functions that know the allowed range.
    if math.isfinite(number.value) and math.isfinite(number.tolerance):
        check_size(f"rig file {path}", name, number.value, number.tolerance, number.unit)
    return number


def _unknown(rig: str, name: str) -> RigError:
    known = ", ".join(quantity.name for quantity in RIG_QUANTITIES)
    return RigError(f"rig '{rig}' has no parameter '{name}'", f"choose from: {known}")


def _check_inertias(rig: Rig, stated: Mapping[str, Number]) -> None:
    """Refuse a stated inertia that no arrangement of the rig's masses within their tolerances gives."""
    units = {quantity.name: quantity.unit for quantity in STATED_INERTIAS}
    values = {name: number.value for name, number in rig.items()}
    possible = inertia_range_kg_m2(values, {name: number.tolerance for name, number in rig.items()})
    for name, number in stated.items():
        where = f"rig '{rig.name}': {name}"
        if number.unit != units[name]:
            raise RigError(f"{where} is in '{number.unit}'", f"give it in '{units[name]}'")
        if not (math.isfinite(number.value) and math.isfinite(number.tolerance) and number.tolerance >= 0.0):
            raise RigError(
                f"{where} = {number.value} +- {number.tolerance} must be finite", "give finite numbers"
            )
        min_kg_m2, max_kg_m2 = possible[name]
        if not min_kg_m2 - number.tolerance <= number.value <= max_kg_m2 + number.tolerance:
            raise RigError(
                f"{where} = {number.value:g} kg m2 is impossible: with all masses within their tolerances, "
                f"they give {min_kg_m2:.4g} to {max_kg_m2:.4g}",
                "correct this inertia, a mass or a length",
            )


def _check_numbers(rig: str, numbers: Mapping[str, Number]) -> None:
    """Refuse a rig whose numbers are incomplete, in other units, out of range or contradictory."""
    quantities = {quantity.name: quantity for quantity in RIG_QUANTITIES}
    for name in numbers:
        if name not in quantities:
            raise _unknown(rig, name)
    missing = [name for name in quantities if name not in numbers]
    if missing:
        raise RigError(f"rig '{rig}' lacks {', '.join(missing)}", f"add each with {', '.join(_FIELDS)}")
    for name, number in numbers.items():
        number_text = f"rig '{rig}': {name}"
        if number.unit != quantities[name].unit:
            raise RigError(f"{number_text} is in '{number.unit}'", f"give it in '{quantities[name].unit}'")
        if not math.isfinite(number.value):
            raise RigError(f"{number_text} = {number.value} is not finite", "give a finite number")
        if not (math.isfinite(number.tolerance) and number.tolerance >= 0.0):
            raise RigError(
                f"{number_text}: tolerance {number.tolerance} must be finite and not negative",
                "give 0 or more",
            )
        if number.value < 0.0 and name not in _MAY_BE_NEGATIVE:
            raise RigError(f"{number_text} = {number.value} must not be negative", "give 0 or more")
        if number.value == 0.0 and name not in _MAY_BE_ZERO | _MAY_BE_NEGATIVE:
            raise RigError(f"{number_text} must not be 0", "give another number")
        if name in ENCODER_DIRECTIONS and number.value not in (1.0, -1.0, 0.0):
            raise RigError(
                f"{number_text} = {number.value:g} is not a direction", "give 1, -1, or 0 for unknown"
            )
        if name in ENCODER_DIRECTIONS and number.tolerance:
            raise RigError(
                f"{number_text} has the tolerance {number.tolerance:g}", "a direction is exact; give 0"
            )
    if numbers["elevation_min"].value >= numbers["elevation_max"].value:
        raise RigError(f"rig '{rig}': elevation_min must be below elevation_max", "correct one of them")
    if numbers["driver_dead_band"].value >= 0.5:
        raise RigError(
            f"rig '{rig}': driver_dead_band is not below 0.5, so that no duty has an effect",
            "give 0 or more, and less than 0.5",
        )


_DIGITS = 7


def rig_text(rig: Rig, comment: str = "", digits: int = _DIGITS) -> str:
    """Return a rig as TOML after a `comment` of one or more lines, with `digits` significant digits; 17 keep
    each number exactly.
    """
    lines = [f"# {line}" for part in comment.splitlines() for line in _wrapped(part)]
    lines += [f"name = {toml_string(rig.name)}", f"description = {toml_string(rig.description)}"]
    if rig.model:
        lines.append(f"model = {toml_string(rig.model)}")
    for name, number in rig.items():
        lines += _lines_of_number(name, number, digits)
    for effect, numbers in rig.effects.items():
        for short_name, number in numbers.items():
            lines += _lines_of_number(f"effects.{toml_string(effect)}.{short_name}", number, digits)
    return "\n".join(lines) + "\n"


def _wrapped(line: str) -> list[str]:
    """Return a line of a comment in lines of at most 108 characters; its indentation stays."""
    text = line.lstrip(" ")
    indent = " " * (len(line) - len(text))
    return textwrap.wrap(text, 108, initial_indent=indent, subsequent_indent=indent)


def _lines_of_number(name: str, number: Number, digits: int) -> list[str]:
    """Return the lines of a number in a rig file."""
    return [
        "",
        f"[{name}]",
        f"value = {number.value:.{digits}g}",
        f"unit = {toml_string(number.unit)}",
        f"tolerance = {number.tolerance:.{digits}g}",
        f"source = {toml_string(number.source)}",
    ]


def write_rig(rig: Rig, path: str | Path, comment: str = "") -> None:
    """Write a rig into the file at `path`, under a `comment`."""
    write_signed(path, rig_text(rig, comment))
