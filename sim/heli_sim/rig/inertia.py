"""Inertias that follow from a rig's masses, and a check of stated inertias against them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from heli_sim.rig.quantity import Quantity

STATED_INERTIAS: Final[tuple[Quantity, ...]] = (
    Quantity("J_theta", "kg m2", "moment of inertia about the elevation axis, arm level"),
    Quantity("J_phi", "kg m2", "moment of inertia about the pitch axis"),
    Quantity("J_psi", "kg m2", "moment of inertia about the travel axis, arm level"),
)
"""A rig file may state these too. No model uses them: they are compared with the masses and lengths."""


def inertias_kg_m2(values: Mapping[str, float]) -> dict[str, float]:
    """Moments of inertia J_theta, J_phi and J_psi of the point masses at level, elevation and pitch 0."""
    v = values
    rotors_kg, short_arm_kg = v["M_f"] + v["M_b"], v["M_f"] + v["M_b"] + v["M_h"]
    # Squared distances from the axes: across the long arm, along it, and below the axes.
    across_kg_m2 = rotors_kg * v["L_h"] ** 2
    along_kg_m2 = short_arm_kg * v["L_a"] ** 2 + v["M_l"] * v["L_x"] ** 2 + v["M_w"] * v["L_b"] ** 2
    below_kg_m2 = short_arm_kg * (v["L_theta"] + v["L_phi"]) ** 2 + (v["M_l"] + v["M_w"]) * v["L_theta"] ** 2
    return {
        "J_theta": along_kg_m2 + below_kg_m2,
        "J_phi": across_kg_m2 + short_arm_kg * v["L_phi"] ** 2,
        "J_psi": along_kg_m2 + across_kg_m2,
    }


def inertia_range_kg_m2(
    values: Mapping[str, float], tolerances: Mapping[str, float]
) -> dict[str, tuple[float, float]]:
    """Smallest and largest J_theta, J_phi and J_psi of all arrangements within the tolerances. Each inertia
    grows with each mass and each length, so that the extremes are at the ends of the tolerances.
    """
    names = [name for name in values if name.startswith(("M_", "L_"))]
    lowest = inertias_kg_m2({name: max(abs(values[name]) - tolerances[name], 0.0) for name in names})
    highest = inertias_kg_m2({name: abs(values[name]) + tolerances[name] for name in names})
    return {name: (lowest[name], highest[name]) for name in lowest}
