"""What stays open in a guess, and between what: columns, units, signs, zeros, times."""

from __future__ import annotations

from dataclasses import dataclass

from heli_host.tables.units import SHARES
from heli_sim.rig import Rig

from heli_lab.guess import names, thresholds
from heli_lab.guess.motion import Rest
from heli_lab.guess.reference import Reference
from heli_lab.guess.result import Ambiguity
from heli_lab.guess.roles import ColumnAssignment, RegressionFit
from heli_lab.guess.scales import AXES, Motion, Scale


@dataclass(frozen=True)
class Signs:
    """Signs with which everything agrees.

    Parameters
    ----------
    elevation, pitch, travel : float
        1, or -1 where the column counts the other way.
    swapped : bool
        Whether the motors are exchanged, or their difference is back less front.
    """

    elevation: float
    pitch: float
    travel: float
    swapped: bool


def role_doubts(ranked: list[ColumnAssignment]) -> tuple[list[Ambiguity], list[str]]:
    """What is open about the columns, of all assignments, the likeliest first; and what they rest on."""
    best = ranked[0]
    second = next((roles for roles in ranked if not roles.same_as(best)), None)
    by_physics = max(ranked, key=lambda roles: roles.physics)
    doubts = []
    if second is not None and best.nats - second.nats < thresholds.SURE_NATS:
        doubts.append(
            Ambiguity(
                "the columns",
                _told(best),
                _told(second),
                f"they explain the flight within {best.nats - second.nats:.1f} nats of each other",
            )
        )
    elif not by_physics.same_as(best) and by_physics.physics - best.physics > thresholds.SURE_NATS:
        doubts.append(
            Ambiguity(
                "the columns",
                f"{_told(best)}, as their names say",
                _told(by_physics),
                "which is how they move; names and physics disagree",
            )
        )
    margin = best.nats - second.nats if second is not None else best.nats
    return doubts, [f"columns: {_told(best)}; {margin:.0f} nats before anything else"]


def _told(roles: ColumnAssignment) -> str:
    kind = ("sum", "difference") if roles.summed else ("front", "back")
    labels = dict(zip((*AXES, *kind), roles.columns, strict=True))
    return ", ".join(f"{role} is {column}" for role, column in labels.items())


def scale_doubts(possible: list[Scale], motion: Motion, reference: Reference, rig: Rig) -> list[Ambiguity]:
    """What is open about the units, of all choices, the likeliest first."""
    best, doubts = possible[0], []
    second = next(scale for scale in possible if scale.units != best.units)
    if best.nats - second.nats < thresholds.SURE_NATS:
        doubts.append(
            Ambiguity(
                "the units",
                _units(best),
                _units(second),
                f"with {rig.name}'s numbers they differ by {best.nats - second.nats:.1f} nats only; state "
                "the unit in the header or the profile",
            )
        )
    for what, off in best.off.items():
        if abs(off) > thresholds.MOST_OFF_STD:
            doubts.append(
                Ambiguity(
                    f"the scale of {what}",
                    _units(best),
                    f"something that is {'larger' if off < 0 else 'smaller'} by far",
                    f"no unit fits {rig.name} within {abs(off):.1f} standard deviations; give the rig, --rig",
                )
            )
    for axis in AXES:
        stated = motion.stated.get(axis, "")
        if stated and stated != best.angles[axis]:
            doubts.append(
                Ambiguity(
                    f"{axis}'s unit", best.angles[axis], f"{stated}, as the header says", "physics disagrees"
                )
            )
    stated = motion.stated.get("voltage", "")
    if stated and stated != best.voltage:
        doubts.append(
            Ambiguity(
                "the voltages' unit", best.voltage, f"{stated}, as the header says", "physics disagrees"
            )
        )
    if best.biased:
        doubts.append(
            Ambiguity(
                "the sum's bias",
                f"{reference.hover_V:.2f} V, the rig file's hover",
                "another",
                "the sum was logged without it; look it up and set offset_V",
            )
        )
    if best.voltage in SHARES:
        full = f" of {best.full:g}" if best.voltage == "pwm" else ""
        if not stated:
            doubts.append(
                Ambiguity(
                    "the voltages' unit",
                    f"{best.voltage}{full}, a share of {reference.supply_V:g} V",
                    "a share of another supply",
                    "nothing states it; measure the supply and set supply_V",
                )
            )
    return doubts


def _units(scale: Scale) -> str:
    angles = dict.fromkeys(scale.angles.values())
    shown = (
        next(iter(angles))
        if len(angles) == 1
        else ", ".join(f"{axis} in {unit}" for axis, unit in scale.angles.items())
    )
    full = f" of {scale.full:g}" if scale.voltage == "pwm" else ""
    halves = ", sum and difference by halves" if scale.factor != 1.0 else ""
    return f"angles in {shown}, voltages in {scale.voltage}{full}{halves}"


