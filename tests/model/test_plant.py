"""The compiled millisecond against closed forms, energy and another integrator; the cache of libraries."""

import ctypes
import math
import os
import subprocess
import sys
from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from heli_host.data.arrays import Floats
from heli_sim import _native
from heli_sim.errors import PlantError
from heli_sim.evaluate import compiled
from heli_sim.evaluate.compiled import (
    cache_folder,
    compile_source,
    compiler,
    is_intact,
    keep,
    writable_by_others,
)
from heli_sim.model import Model, PaperModel
from heli_sim.model.effect import Operands
from heli_sim.model.plant import Plant, runge_kutta_step
from scipy.integrate import solve_ivp

from tests.model.toys import NO_LOSS, WIDE, ConstantTorque, FirstOrderLag, fly, paper_rig, rates_function

AXES = ("elevation", "pitch", "travel")


def world_of(plant: Plant, state: Floats, step: _native.PlantStep | None = None) -> _native.World:
    return _native.World(
        step or plant.native_step(),
        state.tolist(),
        plant.parameters.tolist(),
        supply_V=12.0,
        dead_band=0.06,
        counts_per_rad=[4096 / (2 * np.pi)] * 3,
        offset_count=[0.0, 0.0, 0.0],
    )


@pytest.mark.medium
@pytest.mark.parametrize("model", [PaperModel(), PaperModel((FirstOrderLag(0.1),))], ids=["bare", "lag"])
def test_flight_agrees_with_scipys_integrator_on_the_same_symbols(model: Model) -> None:
    rig = paper_rig(**WIDE)
    plant, function = Plant(model, rig), rates_function(model)
    p, start = model.parameter_values(rig), np.zeros(len(model.states))
    start[:6] = [-0.3, 0.2, 0.1, 0.1, -0.3, 0.2]
    volts_V = (1.9, 1.7)
    witness = solve_ivp(
        lambda t, x: np.asarray(function(x, list(volts_V), p, t)).ravel(),
        (0.0, 3.0),
        start,
        method="DOP853",
        rtol=1e-12,
        atol=1e-12,
    )
    assert fly(plant, start, volts_V, 3000) == pytest.approx(witness.y[:, -1], abs=1e-8)


@pytest.mark.medium
def test_travel_coasts_down_as_an_exponential() -> None:
    rig = paper_rig(**WIDE, drag_area_arm=0.0, drag_area_body=0.0)
    plant = Plant(PaperModel(), rig)
    end = fly(plant, np.array([0, 0, 0, 0, 0, 0.8]), (0.0, 0.0), 5000)
    decay = np.exp(-5.0 * 0.035 / 0.8195116)
    assert end[5] == pytest.approx(0.8 * decay, rel=1e-6)
    assert end[2] == pytest.approx(0.8 * (1 - decay) * 0.8195116 / 0.035, rel=1e-6)


@pytest.mark.medium
def test_a_constant_torque_without_friction_gives_a_parabola() -> None:
    plant = Plant(PaperModel((ConstantTorque(0.08195116),)), paper_rig(**WIDE | NO_LOSS))
    end = fly(plant, np.zeros(6), (0.0, 0.0), 2000)
    assert end[[2, 5]] == pytest.approx([0.2, 0.2], rel=1e-6)


@pytest.mark.medium
def test_small_pitch_swings_have_the_period_of_P_8() -> None:
    plant = Plant(PaperModel(), paper_rig(**WIDE | NO_LOSS))
    half_period = np.pi / np.sqrt(1.0778 * 9.81 * 0.03 / 0.05466378)
    ticks = round(1e3 * half_period)
    end = fly(plant, np.array([0, 0.001, 0, 0, 0, 0]), (0.0, 0.0), ticks)
    assert end[1] == pytest.approx(-0.001, rel=1e-4)


