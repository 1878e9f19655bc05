"""The model, linearised along a filtered trajectory, agrees with the model itself."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from heli_host.data.arrays import Floats
from heli_lab.fit.flight_model import DISTURBANCE_START, RigParameters, filter_record, model_functions
from heli_lab.fit.innovations import InnovationsModel, ModelErrors
from heli_lab.fit.linearised_flight import BLOCK_s, Derivatives, LinearisedFlight
from heli_lab.fit.model_functions import ModelFunctions
from heli_lab.fit.reference_trajectory import ReferenceTrajectory
from heli_lab.state_space import matrix_exponentials
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import parse_effects

from tests.estimation.pendulum import RIG, flight_with_disturbances

pytestmark = pytest.mark.slow


@cache
def trajectory_functions_and_parameters(
    effect: str = "",
) -> tuple[ReferenceTrajectory, ModelFunctions, RigParameters]:
    """Return reference trajectory, functions and free parameters of a model with an effect."""
    model = MultibodyModel(parse_effects([effect] if effect else []))
    parameter_vector = RigParameters(model, RIG, [flight_with_disturbances()])
    return (
        filter_record(flight_with_disturbances()),
        model_functions(model, parameter_vector.quantities),
        parameter_vector,
    )


def changed(effect: str, name: str, by: float) -> LinearisedFlight:
    """Linearise a model along the trajectory, with the parameter `name` changed `by` an amount."""
    reference, functions, parameter_vector = trajectory_functions_and_parameters(effect)
    theta = parameter_vector.start
    theta[parameter_vector.names.index(name)] += by
    return LinearisedFlight(reference, functions, parameter_vector.parameters(theta, 0))


def all_derivatives(linear: LinearisedFlight) -> Derivatives:
    """Return the derivatives in all steps of a flight."""
    return linear.derivatives(slice(0, linear.rows))


@pytest.mark.parametrize(
    ("effect", "name", "step"),
    [
        ("", "thrust_gain", 1e-3),
        ("", "dead_zone", 1e-3),
        ("", "friction_travel", 1e-3),
        ("", "torque_pitch", 1e-4),
        ("rotor_lag=0.08", "rotor_lag_s", 1e-3),
        ("input_delay=0.02", "input_delay_s", 2e-4),
    ],
)
def test_derivatives_are_finite_differences_of_the_rates(effect: str, name: str, step: float) -> None:
    parameter_names = trajectory_functions_and_parameters(effect)[2].names
    linear, more, less = (changed(effect, name, sign * step) for sign in (0.0, 1.0, -1.0))
    expected = (all_derivatives(more).rates - all_derivatives(less).rates)[:, 3:6, 0] / (2.0 * step)
    by_parameter = -all_derivatives(linear).rates[:, :, 1 + parameter_names.index(name)]
    if linear.model.source.states[6:]:
        # The parameter of a lag changes the rates through the state of the lag: compare that state.
        expected_state = (more.trajectory.state - less.trajectory.state)[:, 6:] / (2.0 * step)
        sensitivity = np.zeros((linear.rows, len(linear.model.source.states)))
        drive = np.einsum("nij,nj->ni", linear.steps.Gamma, by_parameter)
        for k in range(linear.rows - 1):
            sensitivity[k + 1, 6:] = linear.steps.Phi[k, 6:, 6:] @ sensitivity[k, 6:] + drive[k, 6:]
        middle = 0.5 * (sensitivity[:-1] + sensitivity[1:])[:, 6:]
        settled = slice(200, -1)  # the initial states of the two flights differ
        error = middle[settled] - expected_state[:-1][settled]
        assert np.sqrt(np.mean(error**2)) < 0.05 * np.sqrt(np.mean(expected_state[settled] ** 2))
        return
    # Steps in which a motor stands are left out: at the dead zone, thrust has a derivative on one side only.
    dead_zone_V = linear.trajectory.parameters[linear.functions.names.index("dead_zone")]
    turns = np.all(linear.trajectory.inputs > dead_zone_V, axis=1)
    assert turns.mean() > 0.9
    error, expected = (by_parameter[:, 3:6] - expected)[turns], expected[turns]
    assert np.sqrt(np.mean(error**2)) < 0.02 * np.sqrt(np.mean(expected**2))


def test_right_model_has_smaller_defects_along_the_trajectory() -> None:
    # A defect is the difference between the model's rate and the motion of the trajectory. The flight was
    # simulated with a thrust gain of 0.62.
    linear = changed("", "thrust_gain", 0.62 - RIG["thrust_gain"].value)
    wrong = changed("", "thrust_gain", 0.0)
    assert np.mean(all_derivatives(linear).rates[:, 3, 0] ** 2) < np.mean(
        all_derivatives(wrong).rates[:, 3, 0] ** 2
    )


def test_filtered_states_do_not_depend_on_later_measurements() -> None:
    record = flight_with_disturbances()
    cut = len(record.t_s) // 2
    reference = filter_record(record)
    half = filter_record(
        replace(
            record,
            t_s=record.t_s[:cut],
            angles_rad=record.angles_rad[:cut],
            voltages_V=record.voltages_V[:cut],
            segments=((record.segments[0][0], cut),),
        )
    )
    compared = slice(0, len(half.filtered) - 2)
    assert np.allclose(half.filtered[compared], reference.filtered[compared], atol=1e-6)


def test_axis_is_at_rest_while_its_count_stays_the_same_for_long() -> None:
    record = flight_with_disturbances()
    rows = len(record.t_s)
    time_s = np.arange(rows) * record.step_s
    # Angles in counts. Elevation turns by three counts within the time that makes a rest, so it never rests.
    # Pitch rests in 1.5 s of every 2 s. Travel never moves.
    turning = 3.0 * time_s / 0.3
    pausing = np.where(time_s % 2.0 < 1.5, 0.0, turning)
    angles = np.stack((turning, pausing, np.zeros(rows)), axis=1)
    reference = filter_record(replace(record, angles_rad=np.floor(angles) * record.count_rad))
    assert not reference.at_rest[:, 0].any()
    assert 0.6 < reference.at_rest[:, 1].mean() < 0.75
    assert reference.at_rest[40:-40, 2].all()
    # The rate of an axis at rest is zero, also after the states are filtered again.
    for states in (reference.predicted, reference.filtered):
        assert not states[:, 3:][reference.at_rest].any()
        assert states[:, 3].any()
    refiltered = reference.refiltered(reference.predicted + 0.1, reference.filtered + 0.1)
    assert not refiltered.predicted[:, 3:][refiltered.at_rest].any()


@pytest.mark.parametrize("play_counts", [6.0, 12.0])
def test_directions_are_the_positions_of_an_axis_within_its_play(play_counts: float) -> None:
    record = flight_with_disturbances()
    time_s, half = np.arange(len(record.t_s)) * record.step_s, 0.5 * play_counts
    # The axis swings; the shaft of the encoder follows it with play. Both in counts.
    axis = 40.0 * np.sin(2.0 * np.pi * time_s / 4.0) + 9.0 * np.sin(2.0 * np.pi * time_s / 1.7)
    shaft = np.zeros(len(axis))
    for k in range(1, len(axis)):
        shaft[k] = np.clip(shaft[k - 1], axis[k] - half, axis[k] + half)
    angles = np.stack((np.round(shaft), np.zeros(len(axis)), np.zeros(len(axis))), axis=1)
    reference = filter_record(replace(record, angles_rad=angles * record.count_rad))
    rows = np.arange(len(reference.directions)) * reference.every
    position = ((axis - shaft) / half)[rows]  # within the play, -1 to 1
    # If positions were interpolated linearly from one side to the other, the error would be 0.25.
    assert np.sqrt(np.mean((reference.directions[:, 0] - position)[20:] ** 2)) < 0.15
    assert not reference.directions[:, 1:].any()
    # An axis that never moves may be anywhere in its play: the variance of a uniform distribution.
    assert np.allclose(reference.direction_variance[:, 1:], 1.0 / 3.0)
    inside = reference.direction_variance[:, 0] > 0.0
    assert 0.1 < inside.mean() < 0.6
    errors = (reference.directions[:, 0] - position)[inside]
    assert np.mean(errors**2) < np.mean(reference.direction_variance[inside, 0])


def test_measurements_within_one_crossing_of_a_play_count_as_one() -> None:
    effect = "backlash.pitch=0.01"
    linear = changed(effect, "backlash_pitch_rad", 0.0)
    half_rad = (
        0.5
        * linear.trajectory.parameters[
            trajectory_functions_and_parameters(effect)[1].names.index("backlash_pitch_rad")
        ]
    )
    reference = linear.reference
    for blocks, window in zip(linear.blocks, linear.windows, strict=True):
        rows = blocks.rows + reference.windows[0].start - window.start
        added = blocks.variance - reference.variance[rows]
        assert not added[:, [0, 2]].any()
        at_a_side = np.abs(reference.directions[rows, 1]) > 1.0 - 1e-9
        assert not added[at_a_side, 1].any()
        measurements = np.maximum(reference.pause_s[rows, 1] / BLOCK_s, 1.0)
        expected = half_rad**2 * reference.direction_variance[rows, 1] * measurements
        assert np.allclose(added[:, 1], expected, rtol=1e-9, atol=0.0)
        assert added[:, 1].any()


def _log_likelihood_loss_by_noise(linear: LinearisedFlight, filtered: InnovationsModel) -> Floats:
    """Return the loss of each axis' log-likelihood, shape (3,), if encoder noise has e times the variance."""
    # This counts independent encoder errors. The measurements are zero, and the noise is so large that it
    # alone determines the likelihood. Each independent error then loses log(e) / 2, which is half a nat.
    no_measurements = [
        ModelErrors(np.zeros_like(blocks.drive[:, :, :1]), np.zeros_like(blocks.measured[:, :, :1]))
        for blocks in linear.blocks
    ]
    noisy = [replace(DISTURBANCE_START, quantisation=np.full(3, size)) for size in (1e9, np.e * 1e9)]
    less_noise, more_noise = filtered.log_likelihoods(noisy, [no_measurements])
    difference: Floats = less_noise - more_noise
    return difference


