"""Effects as people write them: on a command line, in a rig's file, in a file of their own."""

import contextlib
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest
from heli_benchmark.tests import test_cases
from heli_lab.control.tune.loops import loop_effects_of
from heli_lab.explain.experiment_design import segment_for
from heli_lab.watch import twin_model
from heli_sim.errors import EffectError, RigError
from heli_sim.model import MultibodyModel, effects
from heli_sim.model.effects import catalogue, effect_numbers, parse_effects
from heli_sim.model.effects.catalogue import _built_in_effects
from heli_sim.model.effects.spec import format_estimate
from heli_sim.model.effects.table import with_table
from heli_sim.model.plant import Plant
from heli_sim.rig import Number, Rig, load_rig, write_rig
from heli_sim.sil.options import SilOptions, parse_url, plant_of

from tests.model.flown import COMMON, MEASURED

DOCS = Path(__file__).resolve().parents[2] / "docs"
DOCUMENT = DOCS / "reference" / "effects.md"


def example() -> str:
    """The file that the document shows, under an id that a reader who has added it does not have."""
    block = re.search(
        r"^```python\n(.*?)^```$", (DOCS / "how-to/extending.md").read_text(), re.MULTILINE | re.DOTALL
    )
    assert block is not None
    return block[1].replace('id="draught"', 'id="window_draught"')


def written(folder: Path, text: str) -> Path:
    path = folder / "mine.py"
    path.write_text(text)
    return path


def test_every_effect_of_the_list_is_there() -> None:
    assert set(COMMON + MEASURED) <= set(catalogue())
    assert any(id.startswith("removed.") for id in catalogue())


def test_no_two_effects_share_a_number_and_each_has_a_size_and_a_range() -> None:
    kinds = catalogue().values()
    names = [name for kind in kinds for name in kind.neutral]
    assert len(names) == len(set(names))
    for kind in kinds:
        assert kind.size and set(kind.size) <= set(kind.priors)
        for name, prior in kind.priors.items():
            assert prior.low <= kind.neutral[name] <= prior.high, name
            assert prior.low <= kind.typical[name] <= prior.high, name


@pytest.mark.medium
@pytest.mark.parametrize("id", catalogue())
def test_an_equation_can_be_drawn_and_a_sentence_said(id: str) -> None:
    from matplotlib.mathtext import MathTextParser

    kind = catalogue()[id]
    MathTextParser("path").parse(f"${kind.equation}$")
    sentence = kind.describe(kind.typical, {name: 0.01 * abs(value) for name, value in kind.typical.items()})
    assert " ± " in sentence and "{" not in sentence and not sentence.endswith(".")


def test_numbers_are_said_with_as_many_digits_as_their_error_knows() -> None:
    assert format_estimate(0.12345, 0.0123, "s") == "0.123 ± 0.012 s"
    assert format_estimate(0.12345, 0.042, "s") == "0.12 ± 0.04 s"
    assert format_estimate(0.0398, 0.0002, "1") == "3.980 ± 0.020 %"
    assert format_estimate(np.radians(1.5), np.radians(0.2), "rad") == "1.50 ± 0.20 deg"
    assert format_estimate(1234.5, 21.0, "N") == "1234 ± 21 N"
    assert format_estimate(0.1, std=None, unit="s") == "0.1 s"


def test_the_documents_table_is_todays() -> None:
    text = (DOCS / "reference/effects.md").read_text()
    assert text == with_table(text), "run python -m heli_sim.model.effects.table"


