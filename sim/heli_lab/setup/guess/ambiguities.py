"""List the ambiguities of a guess: columns, units and signs that the file does not decide."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from heli_host.data.tables.table import SHARES
from heli_sim.rig import Rig

from heli_lab.setup.guess import names, thresholds
from heli_lab.setup.guess.regression.acceleration_fit import RegressionFit
from heli_lab.setup.guess.regression.assignment import ColumnAssignment
from heli_lab.setup.guess.regression.reference import Reference
from heli_lab.setup.guess.regression.scales import AXES, MeasuredMotion, Scale
from heli_lab.setup.guess.result import Ambiguity

_MAX_ALTERNATIVES: Final = 4
"""Largest number of other units that an ambiguity lists."""


@dataclass(frozen=True)
class SignChanges:
    """Changes of sign after which all axes follow the equations of motion."""

    elevation: float  # elevation, pitch, travel: Factor of the column: 1, or -1 if it has the opposite sign
    pitch: float
    travel: float
    motors_swapped: bool
    """Whether the front and back columns are exchanged, or the difference column is back minus front."""


def assignment_ambiguities(ranked: list[ColumnAssignment]) -> tuple[list[Ambiguity], list[str]]:
    """Report other assignments of the columns that are nearly as likely, or that fit the motion better.
    Returns `ambiguities`, `evidence`.
    """
    best = ranked[0]
    others = [assignment for assignment in ranked if not assignment.same_as(best)]
    margin = best.log_likelihood - (others[0].log_likelihood if others else 0.0)
    nearly_as_likely = [
        other for other in others if best.log_likelihood - other.log_likelihood < thresholds.DECISIVE_NATS
    ]
    by_physics = max(ranked, key=lambda assignment: assignment.physics_log_likelihood)
    ambiguities = []
    if nearly_as_likely:
        ambiguities.append(
            Ambiguity(
                "the columns",
                _assignment_text(best),
                _differences_text(best, nearly_as_likely),
                f"they explain the flight within {margin:.1f} nats of each other",
            )
        )
    elif (
        not by_physics.same_as(best)
        and by_physics.physics_log_likelihood - best.physics_log_likelihood > thresholds.DECISIVE_NATS
    ):
        ambiguities.append(
            Ambiguity(
                "the columns",
                f"{_assignment_text(best)}, as their names say",
                _assignment_text(by_physics),
                "which fits the motion; names and physics disagree",
            )
        )
    return ambiguities, [f"columns: {_assignment_text(best)}; {margin:.0f} nats ahead of every alternative"]


def _differences_text(best: ColumnAssignment, others: list[ColumnAssignment]) -> str:
    """Describe the columns of other assignments that differ from the best one, by role."""
    chosen = _column_by_role(best)
    differing: dict[str, list[str]] = {}
    for other in others:
        for role, column in _column_by_role(other).items():
            if column != chosen.get(role) and column not in differing.setdefault(role, []):
                differing[role].append(column)
    return ", or ".join(f"{role} is {' or '.join(columns)}" for role, columns in differing.items() if columns)


def _column_by_role(assignment: ColumnAssignment) -> dict[str, str]:
    """Return the column of each role: the angles, and the voltages or their sum and difference."""
    kind = ("sum", "difference") if assignment.summed else ("front", "back")
    return dict(zip((*AXES, *kind), assignment.columns, strict=True))


def voltage_ambiguities(
    regressions: dict[str, RegressionFit],
    assignment: ColumnAssignment,
    columns: list[str],
    dropped: dict[str, str],
) -> list[Ambiguity]:
    """List the ambiguity of the voltages' columns, if their sum hardly explains elevation."""
    nats = regressions["elevation"].log_likelihood_ratio
    if nats >= thresholds.DECISIVE_NATS:
        return []
    others = [name for name in columns if name not in assignment.columns]
    others += [f"{name} ({reason})" for name, reason in dropped.items() if reason != "constant"]
    if not others:
        return []
    return [
        Ambiguity(
            "the sum's column" if assignment.summed else "the voltages' columns",
            assignment.voltages[0] if assignment.summed else " and ".join(assignment.voltages),
            " or ".join(others),
            f"elevation agrees with the sum by only {nats:.1f} nats; under state feedback, the sum is "
            "proportional to minus the rate of elevation; look up which column was logged",
        )
    ]


