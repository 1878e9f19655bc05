"""Find the voltage limits of the motors, for files that log commands before they are limited."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np
from heli_host.data.tables import Profile, Table, flights_of

from heli_lab.setup.guess import thresholds
from heli_lab.setup.guess.regression.acceleration_fit import RegressionFit
from heli_lab.setup.guess.regression.axis_regression import NO_LIMITS
from heli_lab.setup.guess.regression.reference import Reference
from heli_lab.setup.guess.regression.scales import MeasuredMotion, Scale
from heli_lab.setup.guess.result import Ambiguity

_DRIVEN_AXES = ("elevation", "pitch")


def supply_limits(
    scale: Scale, motions: Sequence[MeasuredMotion], reference: Reference
) -> tuple[float, float]:
    """Return the smallest and the largest voltage of a motor, in the unit of the columns.

    The limits are minus and plus the supply if some commands exceed it, otherwise infinite.
    """
    if not any(scale.voltage_scale in motion.limited for motion in motions):
        return NO_LIMITS
    limit = reference.supply_V / scale.volts(reference)
    return -limit, limit


def one_way_nats(
    regress: Callable[[tuple[float, float]], Mapping[str, RegressionFit]], limits: tuple[float, float]
) -> float:
    """Compare motors that do not reverse with motors that do."""
    reversing, one_way = regress(limits), regress((0.0, limits[1]))
    return sum(
        one_way[axis].log_likelihood_ratio - reversing[axis].log_likelihood_ratio for axis in _DRIVEN_AXES
    )


def limited(
    tables: Sequence[Table], profile: Profile, reference: Reference, nats_for_one_way: Callable[[], float]
) -> tuple[Profile, list[Ambiguity]]:
    """Add voltage limits to a profile, so that commands are clipped to what the amplifier gives. Returns
    `limited`, `ambiguities`.
    """
    profile, supply_ambiguities = _clipped_to_supply(tables, profile, reference.supply_V)
    profile, zero_ambiguities = _clipped_to_zero(tables, profile, reference, nats_for_one_way)
    return profile, supply_ambiguities + zero_ambiguities


def _clipped_to_zero(
    tables: Sequence[Table], profile: Profile, reference: Reference, nats_for_one_way: Callable[[], float]
) -> tuple[Profile, list[Ambiguity]]:
    """Clip negative voltages of a profile to 0 V if the rig's motors do not reverse and the motion does not
    contradict it; return the profile, and an ambiguity if the motion may be that of motors that do not
    reverse.
    """
    volts_V = np.concatenate([flight.voltages_V for table in tables for flight in flights_of(table, profile)])
    share_below = float(np.mean(volts_V < (1.0 - thresholds.CLIP_SHARE) * reference.supply_V))
    # Rotors that push down most of the time cannot fly: then signs or zeros are wrong, not the limits.
    if not thresholds.MIN_CLIPPED_SHARE <= share_below <= thresholds.MAX_CLIPPED_SHARE:
        return profile, []
    nats = nats_for_one_way()
    # If the rig file says that motors do not reverse, only clear evidence to the contrary keeps the commands.
    required_nats = thresholds.DECISIVE_NATS if reference.reverses else -thresholds.DECISIVE_NATS
    if nats < required_nats:
        return profile, []
    # A reversed propeller may hardly push although its driver reverses, so the motion alone clips nothing. In
    # a rig file whose reversed rotors do not push, clipped commands fly like the commands themselves.
    is_clipped = not reference.reverses
    top_V = max(reference.supply_V, math.ceil(volts_V.max()))
    values = ("clipped to 0 V", f"as logged, down to {volts_V.min():.1f} V")
    chosen, alternative = values if is_clipped else values[::-1]
    ambiguity = Ambiguity(
        "the voltages' lower limit",
        chosen,
        alternative,
        f"{100.0 * share_below:.1f} % of the rows are below 0 V, and the motion is {abs(nats):.1f} nats "
        f"{'for' if nats >= 0.0 else 'against'} motors that do not push when reversed; if yours cannot "
        f"reverse, set clip_V to [0, {top_V:g}]",
    )
    if is_clipped:
        profile = replace(profile, clip_V=(0.0, top_V))
    return profile, [ambiguity]


def _clipped_to_supply(
    tables: Sequence[Table], profile: Profile, limit_V: float
) -> tuple[Profile, list[Ambiguity]]:
    """Clip the voltages of a profile to the supply, `limit_V`, if a few exceed it; return the profile, and an
    ambiguity if any voltage exceeds the supply.
    """
    sizes_V = [np.abs(flight.voltages_V) for table in tables for flight in flights_of(table, profile)]
    largest_V = max(float(size_V.max()) for size_V in sizes_V)
    share_beyond = float(np.mean(np.concatenate(sizes_V) > thresholds.CLIP_SHARE * limit_V))
    if largest_V < thresholds.CLIP_SHARE * limit_V:
        return profile, []
    if share_beyond > thresholds.MAX_CLIPPED_SHARE:
        return profile, [
            Ambiguity(
                "the voltages' limit",
                f"as logged, up to {largest_V:.1f} V",
                f"clipped to {limit_V:g} V, the rig file's supply",
                f"{100.0 * share_beyond:.0f} % of the rows exceed the supply; set clip_V, or give your rig "
                "with --rig",
            )
        ]
    ambiguity = Ambiguity(
        "the voltages' limit",
        f"clipped to {limit_V:g} V, the rig file's supply",
        f"as logged, up to {largest_V:.1f} V",
        "the amplifier cannot give more than the supply; set clip_V to your limit, or remove it",
    )
    return replace(profile, clip_V=(-limit_V, limit_V)), [ambiguity]