@pytest.mark.medium
def test_the_documents_own_effect_flies(tmp_path: Path) -> None:
    path = written(tmp_path, example())
    options = SilOptions(effects=("window_draught=0.05",), effect_files=(str(path),), model="multibody")
    plant = plant_of(options)
    state = plant.rest_state()
    state[0] = 0.0
    state[2] = np.pi / 2
    after, _ = plant.step(state, (0.0, 0.0))
    assert after[5] == pytest.approx(0.05 / 0.82 * 1e-3, rel=0.02)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("import casadi as ca", "import casadi as", "line 3: invalid syntax"),
        ("import casadi as ca", "import nosuchthing", "ModuleNotFoundError No module named 'nosuchthing'"),
        ('id="window_draught"', 'id="rotor_lag"', "'rotor_lag' exists already; give it another id"),
        ("DRAUGHT = EffectSpec", "DRAUGHT = dict", "has no EffectSpec at its top level"),
        ("effect=Draught", "effect=int", "effect must be a class derived from Effect"),
        (", size=True", "", "has no number with size=True"),
        ('at.state["travel_rad"]', 'at.state["tavel_rad"]', "line 15: KeyError 'tavel_rad'"),
        (
            "ca.sin(angle)",
            "ca.sqrt(angle - 9)",
            "the rate of a state or its derivative is not a finite number",
        ),
        ("return ca.vertcat(0, 0,", "return ca.vertcat(0,", "'window_draught': "),
        ("{from_rad}", "{from}", "KeyError 'from'"),
    ],
)
def test_what_is_wrong_with_a_file_is_said_in_one_line(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    text = example()
    assert old in text
    path = written(tmp_path, text.replace(old, new))
    with pytest.raises(EffectError) as raised:
        catalogue([path])
    assert message in str(raised.value)
    assert str(raised.value).startswith(f"effect file {path}")
    assert "\n" not in str(raised.value)


@pytest.mark.medium
def test_the_documents_own_effect_passes_the_rules_for_docstrings(tmp_path: Path) -> None:
    path = written(tmp_path, example())
    rules = ["--select", "D,F,I", "--isolated", "--config", 'lint.pydocstyle.convention = "numpy"']
    ruff = [sys.executable, "-m", "ruff", "check", "--no-cache", *rules]
    checked = subprocess.run([*ruff, path], capture_output=True, text=True, check=False)
    assert checked.returncode == 0, checked.stdout
    path.write_text(example().replace("    @override\n", ""))
    assert "D102" in subprocess.run([*ruff, path], capture_output=True, text=True, check=False).stdout


@contextlib.contextmanager
def in_the_folder(folder: Path, text: str) -> Iterator[None]:
    """A file of this text counts as one of the package's effects in this block."""
    (folder / "window_draught.py").write_text(text)
    before = list(effects.__path__)
    try:
        effects.__path__ = [*before, str(folder)]
        _built_in_effects.cache_clear()
        yield
    finally:
        effects.__path__ = before
        _built_in_effects.cache_clear()
        sys.modules.pop("heli_sim.model.effects.window_draught", None)


def test_an_effect_file_in_the_folder_is_found_by_itself(tmp_path: Path) -> None:
    with in_the_folder(tmp_path, example()):
        ids = list(catalogue())
    assert ids.index("gyroscopic_torque") < ids.index("window_draught") < ids.index("removed.dead_zone")
    assert "window_draught" not in catalogue()


CHANGE = """    stage=Stage.TORQUE,
    linearisable=True,
    change=ChangeSpec((0.05,), "a draught of {} came", "a draught of {} came from behind"),
"""


@pytest.mark.medium
def test_a_new_effect_is_one_file_and_the_generated_table(tmp_path: Path) -> None:
    """Catalogue, table, twin, experiment and the design of gains take it all from the file."""
    plain = example()
    stated = plain.replace("    stage=Stage.TORQUE,\n", CHANGE).replace(
        "import EffectSpec,", "import ChangeSpec, EffectSpec,"
    )
    with in_the_folder(tmp_path, stated):
        assert "| `window_draught` |" in with_table(DOCUMENT.read_text())
        test_every_effect_of_the_list_is_there()
        test_cases.test_every_effect_of_the_list_is_hidden_in_two_sizes_or_in_disturbances_or_gone()
        (change,) = (
            change for change in twin_model.changes_of(MultibodyModel()) if change.id == "window_draught"
        )
        assert change.parameters == ("window_draught_Nm",) and not change.non_negative
        assert change.words(0.03, 0.01) == "a draught of 30 ± 10 mN m came"
        assert "window_draught" in {effect.name for effect in twin_model.extended(MultibodyModel()).effects}
        assert segment_for(catalogue()["window_draught"]) == "travel"
        assert not loop_effects_of(parse_effects(["window_draught=0.03"])).excluded
    with in_the_folder(tmp_path, plain):
        assert loop_effects_of(parse_effects(["window_draught=0.03"])).excluded == ("window_draught",)
    fades = plain.replace("    stage=Stage.TORQUE,\n", "    stage=Stage.TORQUE,\n    time_varying=True,\n")
    with in_the_folder(tmp_path, fades):
        assert segment_for(catalogue()["window_draught"]) == "time"


def test_a_change_during_the_flight_is_in_no_linear_plant_and_is_reported() -> None:
    slip = parse_effects(["counterweight_shift=0.005@20", "thrust_quadratic"])
    assert loop_effects_of(slip).excluded == ("counterweight_shift",)
    for kind in catalogue().values():
        assert not (kind.linearisable and kind.time_varying), kind.id


def test_a_file_that_is_not_there_is_named() -> None:
    with pytest.raises(EffectError, match=r"effect file nowhere\.py cannot be read; give a Python file"):
        catalogue(["nowhere.py"])


def test_effects_are_read_from_the_command_line() -> None:
    lag, step, tilt, torque, friction = parse_effects(
        [
            *("rotor_lag=0.1", "thrust_step.front=0.2@25", "axis_tilt=x_rad:0.02,axis_tilt_y_rad:0.01"),
            *("rotor_reaction_torque=0.06", "coulomb_friction.travel"),
        ]
    )
    assert lag.values == {"rotor_lag_s": 0.1}
    assert step.values == {"thrust_step_front_share": 0.2, "thrust_step_front_at_s": 25.0}
    assert tilt.values == {"axis_tilt_x_rad": 0.02, "axis_tilt_y_rad": 0.01}
    assert list(torque.values.values()) == [0.06, -0.06]
    assert friction.values == catalogue()["coulomb_friction.travel"].typical


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("rotor_lg=0.1", "unknown effect 'rotor_lg'; did you mean rotor_lag?"),
        ("backlash=0.1", "did you mean backlash.elevation or backlash.pitch or backlash.travel?"),
        (
            "rotor_lag=fast",
            "rotor_lag_s = 'fast' is not a number; write it with a decimal point and without a unit",
        ),
        ("rotor_lag=-1", "rotor_lag_s = -1 s is out of range; give 0 to 0.6"),
        ("rotor_lag=nan", "out of range"),
        ("rotor_lag=0.1@3", "'rotor_lag' has no 'at_s'; choose from s"),
        ("axis_tilt=z:1", "'axis_tilt' has no 'z'; choose from x_rad, y_rad"),
        ("", "unknown effect ''"),
    ],
)
def test_a_badly_spelled_effect_is_refused_in_one_line(text: str, message: str) -> None:
    with pytest.raises(EffectError) as raised:
        parse_effects([text])
    assert message in str(raised.value)
    assert "\n" not in str(raised.value)


