"""Records for fitting, and free runs: cuts, initial states, and derivatives."""

import ctypes
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import casadi as ca
import heli_sim.evaluate.compiled
import numpy as np
import pytest
from heli_host.data.arrays import Floats
from heli_host.data.flight import REQUIRED_COLUMNS, Flight
from heli_host.data.log.table import write_csv
from heli_lab.code_digest import package_digest
from heli_lab.fit.free_run import (
    LOOP,
    CompiledKernel,
    Functions,
    Inputs,
    InterpretedKernel,
    VoltageDerivative,
    kernel,
)
from heli_lab.fit.identification import Identification
from heli_lab.fit.problem import FLIGHT_CONSTANTS, Fit, Problem, flight_constants, states_at
from heli_lab.fit.records import Record, prepare
from heli_sim.errors import PlantError
from heli_sim.evaluate import lanes
from heli_sim.evaluate.lanes import c_function
from heli_sim.model import Model, MultibodyModel, PaperModel
from heli_sim.model.effects import catalogue
from heli_sim.rig import Rig, load_rig

from tests.cli.terminal import Terminal, refusal

pytestmark = pytest.mark.medium

COUNT_RAD = 2 * np.pi / 4096
STEP_S = 0.002
ROWS = 10_000


def leaning(elevation_deg: float, pitch_deg: float) -> Flight:
    """Make twenty seconds near level, in which the arm leans by these angles for about a second at 10 s."""
    t_s = np.linspace(0.0, STEP_S * (ROWS - 1), ROWS)
    bump = np.exp(-(((t_s - 10.0) / 0.5) ** 2))
    wave = 0.02 * np.sin(2 * np.pi * t_s / 3.0)
    angles = (math.radians(elevation_deg) * bump + wave, math.radians(pitch_deg) * bump + wave, 5.0 * wave)
    elevation, pitch, travel = (
        (COUNT_RAD * np.round(angle / COUNT_RAD)).astype(np.float64) for angle in angles
    )
    return Flight(t_s, 3.5 + wave, 3.5 - wave, elevation, pitch, travel)


@pytest.mark.parametrize(
    ("elevation_deg", "pitch_deg", "touches"),
    [(-14.0, -55.0, True), (-14.0, 55.0, True), (-14.0, 0.0, False), (0.0, -55.0, False)],
)
def test_an_arm_that_leans_far_reaches_the_table_with_its_lower_rotor(
    elevation_deg: float, pitch_deg: float, touches: bool
) -> None:
    record = prepare(leaning(elevation_deg, pitch_deg), load_rig("quanser-course"))
    cuts = [cut for cut in record.cuts if "table" in cut.why]
    assert bool(cuts) == touches
    assert all(cut.start_s < 10.0 < cut.stop_s for cut in cuts)


def test_thrust_at_the_beginning_of_a_segment_follows_the_voltages_before_it() -> None:
    rig, lag_s = load_rig("quanser-course"), 0.1
    level = leaning(0.0, 0.0)
    # The voltage steps up shortly before the segment begins, so the thrust has not reached its final value.
    first_row, step_before_s = round(5.0 / STEP_S), 0.05
    low_V, high_V = 3.0, 4.0
    volts = np.where(np.arange(ROWS) < first_row - round(step_before_s / STEP_S), low_V, high_V)
    flight = Flight(level.t_s, volts, volts + 0.1 * np.sin(level.t_s), *level.angles_rad.T)
    record = prepare(flight, rig, start_s=float(level.t_s[first_row]))
    model = MultibodyModel((catalogue()["rotor_lag"].make({"rotor_lag_s": lag_s}),))
    problem = Problem(model, rig, [record])
    front_N = states_at(problem, 0, np.array([record.segments[0][0]]), problem.parameter_vector.start)[0, 6]
    gain, zero_V = rig["thrust_gain"].value, rig["dead_zone"].value
    reached_V = high_V - (high_V - low_V) * math.exp(-step_before_s / lag_s)
    assert front_N == pytest.approx(gain * (reached_V - zero_V), rel=1e-3)