def sign_doubts(
    explained: dict[str, RegressionFit], signs: Signs, roles: ColumnAssignment
) -> list[Ambiguity]:
    """What is open about the signs: axes that answer too little, and which rotor is the front one."""
    doubts = []
    for axis in AXES:
        if explained[axis].nats < thresholds.SURE_NATS:
            doubts.append(
                Ambiguity(
                    f"{axis}'s sign",
                    "as proposed",
                    "the other one",
                    f"its cause explains {explained[axis].nats:.1f} nats of it only; fly it more",
                )
            )
    changed = signs.swapped or signs.pitch < 0.0 or signs.travel < 0.0
    stated = {names.role_of(column) for column in roles.voltages} >= (
        {"difference"} if roles.summed else {"front", "back"}
    )
    motors = "the difference is back less front" if roles.summed else "the motors' names are exchanged"
    if changed or not stated:
        doubt = {
            (False, 1.0, 1.0): "front and back as proposed",
            (False, 1.0, -1.0): "travel counts the other way",
            (False, -1.0, 1.0): "pitch counts the other way",
            (True, 1.0, 1.0): motors,
        }[signs.swapped, signs.pitch, signs.travel]
        two = {
            (False, 1.0, 1.0): f"{motors}, and pitch and travel count the other way",
            (False, 1.0, -1.0): f"{motors}, and pitch counts the other way",
            (False, -1.0, 1.0): f"{motors}, and travel counts the other way",
            (True, 1.0, 1.0): "pitch and travel count the other way",
        }[signs.swapped, signs.pitch, signs.travel]
        doubts.append(
            Ambiguity(
                "which rotor is the front one",
                doubt,
                two,
                "these are mirror images of each other and fly alike: lift the front rotor by hand and look "
                "whether pitch rises; if not, set mirrored = true",
            )
        )
    return doubts


def zero(rest: Rest, reference: Reference) -> tuple[float, list[Ambiguity]]:
    """What to add to the elevation, deg, and whether that is sure."""
    table = reference.rest_deg
    far = thresholds.REST_DEG + reference.rest_tolerance_deg
    if rest.deg is None:
        if abs(rest.usual_deg) < 0.5 * abs(table):
            return 0.0, []
        return 0.0, [
            Ambiguity(
                "the elevation's zero",
                f"0 as it is, with {rest.usual_deg:.0f} deg in flight",
                f"0 at rest, so {table:g} deg to add",
                "the flight never rests; log it from the table on",
            )
        ]
    level, at_rest = abs(rest.deg - table) < far, abs(rest.deg) < far
    if level and rest.lowest and not at_rest:
        return 0.0, []
    if at_rest and rest.lowest and not level:
        return table - rest.deg, []
    return 0.0, [
        Ambiguity(
            "the elevation's zero",
            f"as it is, at rest {rest.deg:.1f} deg",
            f"{table - rest.deg:.1f} deg to add, so that it rests at {table:g} deg",
            "the rig file's table is where neither level nor rest would be 0; measure the angle at rest",
        )
    ]


def lags(explained: dict[str, RegressionFit]) -> tuple[dict[str, float], list[Ambiguity], list[str]]:
    """By how much each column is late, what is open about that, and what to say."""
    late_s = dict.fromkeys((*AXES, "voltages"), 0.0)
    doubts = []
    lag = {axis: explained[axis].lag_s for axis in AXES}
    if abs(lag["travel"]) > thresholds.LATE_S:
        late_s["travel"] = lag["travel"]
        doubts.append(
            Ambiguity(
                "travel's time",
                f"{lag['travel']:.2f} s late, taken out",
                "not late",
                "it follows pitch later than it can; look at how it is logged",
            )
        )
    apart = lag["elevation"] - lag["pitch"]
    if abs(apart) > thresholds.APART_S and explained["elevation"].nats > thresholds.SURE_NATS:
        doubts.append(
            Ambiguity(
                "elevation's time",
                "logged with pitch",
                f"{apart:.2f} s later than pitch",
                "both follow the same rotors; look at how they are logged",
            )
        )
    low, high = thresholds.OWN_LAG_S
    if not low <= lag["pitch"] <= high:
        doubts.append(
            Ambiguity(
                "the voltages' time",
                "logged with the angles",
                f"{'late' if lag['pitch'] < low else 'early'} by about "
                f"{abs(lag['pitch'] - 0.1):.2f} s against them",
                "no rotor answers like that",
            )
        )
    sentence = (
        f"pitch answers {lag['pitch']:.2f} s and elevation {lag['elevation']:.2f} s after the voltages "
        "(rotors, line and log together: a flight cannot tell these apart), travel follows pitch by "
        f"{lag['travel']:.2f} s"
    )
    return late_s, doubts, [sentence]
