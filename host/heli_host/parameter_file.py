"""Parameters of the board as a TOML file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from heli_host.errors import ParameterError
from heli_host.files import TOML_BYTES, parse_toml, read_file
from heli_host.parameters import spec_of

TABLE = "parameters"
"""Table of the file that holds the values."""


def parameters_text(values: Mapping[str, float], comment: str) -> str:
    """Write parameters as TOML that `read_parameters` reads.

    Parameters
    ----------
    values : Mapping of str to float
        Values by name, in declared units.
    comment : str
        One line that says where they come from.

    Raises
    ------
    ParameterError
        A name is not declared.
    """
    lines = [f"# {comment}", "", f"[{TABLE}]"]
    for name, value in values.items():
        unit = spec_of(name).unit
        lines.append(f"{name} = {value!r}" + (f"  # {unit}" if unit else ""))
    return "\n".join(lines) + "\n"


def read_parameters(file: Path) -> dict[str, float]:
    """Read parameters from TOML, by name; values are not checked against the declaration.

    Parameters
    ----------
    file : Path
        A file as `parameters_text` writes it.

    Raises
    ------
    ParameterError
        The file cannot be read, or holds anything but numbers.
    """
    remedy = "give a file that params dump wrote"
    try:
        content = parse_toml(read_file(file, TOML_BYTES).decode("utf-8"))
    except OSError as error:
        raise ParameterError(f"cannot read {file}: {error.strerror or error}", "check the path") from error
    except ValueError as error:
        raise ParameterError(f"{file} is not TOML: {error}", remedy) from error
    table = content.get(TABLE)
    if not isinstance(table, dict) or not table:
        raise ParameterError(f"{file} has no table [{TABLE}]", remedy)
    values: dict[str, float] = {}
    for name, value in table.items():
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise ParameterError(f"{file}: {name} is not a number", "correct that line")
        values[name] = float(value)
    return values