def landing(final_V: float, final_deg: float) -> Flight:
    """Make twenty seconds at level, then a descent of two seconds, whose end the log does not contain."""
    # `final_V`: Sum of both voltages during the descent; 3.4 V carries the arm.
    # `final_deg`: Elevation at the end of the log.
    t_s = np.arange(0.0, 22.0, 0.01)
    descended = np.clip(t_s - 20.0, 0.0, None) / 2.0  # share of the descent, 0 to 1
    wave = 0.02 * np.sin(3.0 * t_s)
    total_V = 3.4 + wave + descended.clip(0.0, 0.05) / 0.05 * (final_V - 3.4)
    elevation_rad = COUNT_RAD * np.round((wave + np.radians(final_deg) * descended) / COUNT_RAD)
    travel_rad = COUNT_RAD * np.round(t_s * 65)
    return Flight(t_s, total_V / 2, total_V / 2, elevation_rad, 0 * t_s, travel_rad)


@pytest.mark.parametrize(
    ("final_V", "final_deg", "is_cut"), [(0.5, -14.0, True), (3.2, -14.0, False), (0.5, -2.0, False)]
)
def test_landing_that_the_log_does_not_show_to_its_end_is_cut(
    final_V: float, final_deg: float, is_cut: bool
) -> None:
    record = prepare(landing(final_V, final_deg), load_rig("makki2024"))
    assert bool(record.cuts) == is_cut
    if is_cut:
        assert record.cuts[-1].start_s == pytest.approx(20.1, abs=0.25)
        assert record.cuts[-1].stop_s == pytest.approx(22.0, abs=0.02)


# Exit codes: the request is wrong, or the file is.
REQUEST_ERROR, FILE_ERROR = 2, 5
BAD_FLIGHTS_ROWS = 5000


def flight() -> Flight:
    """Make ten seconds of sines on every axis, in whole encoder counts."""
    t_s = np.linspace(0.0, STEP_S * (BAD_FLIGHTS_ROWS - 1), BAD_FLIGHTS_ROWS)
    wave = np.sin(2 * np.pi * t_s / 3.0)
    volts = 1.7 + 0.2 * wave
    counts = np.round(np.outer((0.1, 0.2, 0.5), wave) / COUNT_RAD)
    elevation, pitch, travel = COUNT_RAD * counts.astype(np.float64)
    return Flight(t_s, volts, volts[::-1].copy(), elevation, pitch, travel)


Spoil = Callable[[Flight], Flight]


def with_cell(name: str, row: int, value: float) -> Spoil:
    """Replace a single value of the column `name`."""

    def spoil(made: Flight) -> Flight:
        column = getattr(made, name).copy()
        column[row] = value
        return replace(made, **{name: column})

    return spoil


def scaled(factor: float, *names: str) -> Spoil:
    """Multiply columns by a factor, as with another unit."""
    return lambda made: replace(made, **{name: factor * getattr(made, name) for name in names})


def without_rows(first: int, stop: int) -> Spoil:
    """Remove rows."""

    def spoil(made: Flight) -> Flight:
        keep = np.r_[0:first, stop:BAD_FLIGHTS_ROWS]
        return Flight(*(getattr(made, name)[keep] for name in REQUIRED_COLUMNS))

    return spoil


def with_smooth_pitch(made: Flight) -> Flight:
    """Replace pitch by 3 degrees at 2 Hz without encoder counts, in degrees, as some simulations log it."""
    return replace(made, pitch_rad=3.0 * np.sin(2 * np.pi * 2.0 * made.t_s))


def wrapped(made: Flight) -> Flight:
    """Let travel jump from +pi to -pi rad."""
    turned = 3.0 + made.travel_rad
    return replace(made, travel_rad=(turned + np.pi) % (2 * np.pi) - np.pi)


def with_uneven_clock(made: Flight) -> Flight:
    """Let the clock run fast and slow by turns."""
    clock_s = made.t_s + 0.1 * np.sin(2 * np.pi * made.t_s / 8.0)
    return replace(made, t_s=clock_s)


