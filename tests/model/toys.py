"""Rigs and effects simple enough to have exact solutions."""

import casadi as ca
import numpy as np
import numpy.typing as npt
from heli_host.data.arrays import Floats
from heli_sim.model import Effect, Model, Operands, Quantity
from heli_sim.model.plant import Plant
from heli_sim.rig import Rig, load_rig

WIDE = {"elevation_min": -89.0, "elevation_max": 89.0, "pitch_max": 179.0, "travel_max": 1e6}
NO_LOSS = {
    "friction_elevation": 0.0,
    "friction_pitch": 0.0,
    "friction_travel": 0.0,
    "drag_area_arm": 0.0,
    "drag_area_body": 0.0,
}


def paper_rig(**values: float) -> Rig:
    return load_rig("makki2024").replace(**values)


def fly(plant: Plant, state: Floats, volts_V: tuple[float, float], ticks: int) -> Floats:
    """Where constant voltages take a plant: ticks in CasADi, not in Python."""
    held_V = np.tile(np.reshape(volts_V, (2, 1)), ticks)
    after, _ = plant.function.mapaccum(ticks)(state, held_V, np.zeros(3), plant.parameters)
    last: Floats = np.asarray(after)[:, -1]
    return last


def rates_function(model: Model) -> ca.Function:
    """(state, volts, parameters, time) -> rates."""
    x, u, t = ca.SX.sym("x", len(model.states)), ca.SX.sym("u", 2), ca.SX.sym("t")
    p = ca.SX.sym("p", len(model.parameters))
    return ca.Function("rates", [x, u, p, t], [model.dynamics(x, u, p, t)])


def rates(
    model: Model, rig: Rig, state: npt.ArrayLike, volts_V: npt.ArrayLike, time_s: float = 0.0
) -> Floats:
    values = model.parameter_values(rig)
    return np.asarray(rates_function(model)(np.asarray(state), np.asarray(volts_V), values, time_s)).ravel()


class FirstOrderLag(Effect):
    """Thrust follows its static value with a lag, one state for each rotor."""

    def __init__(self, lag_s: float) -> None:
        super().__init__(
            "lag",
            parameters=(Quantity("lag_s", "s", "time constant"),),
            values={"lag_s": lag_s},
            states=(Quantity("front_N", "N", "front"), Quantity("back_N", "N", "back")),
        )

    def thrust_N(self, at: Operands, thrust_N: ca.SX) -> ca.SX:
        return ca.vertcat(at.state["front_N"], at.state["back_N"])

    def state_rates(self, at: Operands) -> ca.SX:
        target = at.parameter["thrust_gain"] * ca.fmax(at.volts_V - at.parameter["dead_zone"], 0.0)
        return (target - ca.vertcat(at.state["front_N"], at.state["back_N"])) / at.parameter["lag_s"]


class TiltedEncoder(Effect):
    """The elevation encoder shows a tenth of the pitch."""

    def __init__(self) -> None:
        super().__init__("tilted encoder")

    def measured_rad(self, at: Operands, angles_rad: ca.SX) -> ca.SX:
        return angles_rad + ca.vertcat(0.1 * at.state["pitch_rad"], 0.0, 0.0)


class ConstantTorque(Effect):
    """A torque about the travel axis."""

    def __init__(self, torque_Nm: float) -> None:
        super().__init__("push", (Quantity("push_Nm", "N m", "torque about travel"),), {"push_Nm": torque_Nm})

    def torque_Nm(self, at: Operands) -> ca.SX:
        return ca.vertcat(0.0, 0.0, at.parameter["push_Nm"])
