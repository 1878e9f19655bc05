"""The message about a missing package has the command that installs it and all other missing ones."""

from __future__ import annotations

import pytest
from heli_host.ui.cli.entry import _line_and_exit_code


@pytest.mark.parametrize(
    ("package", "remedy"),
    [
        ("uvicorn", "pip install -e '.[page]'"),
        ("rosbags.highlevel", "pip install -e '.[import]'"),
        ("gymnasium", "pip install -e '.[gym]'"),
        ("numpy", "pip install -e ."),
        ("my_laws", "or install the package that contains it"),
    ],
)
def test_the_remedy_installs_the_extra(package: str, remedy: str) -> None:
    line, code = _line_and_exit_code(ModuleNotFoundError("gone", name=package))
    assert line.endswith(remedy)
    assert code == 2
