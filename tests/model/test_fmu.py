"""FMUs: FMPy, an importer that knows nothing of ours, validates, drives and compiles them."""

import os
import shutil
import subprocess
import zipfile
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from fmpy import read_model_description
from fmpy.validation import validate_fmu
from heli_host.data.arrays import Floats
from heli_sim.evaluate.compiled import compile_function
from heli_sim.fmu import write_fmu
from heli_sim.model.linear import trim
from heli_sim.model.multibody import MultibodyModel
from heli_sim.model.plant import Plant
from heli_sim.sil.options import SilOptions, plant_of

VOLTAGES, OUTPUTS = [1, 2], [3, 4, 5]
"""Value references of both voltages, and of the three angles."""
STEP_S = 1e-3


def voltages(seconds: float, hover_V: Floats) -> Floats:
    """Front and back voltage of each millisecond, shape (n, 2): a second of rest, then hover and sines."""
    t_s = np.arange(round(seconds / STEP_S)) * STEP_S
    both = 0.12 * np.sin(2.0 * np.pi * 0.13 * t_s) + 0.05 * np.sin(2.0 * np.pi * 0.7 * t_s)
    apart = 0.06 * np.sin(2.0 * np.pi * 0.31 * t_s)
    volts = hover_V + np.column_stack((both + apart, both - apart))
    return np.where(t_s[:, None] < 1.0, 0.0, volts)


def plants_flight(plant: Plant, volts_V: Floats) -> Floats:
    """Measured angles at the end of each millisecond, shape (n, 3), by the simulation's own compiled step."""
    library = compile_function(plant.function)
    assert library is not None
    step = ca.external(plant.function.name(), str(library))
    run = step.mapaccum("flight", len(volts_V))
    count = len(volts_V)
    _, measured = run(
        plant.rest_state(), volts_V.T, np.zeros((3, count)), np.tile(plant.parameters[:, None], count)
    )
    return np.asarray(measured).T


def instance_in_initialization(path: Path, folder: Path, *, co_simulation: bool) -> Any:
    """An instance of the FMU, in initialization mode."""
    import fmpy
    from fmpy.fmi3 import FMU3Model, FMU3Slave

    description = fmpy.read_model_description(str(path))
    unpacked = fmpy.extract(str(path), str(folder))
    interface = description.coSimulation if co_simulation else description.modelExchange
    made = (FMU3Slave if co_simulation else FMU3Model)(
        guid=description.guid,
        unzipDirectory=unpacked,
        modelIdentifier=interface.modelIdentifier,
        instanceName="rig",
    )
    made.instantiate()
    made.enterInitializationMode(startTime=0.0)
    return made


def co_simulated(path: Path, folder: Path, volts_V: Floats, ticks: int = 1) -> Floats:
    """Measured angles after each communication step of so many milliseconds."""
    slave = instance_in_initialization(path, folder, co_simulation=True)
    slave.exitInitializationMode()
    matches = []
    for row in range(0, len(volts_V), ticks):
        slave.setFloat64(VOLTAGES, volts_V[row].tolist())
        slave.doStep(row * STEP_S, ticks * STEP_S)
        matches.append(slave.getFloat64(OUTPUTS))
    slave.terminate()
    slave.freeInstance()
    return np.array(matches)