# By fault: how to spoil a flight, and exit code, column, row and words of the error.
SPOILED: dict[str, tuple[Spoil, int, str, str, str]] = {
    "no voltages": (
        scaled(0.0, "front_V"),
        REQUEST_ERROR,
        "front_V",
        "data row 1 to 5000",
        "log the voltages",
    ),
    "constant voltages": (
        lambda made: replace(made, front_V=np.full(BAD_FLIGHTS_ROWS, 1.7)),
        REQUEST_ERROR,
        "front_V",
        "data row 1 to 5000",
        "voltages that change",
    ),
    "equal voltages": (
        lambda made: replace(made, back_V=made.front_V),
        REQUEST_ERROR,
        "front_V equals back_V",
        "data row 1 to 5000",
        "voltage of each motor",
    ),
    "duties": (scaled(0.1, "front_V", "back_V"), REQUEST_ERROR, "front_V", "data row 375", "is a duty cycle"),
    "a gap": (without_rows(1000, 1200), FILE_ERROR, "t_s", "line 1002", "jumps by"),
    "not a number": (with_cell("pitch_rad", 1233, np.nan), FILE_ERROR, "pitch_rad", "line 1235", "is nan"),
    "degrees": (
        scaled(180 / np.pi, "elevation_rad", "pitch_rad", "travel_rad"),
        FILE_ERROR,
        "elevation_rad",
        "line 343",
        "looks like degrees; multiply the angles by pi/180",
    ),
    "travel in degrees": (
        scaled(180 / np.pi, "travel_rad"),
        FILE_ERROR,
        "travel_rad",
        "line 3",
        "looks like degrees; multiply the angles by pi/180",
    ),
    "degrees without steps": (
        with_smooth_pitch,
        FILE_ERROR,
        "pitch_rad",
        "line ",
        "looks like degrees; multiply the angles by pi/180",
    ),
    "millivolts": (scaled(1000.0, "back_V"), FILE_ERROR, "back_V", "line 126", "millivolts"),
    "milliseconds": (scaled(1000.0, "t_s"), FILE_ERROR, "t_s", "line 3", "give t_s in seconds"),
    "an uneven clock": (with_uneven_clock, REQUEST_ERROR, "t_s", "data row", "resample"),
    "too few rows": (
        without_rows(5, BAD_FLIGHTS_ROWS),
        FILE_ERROR,
        "t_s",
        "5 rows",
        "record a flight of at least",
    ),
    "too short": (
        without_rows(300, BAD_FLIGHTS_ROWS),
        REQUEST_ERROR,
        "t_s",
        "data row 1 to 300",
        "give a longer flight",
    ),
    "never moving": (
        scaled(0.0, "elevation_rad", "pitch_rad", "travel_rad"),
        REQUEST_ERROR,
        "elevation_rad",
        "data row 1 to 5000",
        "never moves",
    ),
}


@pytest.mark.parametrize("fault", SPOILED)
def test_useless_flight_gives_a_one_line_error_and_no_files(
    terminal: Terminal, tmp_path: Path, fault: str
) -> None:
    spoil, code, column, row, words = SPOILED[fault]
    write_csv(spoil(flight()), tmp_path / "bad.csv")
    line = refusal(terminal("identify", "bad.csv", "--save-rig", "new.toml", "--json", "new.json"), code=code)
    assert "bad.csv" in line and column in line and row in line, line
    assert words in line, line
    assert not (tmp_path / "new.toml").exists() and not (tmp_path / "new.json").exists()


def test_a_wrapped_angle_is_named_on_a_rig_that_turns_freely(terminal: Terminal, tmp_path: Path) -> None:
    write_csv(wrapped(flight()), tmp_path / "bad.csv")
    line = refusal(terminal("identify", "bad.csv", "--rig", "quanser-course"), code=REQUEST_ERROR)
    assert "bad.csv: travel_rad jumps by 6.28 in data row 70; unwrap the angle" in line


def test_a_missing_column_is_named(terminal: Terminal, tmp_path: Path) -> None:
    write_csv(flight(), tmp_path / "bad.csv")
    text = (tmp_path / "bad.csv").read_text()
    (tmp_path / "bad.csv").write_text(text.replace("front_V", "front_duty", 1))
    line = refusal(terminal("identify", "bad.csv"), code=FILE_ERROR)
    assert "bad.csv: column front_V is missing" in line


