"""Find the fewest changes of sign after which every axis follows its cause; simulations confirm them."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from heli_host.data.arrays import Floats
from heli_host.data.flight import Flight
from heli_host.data.tables import Column, Table
from heli_sim.model import MultibodyModel
from heli_sim.rig import Rig

from heli_lab.errors import IdentifyError
from heli_lab.fit.problem import Budget, Problem
from heli_lab.fit.records import Record, prepare
from heli_lab.fit.shooting import solve
from heli_lab.setup.guess.motion import (
    Assignment,
    Reference,
    RegressionFit,
    axis_regressions,
    reference_of,
    travel_equation,
)
from heli_lab.setup.guess.names import AXES
from heli_lab.setup.guess.result import DECISIVE_NATS, Ambiguity, KnownEntries, SignChoice
from heli_lab.setup.guess.signals import Signals, column_signals
from heli_lab.setup.guess.units import REST_TOLERANCE_DEG, RestElevation, rest_elevation

_PIECE_S: Final = 2.0
"""Length of the pieces into which a flight is cut [s]; the most strongly excited ones are simulated."""
_TRIAL_WINDOW_S: Final = 1.0
"""Length of the open-loop simulations [s]: long enough for travel to follow pitch, short enough that a wrong
choice does not diverge."""
_EVALUATIONS: Final = 8
"""Number of evaluations of the model with derivatives per choice: enough for trim and gains to converge, and
a wrong sign stays wrong."""
_SIMULATED_S: Final = 20.0
"""Longest time of a flight that is simulated for each choice of signs [s], from the parts in which pitch
moves most. Set by judgement: simulating all of it takes longer and gives the same result."""
_WRONG_SIGN_ERROR_RATIO: Final = 0.5
"""Product of the axes' errors for another choice of signs, over that for the flight's signs, below which
those are wrong. Correcting one sign gives 0.03 to 0.8. The regressions must agree by `DECISIVE_NATS`. A
higher value refuses rigs that are only unusual."""
_OPPOSITE_SHARE: Final = 0.1
"""Share of rigs whose torque has the opposite direction to the rig file's. Set by judgement: cables pull
in either direction, and on measured flights of four rigs, two had the opposite one."""
_SIGN_CHANGE_NATS: Final = 1.0
"""Log-likelihood of each further sign or exchange of motors that differs from the usual ones [nats]. Set by
judgement: one sign in four is turned. Higher values ignore the travel torque, lower ones follow it alone."""
_MIN_DURATION_S: Final = 5.0
"""Shorter flights are not checked [s]: fewer than five independent samples do not decide a sign."""
_COLUMNS: Final = ("elevation_rad", "pitch_rad", "travel_rad", "front_V", "back_V")
_DEGREES_RATIO: Final = (0.4 * 180.0 / math.pi, 2.5 * 180.0 / math.pi)
"""Range of the ratio of measured to modelled acceleration, on elevation and pitch, for angles in degrees."""


@dataclass(frozen=True)
class SignChanges:
    """Changes of sign after which all axes follow the equations of motion."""

    elevation: float  # elevation, pitch, travel: Factor of the column: 1, or -1 if it has the opposite sign
    pitch: float
    travel: float
    motors_swapped: bool
    """Whether the front and back columns are exchanged, or the difference column is back minus front."""

    def text(self, summed: bool, mirrored: bool = False) -> str:
        """Describe the changes in words, or those of their mirror image; `summed` voltages have no motors."""
        changes = []
        if self.motors_swapped != mirrored:
            changes.append(
                "the difference is back less front" if summed else "the motors' names are exchanged"
            )
        inverted = [axis for axis in ("pitch", "travel") if (getattr(self, axis) < 0.0) != mirrored]
        if len(inverted) == 2:
            changes.append("pitch and travel have the opposite sign")
        elif inverted:
            changes.append(f"{inverted[0]} has the opposite sign")
        return ", and ".join(changes) or "front and back as proposed"


def fewest_sign_changes(
    regressions: Mapping[str, RegressionFit], feedback: float, known: KnownEntries
) -> SignChanges:
    """Find the fewest changes of sign after which all axes follow their causes, and which agree with
    `known`.
    """
    elevation = 1.0 if regressions["elevation"].gain >= 0.0 else -1.0
    if feedback and regressions["elevation"].log_likelihood_ratio < DECISIVE_NATS:
        # A loop that flies is stable: the sum is minus a gain times the rate.
        elevation = -float(np.sign(feedback))
    # Measured signs: does pitch accelerate with the voltage difference, and travel with pitch?
    pitch_gain_sign = 1.0 if regressions["pitch"].gain >= 0.0 else -1.0
    travel_gain_sign = 1.0 if regressions["travel"].gain >= 0.0 else -1.0
    # Each sign of pitch can be completed by signs of travel and motors; the two choices are mirror images.
    if known.sign("pitch"):
        pitch = known.sign("pitch")
    elif known.sign("travel"):
        pitch = travel_gain_sign * known.sign("travel")
    elif known.knows_motors:
        pitch = pitch_gain_sign
    elif pitch_gain_sign < 0.0 and travel_gain_sign < 0.0:
        # One change, of pitch, corrects both.
        pitch = -1.0
    else:
        pitch = 1.0
    return SignChanges(
        elevation, pitch, travel=travel_gain_sign * pitch, motors_swapped=pitch_gain_sign * pitch < 0.0
    )


def travel_torque_nats(
    signals: Signals, assignment: Assignment, reference: Reference, rad: Mapping[str, float], sign: float
) -> float:
    """Compare a flight, whose travel has this sign, with its mirror image by the constant acceleration of
    travel [nats].

    A flight in which front and back motor are exchanged, and pitch and travel inverted, obeys the same
    equations. Cables and the rotors' drag exert a constant torque about travel, whose direction a mirror
    image inverts.
    """
    expected_rad_s2, std_rad_s2 = reference.travel_rad_s2
    if not expected_rad_s2:
        return 0.0  # the rig file states no torque whose direction could be compared
    measured_rad_s2 = sign * rad["travel"] * travel_equation(signals, assignment, rad).constant
    # Likelihood ratio of two normal distributions, about plus and minus the expected acceleration.
    ratio = math.exp(np.clip(2.0 * measured_rad_s2 * expected_rad_s2 / std_rad_s2**2, -50.0, 50.0))
    # A share of rigs has a torque in the opposite direction, which bounds the evidence of every flight.
    return math.log(
        ((1.0 - _OPPOSITE_SHARE) * ratio + _OPPOSITE_SHARE)
        / (_OPPOSITE_SHARE * ratio + 1.0 - _OPPOSITE_SHARE)
    )


def prefers_mirror(signs: SignChanges, torque_nats: float) -> bool:
    """Whether the mirror image is more likely than the proposed signs, by the torque of travel and by the
    number of changes that each needs.
    """
    changes = signs.motors_swapped + (signs.pitch < 0.0) + (signs.travel < 0.0)
    # A mirror image changes what the other leaves.
    return torque_nats < -_SIGN_CHANGE_NATS * (3 - 2 * changes)


def sign_ambiguities(
    regressions: Mapping[str, RegressionFit],
    signs: SignChanges,
    assignment: Assignment,
    names_state_motors: bool,
    mirrored: bool,
    torque_text: str = "",
) -> list[Ambiguity]:
    """List ambiguities of the signs: weakly excited axes, and which rotor is the front one."""
    ambiguities = [
        Ambiguity(
            f"{axis}'s sign",
            "as proposed",
            "the opposite",
            f"its cause explains only {regressions[axis].log_likelihood_ratio:.1f} nats of its motion; "
            f"'{assignment.columns[axis]}' may be a setpoint instead of the angle; otherwise log a flight "
            "that excites this axis more",
        )
        for axis in AXES
        if regressions[axis].log_likelihood_ratio < DECISIVE_NATS
    ]
    is_changed = signs.motors_swapped or signs.pitch < 0.0 or signs.travel < 0.0
    # The motion alone does not distinguish a rig from its mirror image; names without changes do.
    if is_changed or not names_state_motors:
        ambiguities.append(
            Ambiguity(
                "which rotor is the front one",
                signs.text(assignment.summed, mirrored),
                signs.text(assignment.summed, not mirrored),
                f"the two are mirror images and move alike{torque_text}; lift the front rotor by hand: if "
                f"pitch does not rise, set mirrored = {str(not mirrored).lower()}",
            )
        )
    return ambiguities


def try_sign_choices(flight: Flight, rig: Rig) -> tuple[SignChoice, ...]:
    """Fit and simulate a flight with each of the eight choices of the three angles' signs.

    Exchanging the motors needs no choice of its own: it equals inverting pitch and travel.
    """
    try:
        record = _most_excited_part(prepare(flight, rig))
    except IdentifyError:
        return ()  # no part of the flight is long enough to simulate
    errors_deg = {}
    for signs in itertools.product((1.0, -1.0), repeat=3):
        angles = record.angles_rad * np.array(signs)
        errors_deg[signs] = _fitted_error_deg(replace(record, angles_rad=angles, label=f"{signs}"), rig)
    unchanged_deg = errors_deg[1.0, 1.0, 1.0]
    choices = []
    for signs, error_deg in errors_deg.items():
        inverted_axes = [axis for axis, sign in zip(AXES, signs, strict=True) if sign < 0.0]
        # Product of the ratios of the three axes; the bound keeps a perfect fit from dividing by 0.
        log_ratios = np.log(np.maximum(error_deg, 1e-6) / np.maximum(unchanged_deg, 1e-6))
        elevation_deg, pitch_deg, travel_deg = (float(error) for error in error_deg)
        choices.append(
            SignChoice(
                " and ".join(inverted_axes),
                (elevation_deg, pitch_deg, travel_deg),
                error_ratio=float(np.exp(np.sum(log_ratios))),
            )
        )
    return tuple(choices)


def _most_excited_part(record: Record) -> Record:
    """Keep the pieces of a record in which elevation and pitch move most, `_SIMULATED_S` in total."""
    rows = max(2, round(_PIECE_S / record.step_s))
    pieces = [
        (first, first + rows)
        for start, stop in record.segments
        for first in range(start, stop - rows + 1, rows)
    ]
    if not pieces:
        return record
    # Standard deviations of elevation and pitch in each piece, shape (pieces, 2).
    motion = np.array([record.angles_rad[first:stop, :2].std(axis=0) for first, stop in pieces])
    relative_motion = (motion / np.maximum(motion.mean(axis=0), 1e-9)).sum(axis=1)
    most_excited_first = np.argsort(-relative_motion)
    max_pieces = max(1, round(_SIMULATED_S / _PIECE_S))
    chosen = sorted(pieces[i] for i in most_excited_first[:max_pieces])
    return replace(record, segments=tuple(chosen))


def _fitted_error_deg(record: Record, rig: Rig) -> Floats:
    """Fit the baseline model to a record, and return the rms error of its open-loop simulations. Returns
    shape (3,).
    """
    problem = Problem(MultibodyModel(), rig, [record], window_s=_TRIAL_WINDOW_S, step_s=0.02)
    try:
        fit = solve(problem, budget=Budget(max_evaluations=_EVALUATIONS), fine=False, scatter=False)
    except IdentifyError:
        return np.full(3, 180.0)
    with np.errstate(all="ignore"):
        residual = problem.residual(0, fit.theta, fit.states[0])
        error_deg = np.degrees(np.sqrt(np.mean(residual**2, axis=0)) * record.sigma_rad)
    finite_error_deg: Floats = np.nan_to_num(error_deg, nan=180.0, posinf=180.0)
    return finite_error_deg


@dataclass(frozen=True)
class WrongSign:
    """One wrong sign, zero or unit of a flight."""

    description: str  # The evidence and its cause, in a few words
    remedy: str  # How to correct the flight
    inverted_axes: tuple[str, ...] = ()  # Axes whose sign has to change; empty for a wrong zero or unit


def wrong_signs(flight: Flight, rig: Rig) -> tuple[WrongSign, ...]:
    """Find wrong signs and zeros of a flight.

    A sign is wrong if an axis clearly accelerates against its cause, and the baseline model of the rig fits
    clearly better with the opposite sign. An unusual rig fulfils neither condition.
    """
    if flight.duration_s < _MIN_DURATION_S:
        return ()  # too little motion for evidence
    try:
        reference = reference_of(rig)
    except IdentifyError:
        return ()  # the rig cannot hover, so nothing can be compared with it
    table = Table("flight", {name: Column(getattr(flight, name)) for name in _COLUMNS})
    signals = column_signals(table, flight.t_s, list(_COLUMNS))
    if any(np.ptp(signals.raw[name]) == 0.0 for name in _COLUMNS):
        return ()  # a constant column has no sign
    assignment = Assignment(dict(zip((*AXES, "front", "back"), _COLUMNS, strict=True)))
    # The sine of an angle in degrees would be meaningless, so the unit is checked first.
    degrees = _angles_in_degrees(axis_regressions(signals, assignment, reference), reference)
    if degrees is not None:
        return (degrees,)
    regressions = axis_regressions(signals, assignment, reference, dict.fromkeys(AXES, 1.0))
    suspects = sign_suspects(regressions)
    if suspects:
        suspects = confirmed_by_simulation(suspects, flight, rig)
    deg_per_unit = dict.fromkeys(AXES, math.degrees(1.0))
    if regressions["elevation"].gain < 0.0:
        deg_per_unit["elevation"] *= -1.0
    rest = rest_elevation(signals, assignment.columns, deg_per_unit)
    wrong_zero = _zeroed_at_rest(rest, reference)
    return (*suspects, wrong_zero) if wrong_zero is not None else tuple(suspects)


def confirmed_by_simulation(suspects: list[WrongSign], flight: Flight, rig: Rig) -> list[WrongSign]:
    """Keep the suspects whose inverted signs let the baseline model fit clearly better.

    If the flight is too short to simulate, all suspects stay.
    """
    error_ratios = {choice.name: choice.error_ratio for choice in try_sign_choices(flight, rig)}
    if not error_ratios:
        return suspects
    return [
        sign for sign in suspects if error_ratios[" and ".join(sign.inverted_axes)] < _WRONG_SIGN_ERROR_RATIO
    ]


def _zeroed_at_rest(rest: RestElevation, reference: Reference) -> WrongSign | None:
    """Report an elevation that was zeroed at rest on the table instead of at level."""
    if rest.deg is None or not rest.begins_lowest:
        return None  # the flight does not begin on the table
    tolerance_deg = REST_TOLERANCE_DEG + reference.rest_tolerance_deg
    is_zero = abs(rest.deg) < tolerance_deg
    # If the table is near level, a rest at 0 is right: the tolerances about both angles must not overlap.
    is_distinct = abs(reference.rest_deg) - tolerance_deg > tolerance_deg
    if not is_zero or not is_distinct:
        return None
    return WrongSign(
        f"elevation is {rest.deg:.1f} deg while the flight rests: it was zeroed there, not at level",
        f"add the rig file's table angle, {reference.rest_deg:g} deg, as offset_deg in a profile for "
        "heli-host import",
    )


def _angles_in_degrees(regressions: dict[str, RegressionFit], reference: Reference) -> WrongSign | None:
    """Report that elevation and pitch are in degrees, if their gains are about 57 times those of the rig."""
    gain_ratios = [abs(regressions[axis].gain / reference.gain[axis]) for axis in ("elevation", "pitch")]
    is_decisive = all(
        regressions[axis].log_likelihood_ratio > DECISIVE_NATS for axis in ("elevation", "pitch")
    )
    if not is_decisive or not all(_DEGREES_RATIO[0] < ratio < _DEGREES_RATIO[1] for ratio in gain_ratios):
        return None
    return WrongSign(
        f"elevation and pitch accelerate {gain_ratios[0]:.0f} and {gain_ratios[1]:.0f} times as fast as the "
        "rig can: they are in degrees",
        "multiply the angles by pi/180",
    )


def sign_suspects(
    regressions: dict[str, RegressionFit], decisive_nats: float = DECISIVE_NATS
) -> list[WrongSign]:
    """Name the fewest changes of sign after which all axes follow their causes."""
    contradicts_cause = {
        axis: regressions[axis].gain < 0.0 and regressions[axis].log_likelihood_ratio > decisive_nats
        for axis in AXES
    }
    suspects = []
    if contradicts_cause["elevation"]:
        suspects.append(
            WrongSign(
                "elevation falls when the voltages rise: it has the opposite sign",
                "invert elevation; it is positive upwards",
                ("elevation",),
            )
        )
    if contradicts_cause["pitch"] and contradicts_cause["travel"]:
        suspects.append(
            WrongSign(
                "pitch falls when the front voltage rises, and travel goes against pitch: pitch has the "
                "opposite sign",
                "invert pitch; it is positive when the front rotor is up",
                ("pitch",),
            )
        )
    elif contradicts_cause["pitch"]:
        suspects.append(
            WrongSign(
                "pitch falls when the front voltage rises: the motors are exchanged",
                "exchange front_V and back_V; if they are right, invert pitch and travel",
                ("pitch", "travel"),
            )
        )
    elif contradicts_cause["travel"]:
        suspects.append(
            WrongSign(
                "travel goes against pitch: travel has the opposite sign",
                "invert travel; positive pitch accelerates it in positive direction",
                ("travel",),
            )
        )
    return suspects
