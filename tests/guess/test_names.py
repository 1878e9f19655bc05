"""Names of columns, in the languages of courses."""

from __future__ import annotations

import pytest
from heli_lab.setup.guess import names


@pytest.mark.parametrize(
    ("name", "role"),
    [
        ("Høyde (grader)", "elevation"),
        ("Höhenwinkel [°]", "elevation"),
        ("Élévation", "elevation"),
        ("高度角(°)", "elevation"),
        ("cabeceo", "pitch"),
        ("俯仰角", "pitch"),
        ("Vandring", "travel"),
        ("旋转角", "travel"),
        ("Moteur arrière [V]", "back"),
        ("前电机", "front"),
        ("v_delantero", "front"),
        ("V_s", "sum"),
        ("u2", ""),
        ("pitch_ref", ""),
    ],
)
def test_a_name_states_a_role(name: str, role: str) -> None:
    assert names.role_of(name) == role


@pytest.mark.parametrize("name", ["Tid [s]", "Zeit", "Temps (s)", "tiempo", "时间(s)"])
def test_a_name_states_the_time(name: str) -> None:
    assert names.is_time(name)
