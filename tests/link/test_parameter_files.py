"""Files of parameters that another schema wrote: known values are kept, all else is named."""

from __future__ import annotations

from pathlib import Path

import pytest
from heli_host.declaration import PARAMS, PARAMS_HASH
from heli_host.errors import ParameterError
from heli_host.parameter_file import parameters_text, read_parameter_set

DEFAULTS = {spec.name: spec.default for spec in PARAMS}


def written(folder: Path, *changes: tuple[str, str]) -> Path:
    """A dump in which texts were replaced."""
    text = parameters_text({**DEFAULTS, "hover_V": 1.75}, "a board")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    file = folder / "parameters.toml"
    file.write_text(text, encoding="utf-8")
    return file


OTHER = (f"{PARAMS_HASH:08x}", f"{PARAMS_HASH ^ 1:08x}")


def test_a_file_of_the_same_schema_is_taken_whole(tmp_path: Path) -> None:
    given = read_parameter_set(written(tmp_path))
    assert given.values == {**DEFAULTS, "hover_V": 1.75}
    assert (given.dropped, given.new) == ((), ())


def test_a_file_of_another_schema_keeps_what_is_known(tmp_path: Path) -> None:
    changes = (OTHER, ("hover_slope =", "hover_curve ="))
    given = read_parameter_set(written(tmp_path, *changes))
    assert given.values["hover_V"] == 1.75
    assert len(given.values) == len(PARAMS) - 1
    assert given.dropped == ("there is no parameter hover_curve",)
    assert given.new == ("hover_slope",)


def test_a_value_out_of_the_new_range_is_dropped_and_named(tmp_path: Path) -> None:
    given = read_parameter_set(written(tmp_path, OTHER, ("hover_V = 1.75", "hover_V = 1e6")))
    assert "hover_V" not in given.values
    assert given.dropped == ("hover_V = 1e+06 is out of range",)


def test_a_value_in_another_unit_is_dropped_and_named(tmp_path: Path) -> None:
    given = read_parameter_set(written(tmp_path, OTHER, ('hover_V = "V"', 'hover_V = "mV"')))
    assert "hover_V" not in given.values
    assert given.dropped == ("hover_V was in mV and is in V now",)


def test_under_its_own_schema_a_wrong_value_refuses_the_file(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match="hover_V"):
        read_parameter_set(written(tmp_path, ("hover_V = 1.75", "hover_V = 1e6")))