def test_error_names_the_file_of_a_bad_validation_flight(terminal: Terminal, tmp_path: Path) -> None:
    write_csv(flight(), tmp_path / "good.csv")
    write_csv(scaled(0.0, "front_V")(flight()), tmp_path / "bad.csv")
    line = refusal(
        terminal("identify", "good.csv", "--validate", "bad.csv", "--skip-sign-check"), code=REQUEST_ERROR
    )
    assert "bad.csv: front_V is 0" in line


def test_a_gap_is_left_out_on_request(terminal: Terminal, tmp_path: Path) -> None:
    write_csv(without_rows(1000, 1200)(flight()), tmp_path / "gap.csv")
    result = terminal(
        "identify",
        "gap.csv",
        "--allow-gaps",
        "--free",
        "thrust_gain",
        "--json",
        "new.json",
        "--skip-sign-check",
    )
    assert result.code == 0, result
    assert (tmp_path / "new.json").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("good.csv", "--rig", "nowhere"), "unknown rig 'nowhere'"),
        (("good.csv", "--model", "multibdy"), "did you mean multibody?"),
        (("good.csv", "--free", "thrust_gian"), "did you mean thrust_gain?"),
        (("good.csv", "--free", "supply"), "no parameter 'supply'"),
        (("good.csv", "--free", "reverse_thrust"), "give it a tolerance"),
        (("good.csv", "--free", "M_f", "--fix", "M_f"), "is in both --free and --fix"),
        (("good.csv", "--validate", "good.csv"), "both fitted and validated on"),
        (("good.csv", "good.csv"), "the same label"),
        (("good.csv", "--from", "9.5"), "no second of free flight"),
        (("missing.csv",), "cannot read missing.csv"),
    ],
)
def test_impossible_request_gives_a_one_line_error(
    terminal: Terminal, tmp_path: Path, arguments: tuple[str, ...], words: str
) -> None:
    write_csv(flight(), tmp_path / "good.csv")
    # The check of signs would refuse these artificial waves first.
    result = terminal("identify", *arguments, "--skip-sign-check")
    assert words in refusal(result, code=result.code)
    assert result.code in (REQUEST_ERROR, FILE_ERROR)


def with_tolerances(rig: Rig, **tolerances: float) -> Rig:
    """Return a rig with other tolerances, by parameter name."""
    numbers = dict(rig.numbers)
    for name, tolerance in tolerances.items():
        numbers[name] = replace(numbers[name], tolerance=tolerance)
    return replace(rig, numbers=numbers)


def test_without_tolerances_only_cable_torques_are_flight_constants() -> None:
    rig = with_tolerances(load_rig("makki2024"), torque_pitch=0.0, offset_pitch=0.0)
    priors = flight_constants(MultibodyModel(), rig)
    assert set(priors) == set(FLIGHT_CONSTANTS) - {"offset_pitch"}
    assert priors["torque_pitch"].std == pytest.approx(0.01)


def test_prior_of_a_constant_is_wide_in_fits_and_narrow_for_other_flights() -> None:
    rig = with_tolerances(load_rig("makki2024"), torque_pitch=0.3)
    assert flight_constants(MultibodyModel(), rig)["torque_pitch"].std == pytest.approx(0.15)
    other = flight_constants(MultibodyModel(), rig, {"torque_pitch": 0.05, "offset_elevation": 1.0})
    assert (other["torque_pitch"].mean, other["torque_pitch"].std) == pytest.approx((0.05, 0.01))
    assert other["offset_elevation"].mean == 1.0
    assert other["torque_travel"].mean == rig["torque_travel"].value


def flown(label: str) -> Record:
    """Make a record of two seconds; these tests do not use its values."""
    rows = 200
    still = np.zeros((rows, 3))
    return Record(
        label, np.arange(rows) / 100.0, still, still[:, :2], 0.01, np.full(3, 1e-3), ((0, rows),), ()
    )


