"""Parameters of the board as a TOML file."""

from __future__ import annotations

import errno
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from heli_host.board.parameters import checked, spec_of
from heli_host.declaration import PARAMS, PARAMS_HASH
from heli_host.errors import ParameterError, file_remedy
from heli_host.files import TOML_BYTES, decode_text, parse_toml, read_file

TABLE = "parameters"
"""Table of the file that holds the values."""
UNITS = "units"
"""Table of the file that holds their units."""
SCHEMA = "schema"
"""Entry of the file with the digest of the parameter schema under which it was written."""
_REMEDY = "give a file that params dump wrote"


def parameters_text(values: Mapping[str, float], comment: str) -> str:
    """Write parameters as TOML that `read_parameter_set` reads."""
    units = {name: spec_of(name).unit for name in values}
    lines = [f"# {comment}", f'{SCHEMA} = "{PARAMS_HASH:08x}"', "", f"[{TABLE}]"]
    for name, value in values.items():
        lines.append(f"{name} = {value!r}" + (f"  # {units[name]}" if units[name] else ""))
    lines += ["", f"[{UNITS}]", *(f'{name} = "{unit}"' for name, unit in units.items())]
    return "\n".join(lines) + "\n"


@dataclass(frozen=True)
class ParameterSet:
    """Parameters of a file, as far as this host's declaration takes them."""

    values: dict[str, float]  # Values by name, in declared units
    dropped: tuple[str, ...]  # One reason per value that is not used
    new: tuple[str, ...]  # Declared parameters that the file does not name


def read_parameter_set(file: Path) -> ParameterSet:
    """Read parameters that may have been written under another schema of the parameters."""
    try:
        content = parse_toml(decode_text(read_file(file, TOML_BYTES)))
    except OSError as error:
        if error.errno == errno.EFBIG:
            raise ParameterError(
                f"{file} is too large for a file of parameters", "give a TOML file of params dump or tune"
            ) from error
        raise ParameterError(f"cannot read {file}: {error.strerror or error}", file_remedy(error)) from error
    except ValueError as error:
        raise ParameterError(f"{file} is not TOML: {error}", _REMEDY) from error
    return parameter_set(content, file)


def parameter_set(content: Mapping[str, object], file: Path) -> ParameterSet:
    """Check the tables of a parameter file.

    If the file has this host's schema or no schema, each value must be valid. From a file of another schema,
    known parameters with the declared unit and a valid value are used, and the others are dropped.
    """
    values = _numbers_by_name(content, file)
    units = content.get(UNITS)
    other_schema = content.get(SCHEMA, f"{PARAMS_HASH:08x}") != f"{PARAMS_HASH:08x}"
    accepted: dict[str, float] = {}
    dropped: list[str] = []
    for name, value in values.items():
        try:
            unit = checked(name, value).unit
        except ParameterError as error:
            if not other_schema:
                raise
            dropped.append(error.cause)
            continue
        stated = units.get(name, unit) if isinstance(units, dict) else unit
        if other_schema and stated != unit:
            dropped.append(f"{name} was in {stated or 'no unit'} and is in {unit or 'no unit'} now")
        else:
            accepted[name] = value
    return ParameterSet(
        accepted, tuple(dropped), tuple(spec.name for spec in PARAMS if spec.name not in values)
    )


def _numbers_by_name(content: Mapping[str, object], file: Path) -> dict[str, float]:
    """Return the numbers of a parameter file by name."""
    table = content.get(TABLE)
    if not isinstance(table, dict) or not table:
        raise ParameterError(f"{file} has no table [{TABLE}]", _REMEDY)
    values: dict[str, float] = {}
    for name, value in table.items():
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ParameterError(f"{file}: {name} is not a number", "correct that line")
        values[name] = float(value)
    return values