def by_model_exchange(path: Path, folder: Path, volts_V: Floats, states: int) -> tuple[Floats, int]:
    """Measured angles at the end of each millisecond, integrated by Runge and Kutta's fourth order here, and
    how many events there were.
    """
    from ctypes import c_double

    model = instance_in_initialization(path, folder, co_simulation=False)
    model.setFloat64(VOLTAGES, volts_V[0].tolist())
    model.exitInitializationMode()
    buffer, rates = (c_double * states)(), (c_double * states)()
    indicators = (c_double * 6)()

    def rate(x: Floats, at_s: float) -> Floats:
        model.setTime(at_s)
        buffer[:] = x.tolist()
        model.setContinuousStates(buffer, states)
        model.getContinuousStateDerivatives(rates, states)
        return np.array(rates[:])

    def event() -> float:
        """Handle an event, and return the time of the next one."""
        _, _, _, _, due, next_s = model.updateDiscreteStates()
        model.enterContinuousTimeMode()
        model.getContinuousStates(buffer, states)
        return float(next_s) if due else np.inf

    next_event_s, events = event(), 1
    measured = []
    for row in range(len(volts_V)):
        at_s, h = row * STEP_S, STEP_S
        x = np.array(buffer[:])
        k1 = rate(x, at_s)
        k2 = rate(x + h / 2 * k1, at_s + h / 2)
        k3 = rate(x + h / 2 * k2, at_s + h / 2)
        k4 = rate(x + h * k3, at_s + h)
        x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        model.setTime(at_s + h)
        buffer[:] = x.tolist()
        model.setContinuousStates(buffer, states)
        # The voltages that act from here on are there before the event, as an importer has it.
        model.setFloat64(VOLTAGES, volts_V[min(row + 1, len(volts_V) - 1)].tolist())
        model.getEventIndicators(indicators, 6)
        if next_event_s <= at_s + h + 1e-9 or min(indicators[:]) <= 0.0:
            model.enterEventMode()
            next_event_s, events = event(), events + 1
        measured.append(model.getFloat64(OUTPUTS))
    model.terminate()
    model.freeInstance()
    return np.array(measured), events


pytest.importorskip("fmpy", reason="skipped: no fmpy")


pytestmark = [
    pytest.mark.medium,
    pytest.mark.skipif(shutil.which("cc") is None, reason="skipped: no C compiler"),
]

LONG = os.environ.get("HELI_LONG") == "1"
SECONDS = 60.0 if LONG else 4.0
PLANTS = {
    "as it is": ("makki2024", ()),
    "continuous states": ("makki2024", ("rotor_lag=0.08", "coulomb_friction.travel", "ground_effect")),
    "sampled": ("makki2024", ("input_delay=0.0123", "backlash.pitch=0.02", "random_torque.travel")),
    "timed": ("makki2024", ("thrust_step.front=0.1@2", "periodic_torque.elevation", "thrust_fade")),
    "effects in its file": ("makki2024-identified", ()),
    "rests on its table": ("quanser-course", ()),
}


def plant_named(case: str) -> Plant:
    rig, effects = PLANTS[case]
    return plant_of(SilOptions(rig=rig, effects=effects))


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("fmu") / "plain.fmu"
    write_fmu(plant_named("as it is"), path)
    return path


@pytest.mark.parametrize("case", PLANTS)
def test_fmpy_finds_no_problem_and_both_interfaces_fly_the_plant(case: str, tmp_path: Path) -> None:
    plant, path = plant_named(case), tmp_path / "rig.fmu"
    write_fmu(plant, path)
    assert validate_fmu(str(path)) == []
    volts_V = voltages(SECONDS, trim(MultibodyModel(), plant.rig).volts_V)
    expected = plants_flight(plant, volts_V)
    # It flies: up from where it rested, and through its stops where the rig has it so.
    assert np.ptp(expected[:, 0]) > 0.1 and np.ptp(expected[:, 1]) > 0.01
    np.testing.assert_allclose(co_simulated(path, tmp_path / "cs", volts_V), expected, rtol=0, atol=1e-9)
    exchange_angles, events = by_model_exchange(path, tmp_path / "me", volts_V, len(plant.model.states))
    np.testing.assert_allclose(exchange_angles, expected, rtol=0, atol=1e-9)
    assert (events >= len(volts_V)) == (case == "sampled")


def test_longer_communication_steps_are_whole_milliseconds_inside(plain: Path, tmp_path: Path) -> None:
    plant = plant_named("as it is")
    held = np.repeat(voltages(3.0, np.array([1.8, 1.8]))[::20], 20, axis=0)
    expected = plants_flight(plant, held)[19::20]
    np.testing.assert_array_equal(co_simulated(plain, tmp_path / "cs", held, 20), expected)