@pytest.mark.slow
def test_without_friction_a_swing_keeps_its_energy() -> None:
    plant = Plant(PaperModel(), paper_rig(**WIDE | NO_LOSS))
    a = 9.81 * (1.565 * 0.45 - 1.0778 * 0.64 - 0.68 * 0.1)
    b = 9.81 * (1.0778 + 1.565 + 0.68) * 0.03

    def energy_J(x: Floats) -> float:
        pitch = 9.81 * 1.0778 * 0.03 * (1 - np.cos(x[1]))
        kinetic = 0.5 * (0.767531 * x[3] ** 2 + 0.05466378 * x[4] ** 2)
        return float(kinetic - a * np.sin(x[0]) + b * (1 - np.cos(x[0])) + pitch)

    start = np.array([0.5, 0.4, 0, 0, 0, 0])
    end = fly(plant, start, (0.0, 0.0), 10_000)
    assert energy_J(end) == pytest.approx(energy_J(start), rel=1e-5)
    assert abs(end[0] - start[0]) > 0.01


@pytest.mark.medium
@pytest.mark.parametrize(
    ("axis", "side", "stop_deg"),
    [(0, 1, 25), (0, -1, -25), (1, 1, 50), (1, -1, -50), (2, 1, 180), (2, -1, -180)],
)
def test_a_stop_holds_the_angle_and_takes_the_speed(axis: int, side: int, stop_deg: float) -> None:
    plant = Plant(PaperModel(), paper_rig())
    state = np.zeros(6)
    state[axis], state[3 + axis] = np.deg2rad(stop_deg) - side * 1e-4, side * 1.0
    after, measured = plant.step(state, (1.7028, 1.7028))
    assert after[axis] == pytest.approx(np.deg2rad(stop_deg), abs=1e-15)
    assert after[3 + axis] == 0.0
    assert measured[axis] == after[axis]


@pytest.mark.medium
def test_the_arm_rests_on_the_table_for_ever_and_lifts_off_above_hover() -> None:
    plant = Plant(PaperModel(), paper_rig())
    rest = plant.rest_state()
    assert fly(plant, rest, (0.0, 0.0), 2000) == pytest.approx(rest, abs=0.0)
    assert fly(plant, rest, (1.9, 1.9), 2000)[0] > np.deg2rad(-20.0)


@pytest.mark.medium
def test_motion_on_the_table_dies_within_a_degree() -> None:
    plant = Plant(PaperModel(), paper_rig())
    rest = plant.rest_state()
    slid = fly(plant, np.array([rest[0], 0, 0, 0, 0, 0.5]), (0.0, 0.0), 500)
    assert abs(slid[5]) < 1e-9
    assert abs(slid[2]) < np.deg2rad(1.0)


@pytest.mark.medium
@pytest.mark.parametrize("axis", range(3), ids=AXES)
def test_a_locked_axis_stays_where_it_is_and_the_others_move(axis: int) -> None:
    plant = Plant(PaperModel(), paper_rig(**WIDE))
    locked = (axis == 0, axis == 1, axis == 2)
    state = np.array([0.05, 0.1, 0.1, 0.0, 0.0, 0.0])
    start = state
    for _ in range(500):
        state, _ = plant.step(state, (2.5, 2.2), locked)
    assert state[axis] == start[axis]
    assert state[3 + axis] == 0.0
    assert all(state[other] != start[other] for other in range(3) if other != axis)


@pytest.mark.medium
def test_compiled_and_interpreted_plants_agree() -> None:
    plant = Plant(PaperModel(), paper_rig(**WIDE))
    start = np.array([-0.3, 0.2, 0.1, 0.1, -0.3, 0.2])
    world = world_of(plant, start)
    world.advance(400, b"")
    assert np.array(world.state) == pytest.approx(fly(plant, start, (0.0, 0.0), 400), abs=1e-13)


