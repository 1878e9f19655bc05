"""A millisecond of the rig, against MuJoCo's on the same rig, and its linearisation."""

from __future__ import annotations

import ctypes
import time
from collections.abc import Callable

import numpy as np
import numpy.typing as npt
from heli_sim.compiled import c_source, compile_source
from heli_sim.model import MultibodyModel
from heli_sim.model.linear import linearise, trim
from heli_sim.plant import Plant
from heli_sim.rig import load_rig

from tests.bench.flights import RIG
from tests.bench.result import Measured, repeat

REPETITIONS = 7
STEPS = 2_000
"""Two seconds from level, at voltages that nearly hover: no stop is reached."""
ROUNDS = 50

_LOOP = """
int plant_steps(long long steps, double* state, const double* volts, const double* locked, const double* p) {{
  double after[{states}], measured[3], w[{w}];
  long long iw[{iw}];
  const double* arg[{arg}] = {{state, volts, locked, p}};
  double* res[{res}] = {{after, measured}};
  for (long long k = 0; k < steps; ++k) {{
    plant_step(arg, res, iw, w, 0);
    for (int i = 0; i < {states}; ++i) state[i] = after[i];
  }}
  return 0;
}}
"""


def hovering() -> tuple[Plant, npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """The multibody rig, a state near level, and voltages."""
    rig = load_rig(RIG)
    plant = Plant(MultibodyModel(), rig)
    at = trim(plant.model, rig)
    return plant, np.array([*at.state]), np.array([*at.volts_V])


def our_step() -> Callable[[], float]:
    """Nanoseconds for one compiled step, as the simulated board calls it."""
    plant, state, volts = hovering()
    function = plant.function
    loop = _LOOP.format(
        states=len(state),
        w=max(1, function.sz_w()),
        iw=max(1, function.sz_iw()),
        arg=max(4, function.sz_arg()),
        res=max(2, function.sz_res()),
    )
    library = compile_source("bench_plant", c_source(function) + loop)
    assert library is not None, "the bench needs a C compiler"
    call = ctypes.CDLL(str(library)).plant_steps
    arrays = state.copy(), volts, np.zeros(3), plant.parameters
    pointers = [ctypes.c_void_p(array.ctypes.data) for array in arrays]

    def measure() -> float:
        passed_s = 0.0
        for _ in range(ROUNDS):
            arrays[0][:] = state
            start_s = time.perf_counter()
            call(ctypes.c_longlong(STEPS), *pointers)
            passed_s += time.perf_counter() - start_s
        assert abs(arrays[0][0]) < 0.1, "the arm left level"
        return 1e9 * passed_s / (ROUNDS * STEPS)

    return measure


def mujocos_step() -> Callable[[], float]:
    """Nanoseconds for one mj_step of the same masses, RK4 at 1 ms as well."""
    import mujoco
    from heli_benchmark.engine.bodies import mujoco_rig

    plant, _, volts = hovering()
    physics = mujoco_rig(plant.rig)
    data = mujoco.MjData(physics)
    gain, dead_V = plant.rig["thrust_gain"].value, plant.rig["dead_zone"].value

    def measure() -> float:
        passed_s = 0.0
        for _ in range(ROUNDS // 10):
            mujoco.mj_resetData(physics, data)
            data.ctrl[:] = gain * (volts - dead_V)
            start_s = time.perf_counter()
            mujoco.mj_step(physics, data, STEPS)
            passed_s += time.perf_counter() - start_s
        return 1e9 * passed_s / (ROUNDS // 10 * STEPS)

    return measure


def linearise_ms() -> float:
    """Trim and linearise the multibody rig, its symbols being there."""
    rig, model = load_rig(RIG), MultibodyModel()
    linearise(model, rig)
    start_s = time.perf_counter()
    for _ in range(20):
        linearise(model, rig)
    return 1e3 * (time.perf_counter() - start_s) / 20


def measure() -> list[Measured]:
    """Step ours and MuJoCo's in turn, then linearise."""
    ours, theirs = our_step(), mujocos_step()
    pairs = [(ours(), theirs()) for _ in range(REPETITIONS)]
    return [
        Measured("plant_step_ns", [ours_ns for ours_ns, _ in pairs]),
        Measured("mujoco_step_ns", [mujoco_ns for _, mujoco_ns in pairs]),
        Measured("plant_step_ratio_to_mujoco", [mujoco_ns / ours_ns for ours_ns, mujoco_ns in pairs]),
        repeat("linearise_ms", REPETITIONS, linearise_ms),
    ]
