"""The rig as a MuJoCo model: the same masses at the same places, as bodies and joints."""

from __future__ import annotations

from typing import Any

from heli_sim.rig import Rig

JOINTS = ("elevation", "pitch", "travel")
# MuJoCo requires an inertia of each body; this one is small enough for a point mass.
_POINT = 'diaginertia="1e-12 1e-12 1e-12"'


def mujoco_rig(rig: Rig, *, step_s: float = 0.001, hung: str = "") -> Any:
    """Build a MuJoCo model with the masses of the rig as bodies and its axes as joints."""
    import mujoco

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
