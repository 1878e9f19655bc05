"""Fixed-point numbers, control law and shaping against references in double precision."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from heli_host.declaration import PARAMS
from heli_test_native import control, flight
from hypothesis import given, settings
from hypothesis import strategies as st

ELEVATION, PITCH, TRAVEL = 1, 2, 4


@dataclass
class Loop:
    kp: float
    ki: float
    kd: float
    integral_max: float
    integral: float = 0.0

    def output(self, error: float, rate: float) -> float:
        return self.kp * error + self.integral - self.kd * rate

    def learn(self, error: float, excess: float) -> None:
        if error * excess <= 0:
            self.integral = bound(self.integral + self.ki * error * TICK_S, self.integral_max)


@dataclass
class ReferenceLaw:
    """One instance flies one flight; `parameters` by their declared names, in declared units."""

    parameters: Mapping[str, float]
    axes: int | None = None
    jumps: dict[str, float] = field(default_factory=dict)
    last: dict[str, float] = field(default_factory=dict)
    elevation: Loop = field(init=False)
    pitch: Loop = field(init=False)
    travel: Loop = field(init=False)

    def __post_init__(self) -> None:
        self._restart(ELEVATION | PITCH | TRAVEL)

    def _restart(self, closing: int) -> None:
        p = self.parameters
        loops = ((ELEVATION, "elevation", "V"), (PITCH, "pitch", "V"), (TRAVEL, "travel", "deg"))
        for bit, axis, unit in loops:
            if closing & bit:
                kp, ki, kd = (p[f"{axis}_{gain}"] for gain in ("kp", "ki", "kd"))
                setattr(self, axis, Loop(kp, ki, kd, integral_max=p[f"{axis}_integral_max_{unit}"]))

    def _without_jump(self, name: str, value: float, changed: bool) -> float:
        """Return a value that continues from the last one when the source of a signal has changed."""
        decay = math.exp(-TICK_S / self.parameters["bumpless_s"])
        self.jumps[name] = self.last.get(name, 0.0) - value if changed else self.jumps.get(name, 0.0) * decay
        return value + self.jumps[name]

    def _lift(self, motor_V: float) -> float:
        zone = self.parameters["dead_zone_V"]
        return math.copysign(max(abs(motor_V) - zone, 0.0), motor_V)

    def _motor(self, lift_V: float) -> float:
        p = self.parameters
        motor_V = lift_V + p["dead_zone_V"] * bound(lift_V / 0.05, 1.0)
        return max(p["motor_min_V"], min(p["motor_max_V"], motor_V))

    def update(
        self,
        angle_deg: tuple[float, float, float],
        rate_deg_s: tuple[float, float, float],
        setpoint_deg: tuple[float, float, float],
        setpoint_rate_deg_s: tuple[float, float, float],
        setpoint_acceleration_deg_s2: tuple[float, float, float],
        axes: int,
        open_V: tuple[float, float],
        excitation_V: tuple[float, float],
    ) -> tuple[float, float, float]:
        """One tick; returns front and back voltage and the pitch setpoint in degrees."""
        # `axes` are those whose loops are closed. `plus` and `minus` are sum and difference of the lifting
        # voltages, U+ and U- of the paper.
        p = self.parameters
        elevation_deg, pitch_deg, travel_deg = angle_deg
        elevation_deg_s, pitch_deg_s, travel_deg_s = rate_deg_s
        elevation_setpoint, given_pitch_setpoint, travel_setpoint = setpoint_deg
        elevation_setpoint_rate, _, travel_setpoint_rate = setpoint_rate_deg_s
        elevation_acceleration, _, travel_acceleration = setpoint_acceleration_deg_s2
        changed = ELEVATION | PITCH | TRAVEL if self.axes is None else axes ^ self.axes
        self.axes = axes
        if axes & (ELEVATION | PITCH) == 0:
            return self._open(changed, open_V, excitation_V, given_pitch_setpoint)
        self._restart(axes & changed)
        if axes & changed & PITCH:
            self.last["pitch_setpoint"] = pitch_deg

        travel_error = travel_setpoint - travel_deg
        demand = given_pitch_setpoint
        if axes & TRAVEL:
            relative_rate = travel_deg_s - p["travel_rate_ff"] * travel_setpoint_rate
            demand = p["travel_acceleration_ff"] * travel_acceleration + self.travel.output(
                travel_error, relative_rate
            )
        demand = self._without_jump("pitch_setpoint", demand, bool(changed & (TRAVEL | PITCH)))
        previous = self.last.get("pitch_setpoint", 0.0)
        step = bound(demand, p["pitch_setpoint_max_deg"]) - previous
        pitch_setpoint = previous + bound(step, p["pitch_slew_deg_s"] * TICK_S)
        self.last["pitch_setpoint"] = pitch_setpoint

        front_lift, back_lift = (self._lift(volts) for volts in open_V)
        plus, minus = front_lift + back_lift, front_lift - back_lift
        elevation_error, pitch_error = elevation_setpoint - elevation_deg, pitch_setpoint - pitch_deg
        if axes & ELEVATION:
            feed_forward_V = (
                p["hover_V"]
                + p["hover_slope"] * elevation_setpoint
                + p["elevation_acceleration_ff"] * elevation_acceleration
            )
            relative_rate = elevation_deg_s - p["elevation_rate_ff"] * elevation_setpoint_rate
            plus = feed_forward_V + self.elevation.output(elevation_error, relative_rate)
        if axes & PITCH:
            minus = p["pitch_hold_ff"] * pitch_setpoint + self.pitch.output(pitch_error, pitch_deg_s)
        plus = self._without_jump("plus", plus, bool(changed & ELEVATION))
        minus = self._without_jump("minus", minus, bool(changed & PITCH))

        # Pitch has priority: the difference is limited first, and leaves the sum what remains.
        front_excitation, back_excitation = excitation_V
        extra_plus, extra_minus = front_excitation + back_excitation, front_excitation - back_excitation
        low, high = self._lift(p["motor_min_V"]), self._lift(p["motor_max_V"])
        acted_minus = bound(minus + extra_minus, min(high - low, p["differential_max_V"]))
        acted_plus = max(2 * low + abs(acted_minus), min(2 * high - abs(acted_minus), plus + extra_plus))
        self.last["plus"] = acted_plus - extra_plus
        self.last["minus"] = acted_minus - extra_minus

        # An integral does not grow while its output exceeds a limit.
        excess_minus = minus + extra_minus - acted_minus
        if axes & ELEVATION:
            self.elevation.learn(elevation_error, plus + extra_plus - acted_plus)
        if axes & PITCH:
            self.pitch.learn(pitch_error, excess_minus)
        if axes & TRAVEL:
            excess_pitch = demand - pitch_setpoint
            self.travel.learn(travel_error, excess_pitch if excess_pitch != 0 else excess_minus)
        front = self._motor((acted_plus + acted_minus) / 2)
        back = self._motor((acted_plus - acted_minus) / 2)
        self.last["front"], self.last["back"] = front, back
        return front, back, pitch_setpoint

    def _open(
        self, changed: int, open_V: tuple[float, float], excitation_V: tuple[float, float], pitch_deg: float
    ) -> tuple[float, float, float]:
        p = self.parameters
        acted = []
        for name, volts, extra in zip(("front", "back"), open_V, excitation_V, strict=True):
            self.last[name] = self._without_jump(name, volts, changed != 0)
            acted.append(max(p["motor_min_V"], min(p["motor_max_V"], self.last[name] + extra)))
        lifts = [self._lift(self.last["front"]), self._lift(self.last["back"])]
        self.last["plus"], self.last["minus"] = sum(lifts), lifts[0] - lifts[1]
        return acted[0], acted[1], pitch_deg


MIN, MAX = -(2**31), 2**31 - 1
QUANTITY_BITS, GAIN_BITS = 24, 20
bits = st.integers(MIN, MAX)


def saturated(value: int) -> int:
    return max(MIN, min(MAX, value))


@pytest.mark.medium
@given(st.floats(width=32, allow_nan=False))
def test_a_float_becomes_the_nearest_quantity(value: float) -> None:
    if math.isinf(value):
        assert abs(control.quantity(value)) == MAX
        return
    exact = Fraction(value) * 2**QUANTITY_BITS
    quantity = control.quantity(value)
    assert abs(quantity - max(-MAX, min(MAX, exact))) <= Fraction(1, 2)


@pytest.mark.medium
def test_a_float_of_any_exponent_becomes_the_nearest_quantity() -> None:
    for exponent in range(-149, 7):
        for value in (2.0**exponent, -1.5 * 2.0**exponent):
            exact = Fraction(float(np.float32(value))) * 2**QUANTITY_BITS
            assert abs(control.quantity(value) - exact) <= Fraction(1, 2), exponent


@pytest.mark.medium
@given(bits, bits)
def test_sums_and_differences_saturate(a: int, b: int) -> None:
    assert control.quantity_sum(a, b) == saturated(a + b)
    assert control.quantity_difference(a, b) == saturated(a - b)


@pytest.mark.medium
@given(bits, bits)
def test_products_are_rounded_and_saturate(gain: int, quantity: int) -> None:
    exact = math.floor(Fraction(gain * quantity, 2**GAIN_BITS) + Fraction(1, 2))
    assert control.quantity_product(gain, quantity) == saturated(exact)


@pytest.mark.medium
@given(st.integers(0, 2**62 - 1))
def test_square_root_needs_no_division_and_is_right(value: int) -> None:
    exact = math.isqrt(value)
    assert abs(control.square_root(value) - exact) <= 1 + exact * 1e-8


@pytest.mark.medium
@pytest.mark.parametrize("cutoff_Hz", [0.5, 4.0, 200.0])
def test_rate_filter_agrees_with_double_precision(cutoff_Hz: float) -> None:
    smoothing = 1.0 - math.exp(-2.0 * math.pi * cutoff_Hz * 0.001)
    t = np.arange(20_000) * 0.001
    counts = np.round(2000.0 * np.sin(0.7 * t) + 300.0 * np.sin(9.0 * t))
    angles_rad = counts * 2.0 * math.pi / 4096.0
    law = control.RateFilter()
    first = second = angles_rad[0]
    worst_rad_s = 0.0
    for angle_rad in angles_rad:
        first += smoothing * (angle_rad - first)
        step = smoothing * (first - second)
        second += step
        worst_rad_s = max(worst_rad_s, abs(law.update(float(angle_rad), smoothing) - step * 1000.0))
    # Half of the last bit of a step is 3e-5 rad/s; an encoder's count is 1.5 rad/s before the filter.
    assert worst_rad_s < 2e-4


INDEX = {p.name: p.index for p in PARAMS}
DEFAULTS = {p.name: p.default for p in PARAMS}
ALL = 7


def make_law(**changes: float) -> tuple[Any, ReferenceLaw]:
    parameters = DEFAULTS | changes
    law = control.Law([(INDEX[name], value) for name, value in parameters.items()])
    return law, ReferenceLaw(parameters)


def radians(values: tuple[float, ...]) -> tuple[float, ...]:
    return tuple(math.radians(v) for v in values)


def fly_both(
    seed: int, ticks: int, masks_used: tuple[int, ...] = (ALL, 1, 2, 3, 6, 0), /, **changes: float
) -> np.ndarray:
    """Random smooth states, setpoints, axis masks and excitation through both laws; (ticks, 6)."""
    rng = np.random.default_rng(seed)
    law, reference = make_law(**changes)
    t = np.arange(ticks) * 0.001

    def wave(size: float, most_Hz: float = 3.0) -> Any:
        return size * np.sin(2 * np.pi * rng.uniform(0.05, most_Hz) * t + rng.uniform(0, 6))

    angles = np.stack([wave(15), wave(25), wave(60)], axis=1)  # deg (ticks, 3)
    rates = np.gradient(angles, 0.001, axis=0)
    # Setpoints accelerate at 2000 deg/s2 at most: the limit of the parameter.
    setpoints = np.stack([wave(10, 1.0), wave(18, 1.0), wave(40, 1.0)], axis=1)
    setpoint_rates = np.gradient(setpoints, 0.001, axis=0)
    setpoint_accelerations = np.gradient(setpoint_rates, 0.001, axis=0)
    masks = rng.choice(masks_used, size=1 + ticks // 200).repeat(200)[:ticks]
    out = np.empty((ticks, 6))
    for k in range(ticks):
        open_V = (1.5 + rng.uniform(-1, 1), 1.5)
        excitation_V = (float(rng.normal(0, 0.2)), float(rng.normal(0, 0.2)))
        motion = (angles, rates, setpoints, setpoint_rates, setpoint_accelerations)
        state: list[Any] = [tuple(x[k]) for x in motion]
        rest: tuple[Any, ...] = (int(masks[k]), open_V, excitation_V)
        front, back, pitch_rad, *_ = law.update(*(radians(x) for x in state), *rest)
        out[k] = (front, back, math.degrees(pitch_rad), *reference.update(*state, *rest))
    return out


@pytest.mark.medium
@pytest.mark.parametrize("seed", range(6))
def test_law_agrees_with_the_equations_over_random_flights(seed: int) -> None:
    out = fly_both(seed, 4000)
    # A slewing pitch setpoint is rounded by up to 3e-8 rad a tick, and the blend multiplies volts by 20.
    np.testing.assert_allclose(out[:, :2], out[:, 3:5], atol=2e-3)  # V
    np.testing.assert_allclose(out[:, 2], out[:, 5], atol=2e-3)  # deg


@pytest.mark.medium
def test_law_agrees_when_the_motors_may_reverse_and_gains_are_the_papers() -> None:
    paper = {"elevation_ki": 1.0, "elevation_kd": 0.1, "pitch_ki": 3.0, "pitch_kd": 0.1, "travel_ki": 0.13}
    out = fly_both(11, 4000, motor_min_V=-6.0, pitch_hold_ff=0.033, **paper)
    np.testing.assert_allclose(out[:, :2], out[:, 3:5], atol=5e-3)


@pytest.mark.medium
def test_law_agrees_when_gains_are_so_large_that_their_terms_leave_the_range_of_numbers() -> None:
    large = {"elevation_kp": 8.0, "elevation_kd": 2.0, "pitch_kp": 10.0, "pitch_kd": 2.0}
    still = {"elevation_ki": 0.0, "pitch_ki": 0.0, "travel_ki": 0.0, "bumpless_s": 0.02}
    out = fly_both(12, 4000, (ALL,), differential_max_V=24.0, **large, **still)
    # The fade of the start is over by then. Rounding of a slewing pitch setpoint by 1e-5 rad gives 6 mV at
    # this gain, and more where two add up. The blend multiplies this by up to 20. A term that saturated
    # alone would give 10 V.
    np.testing.assert_allclose(out[1000:, :2], out[1000:, 3:5], atol=0.2)


level = st.floats(-12, 12, width=32)


@pytest.mark.medium
@given(level, level, st.floats(-5, 0, width=32), st.floats(0.5, 11, width=32), st.floats(0.125, 24, width=32))
def test_mixer_keeps_motors_in_range_and_pitch_first(
    collective_V: float, differential_V: float, least_V: float, most_V: float, bound_V: float
) -> None:
    front, back, plus, minus = control.mix(collective_V, differential_V, least_V, most_V, bound_V)
    assert least_V - 1e-5 <= front <= most_V + 1e-5
    assert least_V - 1e-5 <= back <= most_V + 1e-5
    assert front + back == pytest.approx(plus, abs=1e-5)
    assert front - back == pytest.approx(minus, abs=1e-5)
    largest = min(bound_V, most_V - least_V)
    assert minus == pytest.approx(max(-largest, min(largest, differential_V)), abs=1e-5)


def test_pitch_is_held_by_its_feed_forward_alone() -> None:
    law, _ = make_law(pitch_kp=0.0, pitch_ki=0.0, pitch_kd=0.0, pitch_hold_ff=0.033, bumpless_s=0.02)
    zero = (0.0, 0.0, 0.0)
    for _ in range(3000):
        front, back, *_ = law.update(
            zero, zero, radians((0.0, 12.0, 0.0)), zero, zero, 3, (0.0, 0.0), (0.0, 0.0)
        )
    assert front - back == pytest.approx(0.033 * 12.0, abs=1e-5)


def step_response(differential_V: float) -> float:
    """Collective that is left when pitch asks for this much."""
    collective_V: float = control.mix(4.0, differential_V, 0.0, 9.0, 24.0)[2]
    return collective_V


def test_pitch_takes_voltage_from_the_collective_only_when_a_motor_is_at_its_limit() -> None:
    assert step_response(3.9) == pytest.approx(4.0)
    assert step_response(6.0) == pytest.approx(6.0)


def run_constant(law: Any, ticks: int, axes: int, setpoint_deg: tuple[float, float, float]) -> list[float]:
    zero = (0.0, 0.0, 0.0)
    state = (zero, zero, radians(setpoint_deg), zero, zero)
    return [law.update(*state, axes, (0.0, 0.0), (0.0, 0.0))[0] for _ in range(ticks)]


def test_integrator_does_not_wind_up_while_the_mixer_is_saturated() -> None:
    law, _ = make_law(elevation_ki=5.0, elevation_integral_max_V=20.0)
    run_constant(law, 5000, ALL, (24.0, 0.0, 0.0))
    saturated = run_constant(law, 1, ALL, (24.0, 0.0, 0.0))[0]
    assert saturated == pytest.approx(DEFAULTS["motor_max_V"], abs=0.3)
    # With the error reversed the output must leave the limit at once, not after unwinding 5 s of integral.
    after = run_constant(law, 300, ALL, (-24.0, 0.0, 0.0))
    assert after[-1] == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("before, after", [(0, ALL), (ALL, 0), (2, ALL), (ALL, 2), (3, 6)])
def test_mode_changes_do_not_jump(before: int, after: int) -> None:
    law, _ = make_law()
    zero = (0.0, 0.0, 0.0)
    state = (radians((-3.0, 2.0, 5.0)), zero, radians((4.0, -3.0, 9.0)), zero, zero)
    open_V, none = (1.8, 1.6), (0.0, 0.0)
    for _ in range(3000):
        last = law.update(*state, before, open_V, none)
    first = law.update(*state, after, open_V, none)
    # The fade loses 1/300 of the jump a tick, and a loop that closes starts from the angle it finds.
    assert first[0] == pytest.approx(last[0], abs=0.06)
    assert first[1] == pytest.approx(last[1], abs=0.06)


def test_derivative_acts_on_the_measurement_not_on_the_setpoint() -> None:
    law, _ = make_law(elevation_ki=0.0, pitch_ki=0.0, travel_ki=0.0, hover_slope=0.0)
    before = run_constant(law, 3000, 1, (0.0, 0.0, 0.0))[-1]
    after = run_constant(law, 1, 1, (1.0, 0.0, 0.0))[0]
    assert after - before == pytest.approx(DEFAULTS["elevation_kp"] * 1.0 / 2, abs=1e-3)


def test_open_loop_gives_the_voltages_that_were_asked_for_dead_zone_included() -> None:
    law, _ = make_law()
    zero = (0.0, 0.0, 0.0)
    for _ in range(6000):
        out = law.update(zero, zero, zero, zero, zero, 0, (0.4, 2.5), (0.0, 0.0))
    assert out[:2] == pytest.approx((0.4, 2.5), abs=1e-4)


@pytest.mark.medium
@given(st.floats(2.0**-10, 2.0**20, width=32))
def test_reciprocal_needs_no_division_and_is_right(value: float) -> None:
    assert control.reciprocal(value) * value == pytest.approx(1.0, rel=1e-6)


def test_rate_filter_follows_a_ramp_exactly_and_halves_no_signal_below_its_cutoff() -> None:
    smoothing = 1 - math.exp(-2 * math.pi * 20 * 0.001)
    ramp = control.RateFilter()
    for k in range(400):
        rate = ramp.update(0.002 * k, smoothing)
    assert rate == pytest.approx(2.0, rel=1e-3)
    wave = control.RateFilter()
    t = np.arange(3000) * 0.001
    rates = np.array([wave.update(float(np.sin(2 * np.pi * 5 * x)), smoothing) for x in t])[1000:]
    # Two poles at 20 Hz leave 1 / (1 + (5/20)^2) of a 5 Hz signal.
    assert np.ptp(rates) / 2 == pytest.approx(2 * np.pi * 5 / (1 + (5 / 20) ** 2), rel=0.02)


def test_rate_filter_quietens_the_encoder_as_the_comment_claims() -> None:
    smoothing = 1 - math.exp(-2 * math.pi * 20 * 0.001)
    t = np.arange(20000) * 0.001
    angle = 0.3 * np.sin(2 * np.pi * 0.2 * t)
    counted = np.round(angle * 4096 / (2 * np.pi)) * 2 * np.pi / 4096
    law = control.RateFilter()
    rates = np.array([law.update(float(a), smoothing) for a in counted])[2000:]
    exact = 0.3 * 2 * np.pi * 0.2 * np.cos(2 * np.pi * 0.2 * t)[2000:]
    raw = np.diff(counted)[1999:] / 0.001 - exact
    assert np.std(raw) > 0.2
    assert np.std(rates - exact) < 0.03


@pytest.mark.medium
@settings(deadline=None)
@given(
    kind=st.integers(1, 5),
    front_V=st.floats(-2, 2, width=32),
    back_V=st.floats(-2, 2, width=32),
    start_Hz=st.floats(0, 20, width=32),
    spread_Hz=st.floats(0, 100, width=32),
    duration_s=st.floats(0.015625, 4, width=32),
    seed=st.integers(1, 2**32 - 1),
)
def test_excitation_never_exceeds_its_amplitude_or_its_time(
    kind: int, front_V: float, back_V: float, start_Hz: float, spread_Hz: float, duration_s: float, seed: int
) -> None:
    ticks = round(duration_s * 1000)
    values = control.excitation(
        kind, front_V, back_V, start_Hz, start_Hz + spread_Hz, duration_s, seed, ticks + 50
    )
    assert np.all(np.abs(values[:, 0]) <= abs(front_V) + 1e-6)
    assert np.all(np.abs(values[:, 1]) <= abs(back_V) + 1e-6)
    assert np.all(values[ticks + 1 :] == 0)


def test_multisine_excites_the_motors_at_frequencies_of_their_own() -> None:
    values = control.excitation(4, 1.0, 1.0, 0.5, 8.0, 60.0, 1, 60000)
    spectrum = np.abs(np.fft.rfft(values, axis=0))  # (frequencies, 2)
    peaks = [set(np.argsort(spectrum[:, motor])[-8:]) for motor in (0, 1)]
    assert peaks[0].isdisjoint(peaks[1])
    expected = 0.5 + (2 * np.arange(8)) / 15 * 7.5
    np.testing.assert_allclose(sorted(np.array(list(peaks[0])) / 60.0), expected, atol=0.02)


def test_chirp_sweeps_from_start_to_stop() -> None:
    values = control.excitation(3, 1.0, 0.0, 1.0, 20.0, 10.0, 1, 10000)[:, 0]
    crossings = np.flatnonzero(np.diff(np.signbit(values)))
    frequency = 500 / np.diff(crossings)  # Hz, half periods in ms
    middle = crossings[:-1] / 1000
    np.testing.assert_allclose(frequency[5:-5], 1 + 1.9 * middle[5:-5], rtol=0.12)


def test_prbs_switches_at_its_rate_only_and_depends_on_its_seed() -> None:
    values = control.excitation(5, 1.0, 1.0, 0.0, 10.0, 20.0, 42, 20000)[:, 0]
    switches = np.flatnonzero(np.diff(values)) + 1
    assert np.all(np.isin(np.mod(switches, 100), (0, 1, 99)))
    assert 60 < len(switches) < 140
    other = control.excitation(5, 1.0, 1.0, 0.0, 10.0, 20.0, 43, 20000)[:, 0]
    assert not np.array_equal(values, other)


def test_doublet_and_step_have_their_shapes() -> None:
    doublet = control.excitation(2, 1.5, -0.5, 0.0, 0.0, 2.0, 1, 2000)
    assert np.all(doublet[:1000] == (1.5, -0.5))
    assert np.all(doublet[1000:] == (-1.5, 0.5))
    assert np.all(control.excitation(1, 0.5, 0.25, 0.0, 0.0, 1.0, 1, 1000) == (0.5, 0.25))


TICK_S = 0.001
CLOSE_IN = 0.01


def bound(value: float, most: float) -> float:
    return max(-most, min(most, value))


@dataclass
class ReferenceAxis:
    """One axis; `change` is its acceleration a tick, infinite for pitch."""

    step_max: float
    change_max: float
    path: float = 0.0
    target: float = 0.0
    slope: float = 0.0
    ramp: int = 0
    angle: float = 0.0
    step: float = 0.0
    smooth: float = 0.0

    def aim(self, target: float, ramp_ticks: int) -> None:
        self.target, self.ramp = target, ramp_ticks
        self.slope = (target - self.path) / ramp_ticks if ramp_ticks else 0.0

    def advance(self) -> tuple[float, float, float]:
        self.ramp = max(0, self.ramp - 1)
        self.path, self.slope = (self.path + self.slope, self.slope) if self.ramp else (self.target, 0.0)
        remaining = self.path - self.angle
        if math.isinf(self.change_max):
            self.angle += bound(remaining, self.step_max)
            return self.angle, 0.0, 0.0
        # Near the target, it is approached exponentially; before that, the axis brakes evenly.
        approach = self.change_max / CLOSE_IN**2
        speed = remaining * CLOSE_IN
        if abs(remaining) > approach:
            braking = math.sqrt(2 * self.change_max * (abs(remaining) - approach / 2))
            speed = math.copysign(braking, remaining)
        step = bound(bound(self.slope, self.step_max) + speed, self.step_max)
        change = bound(step - self.step, self.change_max)
        self.step += change
        self.angle += self.step
        self.smooth += 0.01 * (change - self.smooth)
        return self.angle, self.step / TICK_S, self.smooth / TICK_S**2


def limit(deg: float) -> float:
    """A limit as the firmware keeps it: in 2^-36 rad a tick, so 8e-4 deg/s2 for an acceleration."""
    return math.degrees(round(math.radians(deg) * 2**36) / 2**36)


def shape_both(seed: int, ticks: int, **changes: float) -> np.ndarray:
    """Random targets through firmware and reference; (ticks, 2, axis, angle to acceleration), in degrees."""
    p = DEFAULTS | changes
    rng = np.random.default_rng(seed)
    shaper: Any = flight.Shaper([(INDEX[name], value) for name, value in p.items()])
    axes = [
        ReferenceAxis(limit(p[f"{axis}_slew_deg_s"] * TICK_S), change)
        for axis, change in (
            ("elevation", limit(p["elevation_acceleration_deg_s2"] * TICK_S**2)),
            ("pitch", math.inf),
            ("travel", limit(p["travel_acceleration_deg_s2"] * TICK_S**2)),
        )
    ]
    shaped_deg = np.empty((ticks, 2, 3, 3))
    of_firmware, of_reference = 0, 1
    sizes_deg = np.array((15.0, 15.0, 120.0))
    for tick in range(ticks):
        if tick % 500 == 0:
            # A step, or the pieces of a smooth path.
            ramp_ticks = int(rng.choice([0, 20, 300]))
            targets_deg = rng.uniform(-1.0, 1.0, 3) * sizes_deg
            assert shaper.aim([float(x) for x in np.radians(targets_deg)], ramp_ticks)
            for axis, target in zip(axes, targets_deg.tolist(), strict=True):
                axis.aim(target, ramp_ticks)
        shaped_deg[tick, of_firmware] = np.degrees(shaper.advance())
        shaped_deg[tick, of_reference] = [axis.advance() for axis in axes]
    return shaped_deg


@pytest.mark.medium
@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"travel_acceleration_deg_s2": 1.0, "travel_slew_deg_s": 0.5, "elevation_acceleration_deg_s2": 1.0},
        {
            "travel_acceleration_deg_s2": 2000.0,
            "travel_slew_deg_s": 200.0,
            "elevation_acceleration_deg_s2": 2000.0,
        },
    ],
    ids=["default", "slowest", "fastest"],
)
@pytest.mark.parametrize("seed", range(3))
def test_shaping_agrees_with_the_equations(seed: int, changes: dict[str, float]) -> None:
    both = shape_both(seed, 8000, **changes)
    worst = np.abs(both[:, 0] - both[:, 1]).max(axis=(0, 1))
    # Near its path a setpoint is rounded to 2^-32 rad, and by the tick rate that is 1e-5 deg/s.
    assert worst[0] < 1e-4  # deg
    assert worst[1] < 1e-3  # deg/s
    assert worst[2] < 1e-2  # deg/s2