def test_rig_of_several_flights_has_their_mean_torque_and_no_zero() -> None:
    model, rig = MultibodyModel(), load_rig("makki2024")
    free = ("friction_pitch", "torque_pitch", "offset_pitch")
    problem = Problem(model, rig, [flown("a"), flown("b")], free=free, per_flight=FLIGHT_CONSTANTS)
    estimates = {
        "friction_pitch": 0.02,
        "torque_pitch[a]": 0.01,
        "torque_pitch[b]": 0.03,
        "offset_pitch[a]": 0.5,
        "offset_pitch[b]": 0.7,
    }
    theta = np.array([estimates[name] for name in problem.names])
    covariance = np.diag(np.full(len(theta), 0.001**2))
    fit = Fit(problem, theta, covariance, covariance, (), (), (), 0.0, (), 1, 0.0, converged=True)
    numbers = Identification(fit, (), (), (), ()).rig("found").numbers
    assert (numbers["friction_pitch"].value, numbers["friction_pitch"].tolerance) == (
        pytest.approx((0.02, 0.002))
    )
    assert numbers["torque_pitch"].value == pytest.approx(0.02)
    # A tolerance is two standard deviations: that of the estimates, and that of cables from day to day.
    assert numbers["torque_pitch"].tolerance == pytest.approx(2.0 * np.hypot(0.001, np.sqrt(2.0) * 0.01))
    assert numbers["offset_pitch"] == rig["offset_pitch"]


RIG = load_rig("makki2024")
FREE = ("M_w", "L_phi", "thrust_gain", "dead_zone", "friction_pitch", "offset_pitch")
SIGMA_RAD = np.array([4e-4, 4e-4, 4e-4])


def model(name: str) -> tuple[Model, tuple[str, ...]]:
    """Return a model and its free parameters; the model "late" has a lag and a delay."""
    effects = catalogue()
    lag, delay = effects["rotor_lag"].make({"rotor_lag_s": 0.08}), effects["input_delay"].make()
    return {
        "multibody": (MultibodyModel(), FREE),
        "paper": (PaperModel(), FREE[2:]),
        "late": (MultibodyModel((lag, delay)), (*FREE, "rotor_lag_s", "input_delay_s")),
    }[name]


def inputs(substeps: int, shaped: tuple[str, ...]) -> Inputs:
    """Make three windows of unequal length with random voltages about hover."""
    # For each parameter in `shaped`, a random mean and change of it within the steps are added.
    random = np.random.default_rng(3)
    steps = np.array([40, 7, 23], np.int64)
    rows = int(steps.sum())
    pairs = [random.normal(0.0, 1.0, (2, rows, 2)) for _ in shaped]
    return Inputs(
        steps,
        np.array([0.0, 3.0, 5.0]),
        0.01,
        1.75 + 0.2 * random.standard_normal((rows, 2)),
        0.05 * random.standard_normal((rows, 2)),
        substeps,
        tuple(
            VoltageDerivative(name, mean, change) for name, (mean, change) in zip(shaped, pairs, strict=True)
        ),
    )


def random_initial_states(equations: Model) -> Floats:
    """Return random initial states of the three windows, shape (3, states)."""
    random = np.random.default_rng(4)
    states: Floats = 0.1 * random.standard_normal((3, len(equations.states)))
    return states