def test_an_effect_twice_is_refused() -> None:
    with pytest.raises(EffectError, match="'rotor_lag' is given twice; give it once"):
        parse_effects(["rotor_lag=0.1", "rotor_lag=0.2"])


def extended(tmp_path: Path) -> Path:
    rig, kind = load_rig("makki2024"), catalogue()["rotor_lag"]
    numbers = effect_numbers(kind, {"rotor_lag_s": 0.118}, {"rotor_lag_s": 0.004}, "flight a")
    path = tmp_path / "extended.toml"
    write_rig(Rig("extended", "with lag", rig.numbers, {"rotor_lag": numbers}, "multibody"), path)
    return path


@pytest.mark.medium
def test_a_rigs_file_holds_effects_and_flies_them(tmp_path: Path) -> None:
    path = extended(tmp_path)
    rig = load_rig(path)
    assert rig.effects == {"rotor_lag": {"s": Number(0.118, "s", 0.004, "flight a")}}
    assert rig.replace(M_w=1.6).effects == rig.effects
    plant = plant_of(SilOptions(rig=str(path)))
    assert isinstance(plant.model, MultibodyModel)
    assert [effect.values for effect in plant.model.effects] == [{"rotor_lag_s": 0.118}]
    timed_diagnosis = plant_of(
        parse_url(f"sil://?rig={path}&effect=rotor_lag%3D0.05;cable_spring.travel%3D0.1")
    )
    assert {e.name: next(iter(e.values.values())) for e in timed_diagnosis.model.effects} == {
        "rotor_lag": 0.05,
        "cable_spring.travel": 0.1,
    }