@pytest.mark.medium
def test_without_a_compiler_the_same_flight_comes_out(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    plant = Plant(PaperModel(), paper_rig(**WIDE))
    start = np.array([-0.3, 0.2, 0.1, 0.1, -0.3, 0.2])
    fast = world_of(plant, start)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(compiled, "compiler", lambda: None)
    step = plant.native_step()
    assert isinstance(step, _native.CallbackStep)
    slow = world_of(plant, start, step)
    for world in (fast, slow):
        world.advance(300, b"")
    assert slow.state == pytest.approx(fast.state, abs=1e-13)


@pytest.mark.medium
def test_an_exception_in_a_python_plant_reaches_the_caller() -> None:
    plant = Plant(PaperModel(), paper_rig())

    def broken(*_: object) -> tuple[list[float], list[float]]:
        raise ZeroDivisionError

    step = _native.CallbackStep(broken, 6, len(plant.parameters))
    with pytest.raises(ZeroDivisionError):
        world_of(plant, plant.rest_state(), step).advance(1, b"")


@pytest.mark.medium
def test_vectors_of_another_length_are_refused() -> None:
    plant = Plant(PaperModel(), paper_rig())
    with pytest.raises(ValueError, match="takes 6"):
        world_of(plant, np.zeros(5))
    world = world_of(plant, plant.rest_state())
    with pytest.raises(ValueError, match="takes 6"):
        world.state = [0.0]


@pytest.mark.medium
def test_a_library_that_is_no_plant_is_refused(tmp_path: Path) -> None:
    other = tmp_path / "other.so"
    other.write_bytes(b"no library")
    with pytest.raises(RuntimeError, match="does not load"):
        _native.CompiledStep(str(other), "plant_step")
    with pytest.raises(RuntimeError, match="lacks"):
        _native.CompiledStep(_native.__file__, "plant_step")


@pytest.mark.medium
def test_two_processes_may_compile_the_same_plant_at_once(tmp_path: Path) -> None:
    code = (
        "from heli_sim.model import PaperModel; from heli_sim.model.plant import Plant; "
        "from heli_sim.rig import load_rig; "
        "print(type(Plant(PaperModel(), load_rig('makki2024')).native_step()).__name__)"
    )
    environment = {**os.environ, "XDG_CACHE_HOME": str(tmp_path)}
    both = [
        subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, env=environment)
        for _ in range(2)
    ]
    assert [process.communicate()[0].strip() for process in both] == ["CompiledStep"] * 2
    assert [path.suffix for path in (tmp_path / "heli_sim").iterdir()] == [".so"]