def test_a_number_of_the_rig_can_be_set_and_has_its_effect(plain: Path, tmp_path: Path) -> None:
    variables = {variable.name: variable for variable in read_model_description(str(plain)).modelVariables}
    thrust_gain = variables["rig.thrust_gain"]
    slave = instance_in_initialization(plain, tmp_path / "u", co_simulation=True)
    slave.setFloat64([thrust_gain.valueReference], [1.1 * float(thrust_gain.start)])
    slave.exitInitializationMode()
    changed = plant_of(SilOptions())
    other = Plant(changed.model, changed.rig.replace(thrust_gain=1.1 * float(thrust_gain.start)))
    volts_V = voltages(2.0, np.array([1.8, 1.8]))
    for row, volts in enumerate(volts_V):
        slave.setFloat64(VOLTAGES, volts.tolist())
        slave.doStep(row * 1e-3, 1e-3)
    np.testing.assert_allclose(slave.getFloat64(OUTPUTS), plants_flight(other, volts_V)[-1], atol=1e-12)
    slave.freeInstance()


def test_a_state_kept_and_set_again_gives_the_same_flight_again(tmp_path: Path) -> None:
    path = tmp_path / "rig.fmu"
    write_fmu(plant_named("sampled"), path)
    slave = instance_in_initialization(path, tmp_path / "u", co_simulation=True)
    slave.exitInitializationMode()
    slave.setFloat64(VOLTAGES, [2.0, 1.9])
    slave.doStep(0.0, 0.5)
    kept = slave.serializeFMUState(slave.getFMUState())
    slave.doStep(0.5, 0.5)
    first = slave.getFloat64(OUTPUTS)
    slave.setFMUState(slave.deserializeFMUState(kept))
    slave.doStep(0.5, 0.5)
    assert slave.getFloat64(OUTPUTS) == first
    slave.freeInstance()


def test_the_sources_compile_by_themselves_without_a_warning(plain: Path, tmp_path: Path) -> None:
    with zipfile.ZipFile(plain) as archive:
        archive.extractall(tmp_path)
        listed = archive.read("sources/buildDescription.xml").decode()
    # Warnings about code that CasADi generates are not ours.
    sources = ["rig.c", "fmi3.c", "model_start.c"]
    assert all(f'name="{name}"' in listed for name in [*sources, "model.c"])
    subprocess.run(
        ["cc", "-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Werror", "-fsyntax-only", *sources],
        cwd=tmp_path / "sources",
        check=True,
    )


def test_every_function_of_the_standard_is_there(plain: Path, tmp_path: Path) -> None:
    import ctypes
    import re

    import fmpy

    header = (Path(fmpy.__file__).parent / "c-code" / "fmi3Functions.h").read_text()
    names = set(re.findall(r"\b(fmi3\w+)TYPE\b", header))
    with zipfile.ZipFile(plain) as archive:
        (binary,) = (name for name in archive.namelist() if name.startswith("binaries/"))
        archive.extract(binary, tmp_path)
    library = ctypes.CDLL(str(tmp_path / binary))
    assert len(names) > 60
    assert [name for name in sorted(names) if not hasattr(library, name)] == []


def test_another_token_is_refused(plain: Path, tmp_path: Path) -> None:
    import fmpy
    from fmpy.fmi3 import FMU3Slave

    slave = FMU3Slave(
        guid="{other}",
        unzipDirectory=fmpy.extract(str(plain), str(tmp_path / "u")),
        modelIdentifier="heli_makki2024",
        instanceName="rig",
    )
    with pytest.raises(Exception, match="instantiate"):
        slave.instantiate()


@pytest.mark.slow
def test_the_same_rig_gives_the_same_bytes_and_another_another_token(plain: Path, tmp_path: Path) -> None:
    write_fmu(plant_named("as it is"), tmp_path / "again.fmu")
    assert (tmp_path / "again.fmu").read_bytes() == plain.read_bytes()
    tokens = set()
    for effects in ((), ("rotor_lag=0.1",), ("rotor_lag=0.2",)):
        write_fmu(plant_of(SilOptions(effects=effects)), tmp_path / "other.fmu")
        tokens.add(read_model_description(str(tmp_path / "other.fmu")).instantiationToken)
    assert len(tokens) == 3


def test_without_a_compiler_the_sources_are_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("heli_sim.fmu.write.compiler", lambda: None)
    assert write_fmu(plant_named("as it is"), tmp_path / "a.fmu") == ""
    with zipfile.ZipFile(tmp_path / "a.fmu") as archive:
        names = archive.namelist()
    assert "sources/model.c" in names and not [name for name in names if name.startswith("binaries/")]
    assert validate_fmu(str(tmp_path / "a.fmu")) == []
