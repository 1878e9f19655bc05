"""Files of parameters that another schema wrote: known values are kept, all else is named."""

from __future__ import annotations

from pathlib import Path

import pytest
from heli_host.board.parameters import parameters_text, read_parameter_set
from heli_host.declaration import PARAMS, PARAMS_HASH
from heli_host.errors import ParameterError
from heli_host.ui.cli import run
from heli_host.ui.cli.options import chosen_parameters
from heli_lab.apps.campaign import works
from heli_lab.apps.campaign.cases import Campaign

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
    parameter_set = read_parameter_set(written(tmp_path))
    assert parameter_set.values == {**DEFAULTS, "hover_V": 1.75}
    assert (parameter_set.dropped, parameter_set.new) == ((), ())


def test_a_file_of_another_schema_keeps_what_is_known(tmp_path: Path) -> None:
    changes = (OTHER, ("hover_slope =", "hover_curve ="))
    parameter_set = read_parameter_set(written(tmp_path, *changes))
    assert parameter_set.values["hover_V"] == 1.75
    assert len(parameter_set.values) == len(PARAMS) - 1
    assert parameter_set.dropped == ("unknown parameter hover_curve",)
    assert parameter_set.new == ("hover_slope",)


def test_a_value_out_of_the_new_range_is_dropped_and_named(tmp_path: Path) -> None:
    parameter_set = read_parameter_set(written(tmp_path, OTHER, ("hover_V = 1.75", "hover_V = 1e6")))
    assert "hover_V" not in parameter_set.values
    assert parameter_set.dropped == ("hover_V = 1e+06 is out of range",)


def test_a_value_in_another_unit_is_dropped_and_named(tmp_path: Path) -> None:
    parameter_set = read_parameter_set(written(tmp_path, OTHER, ('hover_V = "V"', 'hover_V = "mV"')))
    assert "hover_V" not in parameter_set.values
    assert parameter_set.dropped == ("hover_V was in mV and is in V now",)


def test_fly_takes_known_values_of_another_schema_and_lists_the_others(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = written(tmp_path, OTHER, ("hover_slope =", "hover_curve ="))
    values = chosen_parameters(file, None)
    assert values["hover_V"] == 1.75
    assert "hover_curve" not in values
    assert capsys.readouterr().out == "dropped: unknown parameter hover_curve\n"


@pytest.mark.medium
def test_a_campaign_takes_known_values_of_another_schema_and_lists_the_others(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    file = written(tmp_path, OTHER, ("hover_slope =", "hover_curve ="))
    campaign = tmp_path / "study.toml"
    campaign.write_text(f'work = "gains"\n[cases]\nparams = ["{file.name}", ""]\n')
    tried_parameters = []

    def tried(plant: object, parameters: dict[str, float], *rest: object) -> None:
        tried_parameters.append(parameters)
        raise KeyboardInterrupt

    monkeypatch.setattr("heli_lab.control.tune.trial.try_gains", tried)
    monkeypatch.setattr("heli_lab.apps.campaign.run.run_campaign", first_case)
    assert run(["campaign", str(campaign), "-o", str(tmp_path / "out")]) == 2
    assert f"{file}: dropped: unknown parameter hover_curve\n" in capsys.readouterr().out
    assert tried_parameters[0]["hover_V"] == 1.75
    assert "hover_curve" not in tried_parameters[0]


def first_case(campaign: Campaign, *_: object, **__: object) -> None:
    """Do the first case in this process."""
    works.gains(campaign.cases[0].settings)


def test_under_its_own_schema_a_wrong_value_refuses_the_file(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match="hover_V"):
        read_parameter_set(written(tmp_path, ("hover_V = 1.75", "hover_V = 1e6")))