@pytest.mark.medium
def test_a_plant_is_compiled_once_for_all_rigs(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    Plant(PaperModel(), paper_rig()).native_step()
    Plant(PaperModel(), paper_rig(M_w=1.6)).native_step()
    assert len(list((tmp_path / "heli_sim").iterdir())) == 1
    Plant(PaperModel((FirstOrderLag(0.1),)), paper_rig()).native_step()
    assert len(list((tmp_path / "heli_sim").iterdir())) == 2


class Lighter(PaperModel):
    """Half of the inertia about each axis."""

    def acceleration(self, at: Operands, thrust_N: ca.SX, torque_Nm: ca.SX) -> ca.SX:
        return 2.0 * super().acceleration(at, thrust_N, torque_Nm)


@pytest.mark.medium
def test_plants_share_their_step_only_if_their_equations_are_the_same() -> None:
    plain, light = Plant(PaperModel(), paper_rig()), Plant(Lighter(), paper_rig())
    assert Plant(PaperModel(), paper_rig(M_w=1.6), seed=2).function is plain.function
    assert Plant(PaperModel((FirstOrderLag(0.1),)), paper_rig()).function.numel_in(0) == 8
    rates = [plant.step(np.zeros(6), (9.0, 9.0))[0][3] for plant in (plain, light)]
    assert rates[0] > 0.0
    assert rates[1] == pytest.approx(2.0 * rates[0], rel=0.01)


def oscillator(state: Floats, later_s: float) -> Floats:
    """A mass on a spring under a force that grows with time."""
    return np.array([state[1], later_s - state[0]])


def error(step_s: float) -> float:
    after = runge_kutta_step(oscillator, np.array([1.0, 0.0]), step_s)
    exact = step_s + math.cos(step_s) - math.sin(step_s)
    return abs(float(after[0]) - exact)


def test_half_the_step_has_a_thirty_second_of_the_error() -> None:
    assert error(0.2) / error(0.1) == pytest.approx(32.0, rel=0.1)


def test_symbols_and_numbers_take_the_same_step() -> None:
    x = ca.SX.sym("x", 2)
    step = ca.Function(
        "step", [x], [runge_kutta_step(lambda at, later_s: ca.vertcat(at[1], later_s - at[0]), x, 0.1)]
    )
    numbers = runge_kutta_step(oscillator, np.array([1.0, 0.5]), 0.1)
    assert np.asarray(step([1.0, 0.5])).ravel() == pytest.approx(numbers, rel=1e-15)


SOURCE = "double tiny(void) { return 1.5; }\n"

needs_compiler = pytest.mark.skipif(compiler() is None, reason="skipped: no C compiler")
posix = pytest.mark.skipif(os.name != "posix", reason="skipped: owners and modes are POSIX")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache of its own for every test."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "heli_sim"


def build() -> Path:
    library = compile_source("tiny", SOURCE)
    assert library is not None
    return library


@pytest.mark.usefixtures("folder")
@needs_compiler
@pytest.mark.medium
def test_a_library_that_a_power_cut_damaged_is_built_again() -> None:
    library = build()
    complete = library.read_bytes()
    for damaged in (
        b"",
        complete[:700],
        complete[: len(complete) // 2],
        complete[:-1],
        bytes(len(complete)),
        complete[:-2000],
    ):
        library.write_bytes(damaged)
        assert not is_intact(library)
        assert build() == library and is_intact(library)
    # In a process of its own: a library cut short can end the one that loads it.
    script = f"import ctypes; f = ctypes.CDLL({str(library)!r}).tiny; f.restype = ctypes.c_double; print(f())"
    assert subprocess.check_output([sys.executable, "-c", script], text=True).strip() == "1.5"


@pytest.mark.usefixtures("folder")
@needs_compiler
@pytest.mark.medium
def test_a_whole_library_is_not_built_again(monkeypatch: pytest.MonkeyPatch) -> None:
    library = build()
    monkeypatch.setattr(subprocess, "run", pytest.fail)
    assert build() == library


@pytest.mark.usefixtures("folder")
@needs_compiler
@pytest.mark.medium
def test_a_library_of_a_version_without_digests_is_built_again() -> None:
    library = build()
    library.write_bytes(library.read_bytes().partition(b"\nheli_sim sha256 ")[0])
    ctypes.CDLL(str(library))
    assert not is_intact(library)
    assert is_intact(build())


@pytest.mark.usefixtures("folder")
def test_a_library_is_on_the_disk_before_it_has_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    built, library = tmp_path / "f.so", tmp_path / "a.so"
    built.write_bytes(b"code")
    synced: list[tuple[int, bool]] = []

    def sync(descriptor: int) -> None:
        synced.append((os.fstat(descriptor).st_size, library.exists()))

    monkeypatch.setattr("heli_sim.evaluate.compiled.os.fsync", sync)
    keep(built, library)
    assert synced == [(library.stat().st_size, False)]
    assert is_intact(library) and not built.exists()


@posix
@pytest.mark.parametrize("mode", [0o777, 0o775, 0o1777])
def test_a_cache_that_others_can_write_is_refused(folder: Path, mode: int) -> None:
    folder.mkdir()
    folder.chmod(mode)
    with pytest.raises(PlantError, match=r"others can write to the cache .*; check .* remove it with: rm -r"):
        cache_folder()


@posix
def test_a_cache_is_made_for_its_user_alone(folder: Path) -> None:
    before = os.umask(0)
    try:
        assert cache_folder() == folder
    finally:
        os.umask(before)
    assert folder.stat().st_mode & 0o077 == 0 and writable_by_others(folder) == ""


@posix
def test_a_library_that_others_can_write_is_not_loaded(folder: Path) -> None:
    folder.mkdir()
    built, library = folder / "f.so", folder / "a.so"
    built.write_bytes(b"code")
    keep(built, library)
    assert is_intact(library)
    library.chmod(0o666)
    assert not is_intact(library)


@posix
def test_a_cache_of_another_user_is_reported(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder.mkdir()
    monkeypatch.setattr("heli_sim.evaluate.compiled.os.geteuid", lambda: folder.stat().st_uid + 1)
    if folder.stat().st_uid != 0:
        assert "belongs to another user" in writable_by_others(folder)
        return
    os.chown(folder, 12345, -1)
    assert "belongs to another user" in writable_by_others(folder)