def _assignment_text(assignment: ColumnAssignment) -> str:
    """Name the column of each role, for a message."""
    return ", ".join(f"{role} is {column}" for role, column in _column_by_role(assignment).items())


def unit_ambiguities(
    possible: list[Scale], motion: MeasuredMotion, reference: Reference, rig: Rig
) -> list[Ambiguity]:
    """List ambiguities of the units."""
    best = possible[0]
    return [
        *_equally_likely_units(possible, motion, reference, rig),
        *_implausible_scales(best, rig),
        *_contradicted_headers(best, motion),
        *_supply_ambiguities(possible, motion, reference),
    ]


def _equally_likely_units(
    possible: list[Scale], motion: MeasuredMotion, reference: Reference, rig: Rig
) -> list[Ambiguity]:
    """Report the other units that are nearly as likely as the best ones, in one ambiguity."""
    best = possible[0]
    # Some choices have the same units, and differ only in whether the bias is removed: keep the most likely
    # one.
    others: dict[tuple[str, ...], Scale] = {}
    for scale in possible:
        if scale.units != best.units:
            others.setdefault(scale.units, scale)
    nearly_as_likely = [
        scale
        for scale in others.values()
        if best.log_likelihood - scale.log_likelihood < thresholds.DECISIVE_NATS
    ]
    if not nearly_as_likely:
        return []
    return [
        Ambiguity(
            "the units",
            _units_text(best),
            ", or ".join(
                f"{_units_text(scale)}{_clipping_text(scale, motion, reference)}"
                for scale in nearly_as_likely[:_MAX_ALTERNATIVES]
            ),
            f"for rig {rig.name} they differ by only "
            f"{best.log_likelihood - nearly_as_likely[0].log_likelihood:.1f} nats; state the unit in the "
            "header or the profile",
        )
    ]


def _implausible_scales(best: Scale, rig: Rig) -> list[Ambiguity]:
    """Report each quantity that differs much from the rig file even in the best unit."""
    return [
        Ambiguity(
            f"the scale of {quantity}",
            _units_text(best),
            f"a much {'larger' if deviation_std < 0 else 'smaller'} unit",
            f"even the best unit is {abs(deviation_std):.1f} standard deviations from rig "
            f"{rig.name}; give your rig with --rig",
        )
        for quantity, deviation_std in best.deviation_std.items()
        if abs(deviation_std) > thresholds.MAX_DEVIATION_STD
    ]


def _contradicted_headers(best: Scale, motion: MeasuredMotion) -> list[Ambiguity]:
    """Report each chosen unit that contradicts the header of the file."""
    chosen_units = (
        *((axis, f"{axis}'s unit", best.angles[axis]) for axis in AXES),
        ("voltage", "the voltages' unit", best.voltage),
    )
    return [
        Ambiguity(
            subject,
            unit,
            f"{motion.stated_units[name]}, as the header says",
            "the motion fits another unit than the header",
        )
        for name, subject, unit in chosen_units
        if motion.stated_units.get(name, "") not in ("", unit)
    ]


def _supply_ambiguities(
    possible: list[Scale], motion: MeasuredMotion, reference: Reference
) -> list[Ambiguity]:
    """Report an unknown bias of the voltages, and an unknown supply."""
    best, ambiguities = possible[0], []
    if best.bias_removed:
        ambiguities.append(
            Ambiguity(
                "the sum's bias",
                f"{reference.hover_V:.2f} V, the rig file's hover voltage",
                "another value",
                "the sum was logged without its bias; look up the bias and set offset_V",
            )
        )
    if best.voltage in SHARES and not motion.stated_units.get("voltage"):
        ambiguities.append(
            Ambiguity(
                "the voltages' unit",
                f"{best.voltage}{_full_scale_text(best)}, a share of {reference.supply_V:g} V",
                f"a share of another supply{_volts_of_another_gain(possible)}",
                "the file does not state it; measure the supply and set supply_V",
            )
        )
    return ambiguities


def _full_scale_text(scale: Scale) -> str:
    """Words for the value of full supply, if the voltages are in ``pwm``; otherwise empty."""
    return f" of {scale.full_scale:g}" if scale.voltage == "pwm" else ""