def test_crossing_of_a_play_counts_as_one_encoder_error() -> None:
    effect = "backlash.pitch=0.01"
    linear = changed(effect, "backlash_pitch_rad", 0.0)
    filtered = InnovationsModel(
        [linear],
        trajectory_functions_and_parameters(effect)[2].columns,
        len(trajectory_functions_and_parameters(effect)[2].names),
    )
    differences = _log_likelihood_loss_by_noise(linear, filtered)
    measurements = np.zeros(3)
    for blocks in linear.blocks:
        crosses = blocks.variance > linear.variance[blocks.rows] * (1.0 + 1e-9)
        measurements += np.where(crosses, 1.0 / linear.repeats[blocks.rows], 1.0).sum(axis=0)
    assert measurements[1] < 0.95 * measurements[0]
    assert np.allclose(differences, 0.5 * measurements, rtol=5e-3)


def test_rest_of_an_axis_counts_as_one_encoder_error() -> None:
    reference, functions, parameter_vector = trajectory_functions_and_parameters()
    rest = slice(reference.windows[0].start + 200, reference.windows[0].start + 300)
    at_rest, pause_s = reference.at_rest.copy(), reference.pause_s.copy()
    at_rest[rest, 2], pause_s[rest, 2] = True, 100 * reference.step_s
    linear = LinearisedFlight(
        replace(reference, at_rest=at_rest, pause_s=pause_s),
        functions,
        parameter_vector.parameters(parameter_vector.start, 0),
    )
    filtered = InnovationsModel([linear], parameter_vector.columns, len(parameter_vector.names))
    differences = _log_likelihood_loss_by_noise(linear, filtered)
    block_count = sum(len(blocks.rows) for blocks in linear.blocks)
    rest_blocks = 100 // linear.block
    measurements = np.array([block_count, block_count, block_count - rest_blocks + 1.0])
    assert rest_blocks > 20
    assert np.allclose(differences, 0.5 * measurements, rtol=5e-3)


