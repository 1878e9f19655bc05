"""Torques of a hidden equation along a flight, and how well other torques follow them."""

from __future__ import annotations

import numpy as np
from heli_host.data.arrays import Floats

from heli_benchmark.cases.disturbed_case import DisturbedCase
from heli_benchmark.reference.replay import FINE, GRID_S, ReplayedRig, inertia_kg_m2, steps


def true_torque_Nm(case: DisturbedCase, flight: int, duration_s: float) -> tuple[Floats, Floats]:
    """Return times and torques of the hidden unlisted causes along a flight, shapes (n,) and (n, 3).

    The torque is the difference of MuJoCo with and without them.
    """
    trajectory = case.fly(flight, duration_s)[1]
    rig = case.rig()
    listed, unlisted = len(case.effects), len(case.unlisted)
    # Effects may have a memory, so each rig gets new ones: listed, unlisted, then disturbances.
    others = [*case.hidden(flight)[:listed], *case.hidden(flight)[listed + unlisted :]]
    with_equation, without_equation = (
        replayed.accelerations(trajectory, replayed.forces(trajectory), FINE)
        for replayed in (ReplayedRig(rig, case.hidden(flight)), ReplayedRig(rig, others))
    )
    halves = len(trajectory.time_s) // steps(trajectory)
    middle = slice(halves // 2, steps(trajectory) * halves, halves)
    inertia = inertia_kg_m2(rig, trajectory.angles_rad[middle])
    torque = np.einsum("nij,nj->ni", inertia, with_equation - without_equation)
    return np.asarray(GRID_S * (np.arange(len(torque)) + 0.5), float), np.asarray(torque, float)


def torque_correlation(
    true_s: Floats, true_Nm: Floats, proposed_s: Floats, proposed_Nm: Floats
) -> tuple[int, float]:
    """Correlate proposed torques with the true ones, about the axis on which the true ones vary most.
    Shapes: `true_s, proposed_s` (n,), `true_Nm, proposed_Nm` (n, 3). Returns `axis`, `correlation`.
    """
    overlap = (true_s >= proposed_s[0]) & (true_s <= proposed_s[-1])
    axis = int(np.argmax(true_Nm[overlap].std(axis=0)))
    truth = true_Nm[overlap, axis]
    proposal = np.interp(true_s[overlap], proposed_s, proposed_Nm[:, axis])
    if not truth.std() or not proposal.std():
        return axis, 0.0
    return axis, float(np.corrcoef(truth, proposal)[0, 1])
