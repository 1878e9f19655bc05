"""The rig in MuJoCo: bodies and joints, a plant that the flight code flies, and the true trajectory.

Effects are hidden in this plant. It does not use the equations of the project.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import mujoco
import numpy as np
from heli_host.data.arrays import Floats
from heli_sim import _native
from heli_sim.rig import Rig

JOINTS = ("elevation", "pitch", "travel")
_SITE = mujoco.mjtObj.mjOBJ_SITE
# MuJoCo requires an inertia of each body; this one is small enough for a point mass.
_POINT = 'diaginertia="1e-12 1e-12 1e-12"'


def mujoco_rig(rig: Rig, *, step_s: float = 0.001, hung: str = "") -> Any:
    """Build a MuJoCo model with the masses of the rig as bodies and its axes as joints; `hung` is the XML of
    further bodies on the long arm.
    """
    import mujoco

    # Values by the paper's names: masses M, lengths L, and g.
    v = {name: rig[name].value for name in rig}
    arm_z, body_z = -v["L_theta"], -v["L_phi"]

    def mass(name: str, kg: float, x: float, y: float, z: float) -> str:
        """Return a point mass at a place in m, relative to the body that contains it, as XML."""
        return f'<body name="{name}" pos="{x} {y} {z}"><inertial pos="0 0 0" mass="{kg}" {_POINT}/></body>'

    return mujoco.MjModel.from_xml_string(f"""
    <mujoco>
      <compiler angle="radian" balanceinertia="false"/>
      <option timestep="{step_s}" integrator="RK4" gravity="0 0 -{v["g"]}"><flag contact="disable"/></option>
      <worldbody>
        <body name="post">
          <inertial pos="0 0 0" mass="1e-9" {_POINT}/>
          <joint name="travel" axis="0 0 1" damping="{v["friction_travel"]}"/>
          <body name="arm">
            <inertial pos="0 0 0" mass="1e-9" {_POINT}/>
            <joint name="elevation" axis="0 -1 0" damping="{v["friction_elevation"]}"/>
            {mass("long_arm", v["M_l"], v["L_x"], 0, arm_z)}
            {mass("counterweight", v["M_w"], -v["L_b"], 0, arm_z)}
            {hung}
            <body name="body" pos="{v["L_a"]} 0 {arm_z}">
              <inertial pos="0 0 0" mass="1e-9" {_POINT}/>
              <joint name="pitch" axis="-1 0 0" damping="{v["friction_pitch"]}"/>
              {mass("short_arm", v["M_h"], 0, 0, body_z)}
              {mass("front_rotor", v["M_f"], 0, -v["L_h"], body_z)}
              {mass("back_rotor", v["M_b"], 0, v["L_h"], body_z)}
              <site name="front" pos="0 {-v["L_h"]} 0"/>
              <site name="back" pos="0 {v["L_h"]} 0"/>
            </body>
          </body>
        </body>
      </worldbody>
      <actuator>
        <general site="front" gear="0 0 1 0 0 0"/>
        <general site="back" gear="0 0 1 0 0 0"/>
      </actuator>
    </mujoco>""")


STEP_S = 0.0005
"""Time step of MuJoCo; the world asks for two steps, one millisecond, at a time."""


@dataclass
class Moment:
    """State of the rig within a step, which a hidden effect may read and change."""

    time_s: float  # Time since the rig was switched on
    flight_s: float  # Time since the motors first ran
    volts_V: Floats  # (2,): Voltages at the motors, front and back
    thrust_N: Floats  # (2,): Thrusts, front and back
    angles_rad: Floats  # angles_rad, rates_rad_s: (3,): Elevation, pitch and travel
    rates_rad_s: Floats
    above_V: Floats = field(default_factory=lambda: np.zeros(2))
    """(2,): Voltages beyond the dead zone, with their sign; set together with the thrust."""
    gain_N_per_V: float = 0.0  # Thrust per volt beyond the dead zone; set together with the thrust
    torque_Nm: Floats = field(default_factory=lambda: np.zeros(3))
    """(3,): Additional torques about the three axes."""
    up: Floats = field(default_factory=lambda: np.zeros(3))  # (3,): Direction of the rotors' axes in the room
    climb_m_s: Floats = field(default_factory=lambda: np.zeros(2))
    """(2,): Speed of each rotor along its own axis."""


class HiddenEffect:
    """An effect that the rig has and the model lacks."""

    # The plant calls each method below at its point of the simulation. A subclass overrides some of them.

    late: bool = False
    """Whether `thrust` acts after all other effects that change the thrust."""

    flight_rng: np.random.Generator
    """Draws what differs between flights. Set before a flight."""

    def __init__(self, size: float, rng: np.random.Generator) -> None:
        self.size = size
        self.truth: dict[str, float] = {"size": size}

    def hung(self, rig: Rig) -> str:
        """Return bodies that hang on the long arm of a `rig`, as XML of MuJoCo."""
        return ""

    def configure(self, model: Any) -> None:
        """Change the `model` of MuJoCo before the flight."""

    def rest(self, state: Floats) -> None:
        """Change the `state` at power-up, shape (6,), in place."""

    def volts(self, at: Moment) -> None:
        """Change the voltages at the motors, `at.volts_V`."""

    def thrust(self, at: Moment) -> None:
        """Change the thrusts of both rotors, `at.thrust_N`."""

    def torque(self, at: Moment) -> None:
        """Add torques about the axes to `at.torque_Nm`."""

    def during(self, at: Moment, model: Any) -> None:
        """Change the `model` of MuJoCo in flight."""

    def measured(self, angles_rad: Floats) -> Floats:
        """Return the angles that the encoders see when the true ones are `angles_rad`, shape (3,)."""
        return angles_rad


class MujocoPlant:
    """The rig in MuJoCo, with the members of `heli_sim.model.plant.Plant` that `SilWorld` uses."""

    def __init__(self, rig: Rig, hidden: Sequence[HiddenEffect]) -> None:
        self.rig = rig
        self.hidden = sorted(hidden, key=lambda effect: effect.late)
        self.physics = mujoco_rig(
            rig, step_s=STEP_S, hung="".join(effect.hung(rig) for effect in self.hidden)
        )
        for effect in self.hidden:
            effect.configure(self.physics)
        self.data = mujoco.MjData(self.physics)
        # Where MuJoCo's vectors have the angle and the rate of each joint.
        self._angle_rows = np.array([self.physics.joint(name).qposadr[0] for name in JOINTS])
        self._rate_rows = np.array([self.physics.joint(name).dofadr[0] for name in JOINTS])
        self._sites = [self.physics.site(name).id for name in ("front", "back")]
        # Views of MuJoCo's memory: to look each up again in every step took a third of a flight's time.
        self._qpos, self._qvel, self._ctrl = self.data.qpos, self.data.qvel, self.data.ctrl
        self._applied_Nm = self.data.qfrc_applied
        self._up = self.data.xmat[self.physics.body("body").id].reshape(3, 3)[:, 2]
        self._velocity = np.zeros(6)  # MuJoCo writes the angular velocity first, then the linear one
        self._speed_m_s = self._velocity[3:]
        self.parameters: Floats = np.zeros(1)  # SilWorld passes them on; no member here reads them
        self._rest = np.array([np.deg2rad(rig["elevation_min"].value), 0.0, 0.0, 0.0, 0.0, 0.0])
        for effect in self.hidden:
            effect.rest(self._rest)
        self._lowest_rad = float(self._rest[0])
        self._time_s = self._flight_s = 0.0
        self._is_released = False
        self._gain, self._dead_zone_V = rig["thrust_gain"].value, rig["dead_zone"].value
        self._reverse = rig["reverse_thrust"].value
        self._steady_Nm = np.array([rig[f"torque_{axis}"].value for axis in JOINTS])
        zeros_deg = (rig["offset_elevation"].value, rig["offset_pitch"].value, 0.0)
        self._zeros_rad = np.deg2rad(zeros_deg)

    def rest_state(self) -> Floats:
        """Return the state at rest on the table, shape (6,)."""
        return self._rest.copy()

    def step(self, state: Floats, volts_V: Sequence[float]) -> tuple[Floats, Floats]:
        """Return the `state` unchanged, because the arm is held; `volts_V` are 0 when the world asks."""
        return state, state[:3]

    def holding_torque_Nm(self) -> Floats:
        """Return the torques that hold the level arm still with its motors off, shape (3,)."""
        self.data.qpos[:], self.data.qvel[:] = 0.0, 0.0
        mujoco.mj_forward(self.physics, self.data)
        return np.asarray(self.data.qfrc_bias[self._rate_rows])

    def native_step(self) -> _native.PlantStep:
        """Return `millisecond` as a step that the world calls."""
        return _native.CallbackStep(self._call_millisecond, 6, 1)

    def millisecond(
        self, state: Sequence[float], volts_V: Sequence[float]
    ) -> tuple[list[float], list[float]]:
        """Simulate one millisecond."""
        volts = np.array(volts_V)
        self._qpos[self._angle_rows], self._qvel[self._rate_rows] = state[:3], state[3:]
        # The masses in Table 2 of the paper would lift the arm from the table with the motors off, so the
        # arm is held down until the motors run.
        self._is_released = self._is_released or bool(volts.any())
        if self._is_released:
            for _ in range(2):
                self._simulate_step(volts)
        self._time_s += 0.001
        angles, rates = self._qpos.take(self._angle_rows), self._qvel.take(self._rate_rows)
        # On the table, elevation stops, and pitch and travel lose 1 % of their rates per millisecond.
        if angles[0] <= self._lowest_rad:
            angles[0], rates = self._lowest_rad, rates * np.array([0.0, 0.99, 0.99])
        return [*angles.tolist(), *rates.tolist()], self.encoder_angles_rad(angles).tolist()

    def act(self, at: Moment) -> None:
        """Compute thrusts and torques of a moment from its voltages, hidden effects included."""
        for effect in self.hidden:
            effect.volts(at)
        forward_V = np.maximum(at.volts_V - self._dead_zone_V, 0.0)
        backward_V = np.maximum(-at.volts_V - self._dead_zone_V, 0.0)
        at.above_V = forward_V - backward_V
        at.gain_N_per_V = self._gain
        at.thrust_N = self._gain * (forward_V - self._reverse * backward_V)
        at.torque_Nm += self._steady_Nm
        for effect in self.hidden:
            effect.thrust(at)
        for effect in self.hidden:
            effect.torque(at)

    def acceleration(
        self, angles_rad: Floats, rates_rad_s: Floats, thrust_N: Floats, torque_Nm: Floats
    ) -> Floats:
        """Return the accelerations of the three axes in a given state, rad/s2, shape (3,). Shapes:
        `angles_rad, rates_rad_s` (3,), `thrust_N` (2,), `torque_Nm` (3,).
        """
        data = self.data
        data.qpos[self._angle_rows], data.qvel[self._rate_rows] = angles_rad, rates_rad_s
        data.ctrl[:] = thrust_N
        data.qfrc_applied[self._rate_rows] = torque_Nm
        mujoco.mj_forward(self.physics, data)
        return np.asarray(data.qacc[self._rate_rows])

    def encoder_angles_rad(self, angles_rad: Floats) -> Floats:
        """Return the angles that the encoders see for true `angles_rad`, shape (3,)."""
        # Call it once per millisecond, because play has a memory.
        encoder_rad = angles_rad + self._zeros_rad
        for effect in self.hidden:
            encoder_rad = effect.measured(encoder_rad)
        return encoder_rad

    def _call_millisecond(
        self, state: list[float], volts_V: list[float], locked: list[float], parameters: list[float]
    ) -> tuple[list[float], list[float]]:
        """Call `millisecond` with the arguments of a native plant; locks and parameters do not apply."""
        return self.millisecond(state, volts_V)

    def _simulate_step(self, volts_V: Floats) -> None:
        """Simulate one step of MuJoCo: half a millisecond."""
        data, physics, velocity = self.data, self.physics, self._velocity
        mujoco.mj_kinematics(physics, data)
        mujoco.mj_comPos(physics, data)
        mujoco.mj_comVel(physics, data)
        up = self._up.copy()
        climb = np.empty(2)
        for i, site in enumerate(self._sites):
            is_in_site_axes = 0  # 0: the velocity is in the axes of the world
            mujoco.mj_objectVelocity(physics, data, _SITE, site, velocity, is_in_site_axes)
            climb[i] = self._speed_m_s.dot(up)
        at = Moment(
            self._time_s,
            self._flight_s,
            volts_V.copy(),
            thrust_N=np.zeros(2),
            angles_rad=self._qpos.take(self._angle_rows),
            rates_rad_s=self._qvel.take(self._rate_rows),
            up=up,
            climb_m_s=climb,
        )
        self.act(at)
        for effect in self.hidden:
            effect.during(at, physics)
        self._ctrl[:] = at.thrust_N
        self._applied_Nm[self._rate_rows] = at.torque_Nm
        mujoco.mj_step(physics, data)
        self._flight_s += STEP_S


class Delay:
    """A delay of `delay_s`, rounded to whole steps; `initial` is its output at first."""

    def __init__(self, delay_s: float, initial: Floats) -> None:
        self._queue = deque([initial.copy()] * max(1, round(delay_s / STEP_S)))
        self.delay_s = len(self._queue) * STEP_S

    def __call__(self, value: Floats) -> Floats:
        self._queue.append(value.copy())
        return self._queue.popleft()


@dataclass(frozen=True)
class TrueTrajectory:
    """States and inputs of a flight every half millisecond."""

    angles_rad: Floats
    """angles_rad, rates_rad_s: (n, 3): True angles and rates of elevation, pitch and travel."""
    rates_rad_s: Floats
    volts_V: Floats  # (n, 2): Voltages at the motors
    up: Floats  # (n, 3): Direction of the rotors' axes in the room
    climb_m_s: Floats  # (n, 2): Speed of each rotor along its own axis
    time_s: Floats
    """time_s, flight_s: (n,): Time since the rig was switched on, and since the motors first ran."""
    flight_s: Floats

    def perturbed(self, state: int, by: float) -> TrueTrajectory:
        """Return the trajectory with one `state` (0 to 2 angles, 3 to 5 rates) shifted `by` rad or rad/s."""
        name, axis = ("angles_rad", "rates_rad_s")[state // 3], state % 3
        values = getattr(self, name).copy()
        values[:, axis] += by
        return replace(self, **{name: values})

    def moment(self, k: int) -> Moment:
        """Return the `k`-th half millisecond as a hidden effect sees it before anything acts."""
        return Moment(
            float(self.time_s[k]),
            float(self.flight_s[k]),
            self.volts_V[k].copy(),
            thrust_N=np.zeros(2),
            angles_rad=self.angles_rad[k],
            rates_rad_s=self.rates_rad_s[k],
            up=self.up[k],
            climb_m_s=self.climb_m_s[k],
        )


class TrajectoryRecorder(HiddenEffect):
    """Records the trajectory before any effect acts, and changes nothing."""

    def __init__(self) -> None:
        super().__init__(0.0, np.random.default_rng(0))
        self._rows: list[tuple[float, ...]] = []

    def volts(self, at: Moment) -> None:
        self._rows.append(
            (*at.angles_rad, *at.rates_rad_s, *at.volts_V, *at.up, *at.climb_m_s, at.time_s, at.flight_s)
        )

    def trajectory(self) -> TrueTrajectory:
        """Return the recorded trajectory."""
        rows = np.array(self._rows)
        angles, rates, volts, up, climb = np.split(rows[:, :13], [3, 6, 8, 11], axis=1)
        return TrueTrajectory(angles, rates, volts, up, climb, time_s=rows[:, 13], flight_s=rows[:, 14])
