"""A rig as MuJoCo's XML (MJCF): point masses on three hinges, thrust, friction, constant torques, stops.

MuJoCo's recursive algorithms share only the masses and their places with the equations of `multibody.py`. A
test compares flights of both.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final
from xml.sax.saxutils import escape

import numpy as np

from heli_sim.rig import Rig

# MuJoCo requires an inertia of each body; this one is small enough for a point mass.
_POINT: Final = 'diaginertia="1e-12 1e-12 1e-12"'


def left_out(rig: Rig) -> list[str]:
    """Return the properties of a `rig` that its MJCF file does not contain, one line each."""
    lines = [f"the effect {name}" for name in rig.effects]
    if rig["reverse_thrust"].value:
        lines.append("thrust at reversed voltage: rotors pull one way")
    lines += [
        "air drag: MuJoCo has its own model",
        "the table under the arm and its damping; a stop replaces it",
        "counts, zeros and quantisation of the encoders; sensors give exact angles",
        "the drivers' dead band, and the supply except its largest voltage",
    ]
    return lines


def mjcf(rig: Rig, step_s: float = 0.001, stops: bool = True) -> str:
    """Write a rig as MJCF; without `stops`, the joints have no limits."""
    # Controls are the front and the back voltage [V]; sensors and joints are elevation, pitch and travel
    # [rad].
    # Values by the paper's names: masses M, lengths L, and g.
    v = {name: rig[name].value for name in rig}
    arm_z, body_z = -v["L_theta"], -v["L_phi"]

    def mass(name: str, kg: float, x: float, y: float, z: float) -> str:
        """Return a point mass at a place in m, relative to the body that contains it, as XML."""
        # MuJoCo rejects a body without mass.
        return (
            f'<body name="{name}" pos="{x:.9g} {y:.9g} {z:.9g}">'
            f'<inertial pos="0 0 0" mass="{max(kg, 1e-9):.9g}" {_POINT}/>'
            f'<geom size="0.02" mass="0" contype="0" conaffinity="0"/></body>'
        )

    def joint(name: str, axis: str, low_deg: float, high_deg: float) -> str:
        low, high = np.deg2rad([low_deg, high_deg])
        limits_xml = f' limited="true" range="{low:.9g} {high:.9g}"' if stops else ""
        return f'<joint name="{name}" axis="{axis}" damping="{v[f"friction_{name}"]:.9g}"{limits_xml}/>'

    def rotor(side: str) -> str:
        """Return the actuator of a rotor: above the dead zone, thrust increases linearly with the voltage."""
        zero_N = -v["thrust_gain"] * v["dead_zone"]
        # MuJoCo rejects an empty range of forces.
        max_N = v["thrust_gain"] * max(v["supply"] - v["dead_zone"], 1e-6)
        return (
            f'<general name="{side}" site="{side}" gear="0 0 1 0 0 0" gainprm="{v["thrust_gain"]:.9g}" '
            f'biastype="affine" biasprm="{zero_N:.9g} 0 0" '
            f'ctrllimited="true" ctrlrange="0 {v["supply"]:.9g}" '
            f'forcelimited="true" forcerange="0 {max_N:.9g}"/>'
        )

    def torque(axis: str) -> str:
        """Return an actuator for the constant torque about an axis; empty without one."""
        value = v[f"torque_{axis}"]
        if not value:
            return ""
        return (
            f'<general name="torque_{axis}" joint="{axis}" gainprm="0" biastype="affine" '
            f'biasprm="{value:.9g} 0 0"/>'
        )

    massless_inertia = '<inertial pos="0 0 0" mass="1e-9" ' + _POINT + "/>"
    # XML does not permit two hyphens within a comment.
    missing_lines = "".join(f"\n  - {line}" for line in left_out(rig)).replace("--", "- -")
    return f"""<?xml version="1.0" encoding="utf-8"?>
<!-- {_comment_lines(rig.description)}
Written by heli-host rig export. Controls: front and back motor, V. The model leaves out:{missing_lines}
-->
<mujoco model="{escape(rig.name, {'"': "&quot;"})}">
  <compiler angle="radian" balanceinertia="false"/>
  <option timestep="{step_s:.9g}" integrator="RK4" gravity="0 0 {-v["g"]:.9g}"/>
  <worldbody>
    <body name="post" pos="0 0 1">
      {massless_inertia}
      {joint("travel", "0 0 1", -v["travel_max"], v["travel_max"])}
      <body name="arm">
        {massless_inertia}
        {joint("elevation", "0 -1 0", v["elevation_min"], v["elevation_max"])}
        <geom type="capsule" fromto="{-v["L_b"]:.9g} 0 {arm_z:.9g} {v["L_a"]:.9g} 0 {arm_z:.9g}"
          size="0.01" mass="0" contype="0" conaffinity="0"/>
        {mass("long_arm", v["M_l"], v["L_x"], 0.0, arm_z)}
        {mass("counterweight", v["M_w"], -v["L_b"], 0.0, arm_z)}
        <body name="body" pos="{v["L_a"]:.9g} 0 {arm_z:.9g}">
          {massless_inertia}
          {joint("pitch", "-1 0 0", -v["pitch_max"], v["pitch_max"])}
          <geom type="capsule" fromto="0 {-v["L_h"]:.9g} {body_z:.9g} 0 {v["L_h"]:.9g} {body_z:.9g}"
            size="0.01" mass="0" contype="0" conaffinity="0"/>
          {mass("short_arm", v["M_h"], 0.0, 0.0, body_z)}
          {mass("front_rotor", v["M_f"], 0.0, -v["L_h"], body_z)}
          {mass("back_rotor", v["M_b"], 0.0, v["L_h"], body_z)}
          <site name="front" pos="0 {-v["L_h"]:.9g} 0"/>
          <site name="back" pos="0 {v["L_h"]:.9g} 0"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    {_lines([rotor("front"), rotor("back"), *(torque(axis) for axis in ("elevation", "pitch", "travel"))])}
  </actuator>
  <sensor>
    {_lines([f'<jointpos name="{axis}" joint="{axis}"/>' for axis in ("elevation", "pitch", "travel")])}
  </sensor>
</mujoco>
"""


def _comment_lines(text: str) -> str:
    # XML forbids two hyphens in a comment.
    return text.replace("--", "- -")


def _lines(parts: Sequence[str]) -> str:
    return "\n    ".join(part for part in parts if part)