@pytest.mark.parametrize(
    ("old", "new", "error", "message"),
    [
        ("rotor_lag", "rotor_lagg", EffectError, "did you mean rotor_lag?"),
        ('"rotor_lag".s', '"rotor_lag".ms', EffectError, "effect 'rotor_lag' has no 'ms'; choose from s"),
        ('value = 0.118\nunit = "s"', 'value = 118\nunit = "ms"', EffectError, "is in 'ms'; give it in 's'"),
        ("value = 0.118", "value = -0.1", EffectError, "rotor_lag_s = -0.1 s is out of range"),
        ('"rotor_lag".s', '"rotor_lag"', RigError, 'write [effects."rotor_lag".NUMBER] for each number'),
        ('model = "multibody"', "model = 3", RigError, "model must be a text, not 3"),
    ],
)
def test_a_rigs_file_with_a_wrong_effect_is_refused(
    tmp_path: Path, old: str, new: str, error: type[Exception], message: str
) -> None:
    path = extended(tmp_path)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(error, match=re.escape(message)) as raised:
        plant_of(SilOptions(rig=str(path)))
    assert "\n" not in str(raised.value)


@pytest.mark.medium
def test_voltages_act_late_by_a_part_of_a_millisecond_too() -> None:
    rig = load_rig("makki2024")
    delayed = Plant(MultibodyModel(parse_effects(["input_delay=0.0025"])), rig)
    undelayed = Plant(MultibodyModel(), rig)
    delayed_state, state = delayed.rest_state(), undelayed.rest_state()
    delayed_state[0] = state[0] = 0.0
    volts_V = np.vstack((np.zeros((5, 2)), np.full((20, 2), 3.0)))
    for tick, commanded in enumerate(volts_V):
        # A delay of 2.5 ms: half of each millisecond has the command of 2 ms ago, half that of 3 ms ago.
        acting_V = 0.5 * (volts_V[max(tick - 2, 0)] + volts_V[max(tick - 3, 0)])
        delayed_state, _ = delayed.step(delayed_state, commanded)
        state, _ = undelayed.step(state, acting_V)
    np.testing.assert_array_equal(delayed_state[:6], state)
    elevation_rate_rad_s = state[3]
    assert elevation_rate_rad_s > 1e-3


@pytest.mark.medium
def test_time_begins_when_the_motors_first_turn() -> None:
    plant = Plant(MultibodyModel(parse_effects(["thrust_step.front=1@0.05"])), load_rig("makki2024"))
    state, off_V, on_V = plant.rest_state(), (0.0, 0.0), (2.0, 2.0)
    time_state = len(plant.model.states)  # the first state after those of the model
    for volts_V, ticks, time_s in ((off_V, 100, 0.0), (on_V, 40, 0.04), (off_V, 60, 0.1)):
        for _ in range(ticks):
            state, _ = plant.step(state, volts_V)
        assert state[time_state] == pytest.approx(time_s)


def gusts(seed: int, seconds: int = 60) -> npt.NDArray[np.float64]:
    plant = Plant(
        MultibodyModel(parse_effects(["random_torque.travel=Nm:0.02,s:0.1"])), load_rig("makki2024"), seed
    )
    step = plant.function.mapaccum(1000 * seconds)
    after, _ = step(plant.rest_state(), np.zeros(2), np.ones(3), plant.parameters)
    torque_Nm: npt.NDArray[np.float64] = np.asarray(after)[6]
    return torque_Nm


@pytest.mark.slow
def test_gusts_have_their_size_and_their_memory_and_come_from_the_seed() -> None:
    torque = gusts(1)
    assert torque.std() == pytest.approx(0.02, rel=0.1)
    assert np.corrcoef(torque[:-100], torque[100:])[0, 1] == pytest.approx(np.exp(-1), abs=0.1)
    assert abs(np.mean((torque / torque.std()) ** 4) - 3) < 0.5
    np.testing.assert_array_equal(torque[:1000], gusts(1, 1)[:1000])
    assert np.abs(np.corrcoef(torque[:5000], gusts(2, 5))[0, 1]) < 0.3