def _volts_of_another_gain(possible: list[Scale]) -> str:
    """Words for volts as another unit, if they are not much less likely than a share of the supply; otherwise
    empty.
    """
    in_volts = [scale.log_likelihood for scale in possible if scale.voltage == "V"]
    lead_nats = possible[0].log_likelihood - max(in_volts, default=-math.inf)
    return ", or V" if lead_nats < 2.0 * thresholds.DECISIVE_NATS else ""


def _clipping_text(scale: Scale, motion: MeasuredMotion, reference: Reference) -> str:
    """Words for the limit of the voltages, if some commands exceed the supply in the units of a `scale`;
    otherwise empty.
    """
    return f", clipped to {reference.supply_V:g} V" if scale.voltage_scale in motion.limited else ""


def _units_text(scale: Scale) -> str:
    """Describe the units of a `scale`, for a message; angles in the same unit are named together."""
    if len(set(scale.angles.values())) == 1:
        angle_units = scale.angles[AXES[0]]
    else:
        angle_units = ", ".join(f"{axis} in {unit}" for axis, unit in scale.angles.items())
    halves = ", sum and difference by halves" if scale.factor != 1.0 else ""
    return f"angles in {angle_units}, voltages in {scale.voltage}{_full_scale_text(scale)}{halves}"


def sign_ambiguities(
    regressions: dict[str, RegressionFit],
    signs: SignChanges,
    assignment: ColumnAssignment,
    torque_nats: float,
    mirrored: bool,
    rig: Rig,
) -> list[Ambiguity]:
    """List ambiguities of the signs: weakly excited axes, and which rotor is the front one."""
    ambiguities = []
    for axis in AXES:
        nats = regressions[axis].log_likelihood_ratio
        if nats < thresholds.DECISIVE_NATS:
            ambiguities.append(
                Ambiguity(
                    f"{axis}'s sign",
                    "as proposed",
                    "the opposite",
                    f"its cause explains only {nats:.1f} nats of its motion; "
                    "log a flight that excites this axis more",
                )
            )
    is_changed = signs.motors_swapped or signs.pitch < 0.0 or signs.travel < 0.0
    named_roles = {names.role_of(column) for column in assignment.voltages}
    names_state_motors = named_roles >= ({"difference"} if assignment.summed else {"front", "back"})
    motors_text = (
        "the difference is back less front" if assignment.summed else "the motors' names are exchanged"
    )
    # The motion alone does not distinguish a rig from its mirror image; names without changes do.
    if is_changed or not names_state_motors:
        unmirrored = _sign_changes_text(
            signs.motors_swapped, signs.pitch < 0.0, signs.travel < 0.0, motors_text
        )
        mirror_image = _sign_changes_text(
            not signs.motors_swapped, signs.pitch > 0.0, signs.travel > 0.0, motors_text
        )
        for_choice_nats = -torque_nats if mirrored else torque_nats
        torque_text = (
            f"; the constant travel torque of rig {rig.name} is {abs(for_choice_nats):.1f} nats "
            f"{'for' if for_choice_nats >= 0.0 else 'against'} the choice"
            if torque_nats
            else ""
        )
        ambiguities.append(
            Ambiguity(
                "which rotor is the front one",
                mirror_image if mirrored else unmirrored,
                unmirrored if mirrored else mirror_image,
                f"the two are mirror images and move alike{torque_text}; lift the front rotor by hand: if "
                f"pitch does not rise, set mirrored = {str(not mirrored).lower()}",
            )
        )
    return ambiguities


def _sign_changes_text(
    motors_swapped: bool, pitch_inverted: bool, travel_inverted: bool, motors_text: str
) -> str:
    """Describe changes of sign in words; `motors_text` describes that of the motors."""
    changes = []
    if motors_swapped:
        changes.append(motors_text)
    if pitch_inverted and travel_inverted:
        changes.append("pitch and travel have the opposite sign")
    elif pitch_inverted or travel_inverted:
        changes.append(f"{'pitch' if pitch_inverted else 'travel'} has the opposite sign")
    return ", and ".join(changes) or "front and back as proposed"