def test_equivalent_torque_is_zero_about_an_axis_that_friction_holds() -> None:
    linear = changed("", "thrust_gain", 0.0)
    accelerations = np.random.default_rng(3).normal(size=(linear.rows, 3))
    torque_Nm = linear.disturbance_for(accelerations)
    caused = np.einsum("nij,nj->ni", linear.steps.by_disturbance[:, 3:6], torque_Nm)
    assert np.abs(caused - accelerations).max() < 1e-9
    # In step 100, friction holds travel: no torque moves it.
    by_disturbance = linear.steps.by_disturbance
    by_disturbance[100, 5] = by_disturbance[100, :, 2] = 0.0
    torque_Nm = linear.disturbance_for(accelerations)
    assert torque_Nm[100, 2] == 0.0
    caused_in_step = by_disturbance[100, 3:6] @ torque_Nm[100]
    assert np.abs(caused_in_step - accelerations[100])[:2].max() < 1e-9


@pytest.mark.parametrize("angle", [0.0, 1e-9, 0.25, 2.0, 40.0])
def test_the_exponential_of_a_skew_matrix_is_a_rotation(angle: float) -> None:
    rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    exponentials = matrix_exponentials(angle * np.array([[[0.0, -1.0], [1.0, 0.0]]] * 2))
    assert exponentials == pytest.approx(np.array([rotation, rotation]), abs=1e-10)
