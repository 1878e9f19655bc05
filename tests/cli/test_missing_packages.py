"""The message about a missing package has the command that installs it and all other missing ones."""

from __future__ import annotations

import pytest
from heli_host.cli.entry import _line_and_exit_code


@pytest.mark.parametrize(
    ("package", "remedy"),
    [
        ("uvicorn", "pip install 'heli-host[page]'"),
        ("rosbags.highlevel", "pip install 'heli-host[import]'"),
        ("gymnasium", "pip install 'heli-host[gym]'"),
        ("numpy", "pip install numpy"),
        ("my_laws", "pip install my_laws"),
    ],
)
def test_the_remedy_installs_the_extra(package: str, remedy: str) -> None:
    line, code = _line_and_exit_code(ModuleNotFoundError("gone", name=package))
    assert line.endswith(remedy)
    assert code == 2