@pytest.fixture
def no_compiler(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Hide the C compiler, and all functions that were compiled earlier."""
    monkeypatch.setattr(heli_sim.evaluate.compiled, "compiler", lambda: None)
    monkeypatch.setattr(heli_sim.evaluate.compiled, "cache_folder", lambda: tmp_path)


@pytest.mark.parametrize("substeps", [1, 2])
@pytest.mark.parametrize("name", ["multibody", "paper", "late"])
def test_compiled_and_interpreted_loops_agree(name: str, substeps: int) -> None:
    equations, free = model(name)
    compiled, interpreted = kernel(equations, free), InterpretedKernel(Functions(equations, free))
    assert isinstance(compiled, CompiledKernel)
    drive = inputs(substeps, ("input_delay_s", "dead_zone") if name == "late" else ())
    arguments = drive, random_initial_states(equations), equations.parameter_values(RIG)
    measured = np.random.default_rng(5).normal(0.0, 0.1, (drive.rows, 3))
    for of_compiled, of_interpreted in zip(
        (*compiled.jacobian(*arguments), *compiled.predict(*arguments)),
        (*interpreted.jacobian(*arguments), *interpreted.predict(*arguments)),
        strict=True,
    ):
        np.testing.assert_allclose(of_compiled, of_interpreted, rtol=1e-9, atol=1e-11)
    for of_compiled, of_interpreted in zip(
        compiled.products(*arguments, measured, SIGMA_RAD),
        interpreted.products(*arguments, measured, SIGMA_RAD),
        strict=True,
    ):
        np.testing.assert_allclose(of_compiled, of_interpreted, rtol=1e-8, atol=1e-6)


@pytest.mark.parametrize("name", ["multibody", "late"])
def test_window_has_the_same_bits_alone_and_together_with_others(name: str) -> None:
    equations, free = model(name)
    runner = kernel(equations, free)
    random = np.random.default_rng(6)
    steps = np.array([9, 5, 12, 1, 7, 30], np.int64)
    rows = int(steps.sum())
    volts_V = 1.75 + 0.2 * random.standard_normal((rows, 2))
    slope_V = 0.05 * random.standard_normal((rows, 2))
    start_s, values = np.arange(6.0), equations.parameter_values(RIG)
    states = 0.1 * random.standard_normal((6, len(equations.states)))
    measured_rad = random.normal(0.0, 0.1, (rows, 3))

    def results(windows: slice, window_rows: slice) -> list[Floats]:
        """Return all results of the kernel for some windows, which have these rows."""
        drive = Inputs(steps[windows], start_s[windows], 0.01, volts_V[window_rows], slope_V[window_rows])
        arguments = drive, states[windows], values
        products = runner.products(*arguments, measured_rad[window_rows], SIGMA_RAD)
        return [*runner.predict(*arguments), *runner.jacobian(*arguments), *products]

    # Which results have one entry per row; the others have one per window.
    has_rows = (True, False, True, True, True, False)
    together = results(slice(6), slice(rows))
    for number, first in enumerate(np.cumsum(steps) - steps):
        window, window_rows = slice(number, number + 1), slice(int(first), int(first + steps[number]))
        one_window = results(window, window_rows)
        for result_alone, result_together, is_by_row in zip(one_window, together, has_rows, strict=True):
            entries = window_rows if is_by_row else window
            np.testing.assert_array_equal(result_alone, result_together[entries])


@pytest.mark.parametrize("name", ["multibody", "late"])
def test_jacobian_is_the_finite_difference_of_the_free_run(name: str) -> None:
    equations, free = model(name)
    runner, drive = kernel(equations, free), inputs(2, ())
    states, values = random_initial_states(equations), equations.parameter_values(RIG)
    _, jacobian = runner.jacobian(drive, states, values)
    state_count = states.shape[1]
    # The columns of the Jacobian are the initial states, then the free parameters.
    for column in range(state_count + len(free)):
        step = 1e-5
        if column >= state_count:
            parameter = equations.parameter_names.index(free[column - state_count])
            step *= max(abs(values[parameter]), 1.0)
        predictions = []
        for sign in (-1.0, 1.0):
            changed_states, changed_values = states.copy(), values.copy()
            if column < state_count:
                changed_states[:, column] += sign * step
            else:
                changed_values[parameter] += sign * step
            predictions.append(runner.predict(drive, changed_states, changed_values)[0])
        slope = (predictions[1] - predictions[0]) / (2.0 * step)
        np.testing.assert_allclose(jacobian[:, :, column], slope, rtol=1e-4, atol=1e-5)


def test_code_digest_changes_with_the_loop_in_c(monkeypatch: pytest.MonkeyPatch) -> None:
    read = Path.read_bytes
    before = package_digest.__wrapped__("heli_lab")
    monkeypatch.setattr(Path, "read_bytes", lambda path: read(path) + b" " * (path.name == "windows.c"))
    assert package_digest.__wrapped__("heli_lab") != before


def test_without_a_compiler_the_interpreted_loop_is_taken(no_compiler: None) -> None:
    assert isinstance(kernel(*model("multibody")), InterpretedKernel)


_CALL = """
void run(const double* x, const double* u, const double* t, const double* p, double* result) {
  Lanes vx[2], vu[2], vt[1], value[SIZE];
  for (int z = 0; z < LANES; ++z) {
    for (int i = 0; i < 2; ++i) vx[i][z] = x[2 * z + i], vu[i][z] = u[2 * z + i];
    vt[0][z] = t[z];
  }
  operations(vx, vu, vt, p, value);
  for (int z = 0; z < LANES; ++z) for (int i = 0; i < SIZE; ++i) result[SIZE * z + i] = value[i][z];
}
"""


def unary(a: ca.SX) -> list[ca.SX]:
    """Return every operation on one value, with arguments in its domain."""
    half = 0.5 + 0.4 * ca.sin(a)
    return [
        *(
            -a,
            a * a,
            2.0 * a,
            1.0 / a,
            ca.exp(a),
            ca.log(half),
            ca.sqrt(half),
            ca.sin(a),
            ca.cos(a),
            ca.tan(a),
        ),
        *(ca.asin(half), ca.acos(half), ca.atan(a), ca.floor(a), ca.ceil(a), ca.fabs(a), ca.erf(a)),
        *(ca.sinh(a), ca.cosh(a), ca.tanh(a), ca.asinh(a), ca.acosh(1.0 + half), ca.atanh(half), ca.sign(a)),
        *(ca.log1p(half), ca.expm1(a), ca.logic_not(a), half**2.5),
    ]


def binary(a: ca.SX, b: ca.SX) -> list[ca.SX]:
    """Return every operation on two values."""
    return [
        *(a + b, a - b, a * b, a / b, ca.fabs(a) ** b, a < b, a <= b, a == b, a != b, ca.fmin(a, b)),
        *(ca.logic_and(a, b), ca.logic_or(a, b), ca.if_else(a < b, a, b), ca.fmax(a, b), ca.fmod(a, b)),
        *(ca.copysign(a, b), ca.atan2(a, b), ca.hypot(a, b), ca.remainder(a, b)),
    ]


def test_each_operation_in_each_lane_is_that_of_casadi(tmp_path: Path) -> None:
    x, u, t, p = ca.SX.sym("x", 2), ca.SX.sym("u", 2), ca.SX.sym("t"), ca.SX.sym("p", 2)
    values = [
        *unary(x[0]),
        *unary(p[0]),
        *binary(x[0], u[1]),
        *binary(x[1], p[1]),
        *binary(p[0], t),
        *binary(p[0], p[1]),
        *(ca.SX(0.5), ca.SX(np.inf)),
    ]
    function = ca.Function("operations", [x, u, t, p], [ca.vertcat(*values)])
    head = LOOP.read_text(encoding="utf-8").partition("/* The functions")[0]
    size = len(values)
    source = f"#define SIZE {size}\n{head}{c_function(function)}{_CALL}"
    library = heli_sim.evaluate.compiled.compile_source("lanes", source)
    if library is None:
        pytest.skip("no C compiler")
    random = np.random.default_rng(1)
    state, inputs, times = (random.normal(0.0, 1.5, shape) for shape in ((4, 2), (4, 2), 4))
    inputs[1, 1] = state[1, 0]  # equal operands, for comparisons
    state[2:, 0] = 0.0, -4.0
    inputs[2:, 1] = 0.0, np.nan
    state[2:, 1] = np.nan, 0.0
    parameters = np.array([0.7, -1.3])
    result = np.empty((4, size))
    ctypes.CDLL(str(library)).run(
        *(ctypes.c_void_p(a.ctypes.data) for a in (state, inputs, times, parameters, result))
    )
    for lane in range(4):
        expected = np.array(function(state[lane], inputs[lane], times[lane], parameters))[:, 0]
        np.testing.assert_allclose(result[lane], expected, rtol=4e-16, atol=0.0)


def test_an_unknown_operation_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    x = ca.SX.sym("x", 1)
    function = ca.Function("f", [x], [ca.sin(x)])
    monkeypatch.setattr(lanes, "_EXPRESSIONS", {})
    with pytest.raises(PlantError, match="operation"):
        c_function(function)
