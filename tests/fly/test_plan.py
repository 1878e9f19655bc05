"""Plans are read strictly, checked against the board before anything moves, and evaluate as written."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from heli_host.data.response import TAKE_OFF
from heli_host.declaration import PARAMS
from heli_host.errors import PlanError
from heli_host.fly.plan import Plan, load_plan, plan_names, take_off
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.running.long import samples

DEFAULTS = {spec.name: spec.default for spec in PARAMS}


def plan(*segments: str, head: str = "") -> Plan:
    return Plan.parse(head + "".join(f"[[segment]]\n{segment}\n" for segment in segments), "a.toml")


def test_the_built_in_plans_can_be_flown_on_the_declared_defaults() -> None:
    assert {"hover", "sine", "step", "identify"} <= set(plan_names())
    for name in plan_names():
        built_in = load_plan(name)
        built_in.check(DEFAULTS)
        assert built_in.title


def test_a_plan_begins_and_ends_where_it_says() -> None:
    flown = plan(
        'kind = "hold"\nduration_s = 2',
        'kind = "step"\ntravel_deg = 10\nduration_s = 3',
        'kind = "ramp"\ntravel_deg = -10\nelevation_deg = 5\nrate_deg_s = 4',
        'kind = "land"',
        head="[start]\nelevation_deg = -3\n",
    )
    assert flown.duration_s == pytest.approx(2 + 3 + 5)
    assert flown.evaluate(-1.0) == (-3.0, 0.0, 0.0)
    assert flown.evaluate(1.99) == (-3.0, 0.0, 0.0)
    assert flown.evaluate(2.0) == (-3.0, 0.0, 10.0)
    assert flown.evaluate(7.5) == pytest.approx((1.0, 0.0, 0.0))
    assert flown.evaluate(99.0) == pytest.approx((5.0, 0.0, -10.0))


@pytest.mark.parametrize(
    "motion",
    [
        'kind = "hold"\nduration_s = 4',
        'kind = "step"\ntravel_deg = 5\nduration_s = 4',
        'kind = "sine"\ntravel_amplitude_deg = 5\nperiod_s = 4\nduration_s = 4',
        'kind = "waypoints"\npoints = [{ at_s = 4, travel_deg = 5 }]',
    ],
)
def test_a_segment_may_be_excited_while_it_moves(motion: str) -> None:
    signal = 'excite = { signal = "prbs", front_V = 0.3, stop_Hz = 8, seed = 3 }'
    plain, excited = plan(motion), plan(f"{motion}\n{signal}")
    assert plain.segments[0].excitation is None
    added = excited.route.pieces[0].excitation
    assert added is not None
    assert (added.signal, added.front_V, added.back_V, added.duration_s, added.seed) == ("prbs", 0.3, 0, 4, 3)
    t_s = np.linspace(0.0, 4.0, 9)
    np.testing.assert_array_equal(plain.evaluate(t_s), excited.evaluate(t_s))


@pytest.mark.parametrize(
    ("excite", "message"),
    [
        ('"prbs"', "excite is not a table"),
        ('{ signal = "prbs", front_V = 1 }', "stop_Hz is missing"),
        ('{ signal = "step", front_V = 1, duration_s = 2 }', "unknown key 'duration_s'"),
        ('{ signal = "step" }', "it excites no motor"),
    ],
)
def test_a_wrong_excitation_of_a_moving_segment_is_named(excite: str, message: str) -> None:
    with pytest.raises(PlanError, match=message) as caught:
        plan(f'kind = "hold"\nduration_s = 4\nexcite = {excite}')
    assert "segment 1 (hold)" in str(caught.value)


def test_setpoints_of_a_plan_depend_only_on_the_time() -> None:
    sine = load_plan("sine")
    t_s = np.linspace(-1.0, sine.duration_s + 1.0, 333)
    many = np.column_stack(sine.evaluate(t_s))
    # One by one, and backwards: no call changes what the next one returns.
    single = np.array([sine.evaluate(float(moment)) for moment in t_s[::-1]])[::-1]
    np.testing.assert_array_equal(many, single)
    np.testing.assert_array_equal(many, np.column_stack(sine.evaluate(t_s)))


def test_a_sine_begins_and_ends_at_the_present_point_without_a_jump_in_rate() -> None:
    flown = plan(
        'kind = "step"\ntravel_deg = 10\nduration_s = 1',
        'kind = "sine"\ntravel_amplitude_deg = 20\ntravel_period_s = 10\nduration_s = 35',
        'kind = "hold"\nduration_s = 1',
    )
    t_s = np.arange(1.0, 37.0, 0.01)
    travel_deg = flown.evaluate(t_s).travel_deg
    rate_deg_s = np.diff(travel_deg) / 0.01
    assert travel_deg[0] == 10.0 and travel_deg[-1] == pytest.approx(10.0)
    assert abs(rate_deg_s[0]) < 0.1 and abs(rate_deg_s[-101]) < 0.1
    assert np.max(np.abs(np.diff(rate_deg_s) / 0.01)) < 1.4 * 20 * (2 * np.pi / 10) ** 2
    assert np.max(np.abs(rate_deg_s)) <= 20 * 2 * np.pi / 10 * 1.001
    middle = (t_s > 8) & (t_s < 28)
    np.testing.assert_allclose(
        travel_deg[middle], 10 + 20 * np.sin(2 * np.pi * (t_s[middle] - 1) / 10), atol=1e-9
    )


def test_a_frequency_is_the_inverse_of_a_period() -> None:
    by_frequency = plan('kind = "sine"\nelevation_amplitude_deg = 3\nfrequency_Hz = 0.1\nduration_s = 30')
    other = plan('kind = "sine"\nelevation_amplitude_deg = 3\nelevation_period_s = 10\nduration_s = 30')
    t_s = np.linspace(0, 30, 100)
    np.testing.assert_allclose(by_frequency.evaluate(t_s).elevation_deg, other.evaluate(t_s).elevation_deg)


def test_waypoints_are_reached_on_time_axis_by_axis() -> None:
    points = (
        "points = [{at_s = 4, travel_deg = 12}, {at_s = 6, elevation_deg = 6}, {at_s = 10, travel_deg = -4}]"
    )
    for path in ("smooth", "straight"):
        flown = plan(f'kind = "waypoints"\npath = "{path}"\n{points}\nduration_s = 12')
        assert flown.evaluate(4.0).travel_deg == pytest.approx(12.0)
        assert flown.evaluate(6.0).elevation_deg == pytest.approx(6.0)
        assert flown.evaluate(10.0) == pytest.approx((6.0, 0.0, -4.0))
        assert flown.evaluate(2.0).travel_deg == pytest.approx(6.0) and flown.evaluate(
            3.0
        ).elevation_deg == pytest.approx(3.0)
    assert flown.duration_s == 12.0


def test_take_off_comes_first_and_later_plans_begin_where_the_last_one_ends() -> None:
    first = plan('kind = "step"\ntravel_deg = 10\nduration_s = 5')
    second = plan('kind = "hold"\nduration_s = 5', head="[start]\nelevation_deg = 4\nrate_deg_s = 2\n")
    route = take_off([first, second], DEFAULTS, np.array([-25.0, 0.4, 3.0]))
    assert route.evaluate(np.array([0.0]))[0].tolist() == [-25.0, 0.0, 3.0]
    starts_s = [piece.start_s for piece in route.pieces if piece.phase == first.name]
    assert starts_s[0] == pytest.approx(25 / 8 + 4)
    assert route.end_deg.tolist() == [4.0, 0.0, 10.0]
    assert [piece.phase for piece in route.pieces][:2] == [TAKE_OFF, TAKE_OFF]
    assert route.duration_s == pytest.approx(25 / 8 + 4 + 5 + 2 + 5)


def test_pitch_is_commanded_only_while_travel_is_free() -> None:
    free = plan('kind = "step"\npitch_deg = 5\nduration_s = 2', head='axes = ["elevation", "pitch"]\n')
    assert free.evaluate(1.0) == (0.0, 5.0, 0.0) and free.axes == ("elevation", "pitch")
    with pytest.raises(PlanError, match="closes travel, whose loop commands pitch"):
        plan('kind = "step"\npitch_deg = 5\nduration_s = 2')


HOLD = '[[segment]]\nkind = "hold"\nduration_s = 5\n'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("title = ", "a.toml is not TOML"),
        ("", "a.toml: it has no segment"),
        ("segment = 3", "it has no segment"),
        ('titel = "x"\n' + HOLD, "unknown key 'titel'; did you mean 'title'?"),
        ("title = 3\n" + HOLD, "title is 3, not a text"),
        ("start = 3\n" + HOLD, "[start] is not a table"),
        ("[start]\nrate = 3\n" + HOLD, "a.toml, start: unknown key 'rate'; name the unit: rate_deg_s"),
        ('axes = ["elevation", "yaw"]\n' + HOLD, "not a list of different axes"),
        ('axes = ["travel"]\n' + HOLD, "axes lacks elevation or pitch"),
        (
            HOLD.replace("duration_s", "duration"),
            "segment 1 (hold): unknown key 'duration'; name the unit: duration_s",
        ),
        (HOLD.replace("hold", "hover"), "segment 1: kind is 'hover'"),
        (HOLD.replace('kind = "hold"', ""), "segment 1: kind is missing"),
        (HOLD.replace("5", "-5"), "duration_s is -5; give more than 0"),
        (HOLD.replace("5", "0"), "duration_s is 0; give more than 0"),
        (HOLD.replace("5", "nan"), "duration_s is nan; give a finite number"),
        (HOLD.replace("5", "inf"), "duration_s is inf; give a finite number"),
        (HOLD.replace("5", "true"), "duration_s is True, not a number"),
        (HOLD.replace("5", '"5"'), "duration_s is '5', not a number"),
        (HOLD + "[[segment]]\nkind = 'step'\nduration_s = 3\n", "segment 2 (step): it moves no axis"),
        ("[[segment]]\nkind = 'ramp'\ntravel_deg = 3\n", "it needs duration_s or rate_deg_s, one of them"),
        ("[[segment]]\nkind = 'sine'\nduration_s = 3\n", "it moves no axis; add travel_amplitude_deg"),
        ("[[segment]]\nkind='sine'\nduration_s=3\ntravel_amplitude_deg=3\n", "travel_period_s is missing"),
        (
            "[[segment]]\nkind='sine'\nduration_s=3\ntravel_amplitude_deg=3\nperiod_s=9\nfrequency_Hz=1\n",
            "both period_s and frequency_Hz are given",
        ),
        ("[[segment]]\nkind='waypoints'\n", "points is not a list of points"),
        ("[[segment]]\nkind='waypoints'\npoints=[{at_s=1,travel=3}]\n", "point 1: unknown key 'travel'"),
        (
            "[[segment]]\nkind='waypoints'\npoints=[{at_s=5,travel_deg=3},{at_s=4,travel_deg=3}]\n",
            "point 2: at_s is 4, not behind the point before it",
        ),
        ("[[segment]]\nkind='excite'\nsignal='noise'\nduration_s=3\nfront_V=0.2\n", "signal is 'noise'"),
        ("[[segment]]\nkind='excite'\nsignal='step'\nduration_s=3\n", "it excites no motor"),
        (
            "[[segment]]\nkind='excite'\nsignal='chirp'\nduration_s=3\nfront_V=0.2\nstart_Hz=1\n",
            "stop_Hz is missing",
        ),
        (
            "[[segment]]\nkind='excite'\nsignal='chirp'\nduration_s=3\nfront_V=0.2\nstart_Hz=3\nstop_Hz=1\n",
            "make stop_Hz the higher one",
        ),
        (
            "[[segment]]\nkind='excite'\nsignal='prbs'\nduration_s=3\nfront_V=0.2\nstop_Hz=9\nseed=0\n",
            "seed is 0",
        ),
        ('[[segment]]\nkind = "land"\n' + HOLD, "segment 1 (land): another segment follows"),
    ],
)
def test_a_mistake_is_named_with_its_segment_key_and_remedy(text: str, message: str) -> None:
    with pytest.raises(PlanError) as raised:
        Plan.parse(text, "a.toml")
    assert message in str(raised.value), str(raised.value)
    assert str(raised.value).startswith("a.toml") and "\n" not in str(raised.value) and raised.value.remedy


@pytest.mark.parametrize(
    ("segment", "message"),
    [
        (
            "kind='step'\ntravel_deg=171\nduration_s=2",
            "travel_deg takes travel to 171 degrees; stay at or below 170",
        ),
        ("kind='step'\nelevation_deg=23\nduration_s=2", "stay at or below 22 (elevation_max_deg - 2)"),
        ("kind='step'\nelevation_deg=-24\nduration_s=2", "stay at or above -23 (elevation_rest_deg + 2)"),
        (
            "kind='sine'\nelevation_amplitude_deg=25\nperiod_s=60\nduration_s=60",
            "elevation_amplitude_deg takes elevation to 25",
        ),
        ("kind='ramp'\ntravel_deg=90\nduration_s=1", "duration_s moves travel by 90 degrees per second"),
        (
            "kind='sine'\ntravel_amplitude_deg=25\nperiod_s=2\nduration_s=20",
            "the board's travel_slew_deg_s is",
        ),
        ("kind='waypoints'\npoints=[{at_s=1,travel_deg=90}]", "at_s moves travel by 135 degrees per second"),
        (
            "kind='excite'\nsignal='step'\nfront_V=3\nduration_s=2",
            "front_V is 3; keep it within 2 (excitation_max_V)",
        ),
        ("kind='excite'\nsignal='step'\nfront_V=1\nduration_s=200", "keep it within 120 (excitation_max_s)"),
    ],
)
def test_what_the_board_would_refuse_is_refused_before(segment: str, message: str) -> None:
    with pytest.raises(PlanError) as raised:
        plan('kind = "hold"\nduration_s = 1', segment).check(DEFAULTS)
    assert message in str(raised.value), str(raised.value)
    assert str(raised.value).startswith("a.toml, segment 2 (")


def test_limits_come_from_the_board_and_not_from_the_defaults() -> None:
    flown = plan('kind = "step"\ntravel_deg = 100\nduration_s = 2')
    flown.check(DEFAULTS)
    with pytest.raises(PlanError, match="at or below 85"):
        flown.check({**DEFAULTS, "travel_max_deg": 90.0})
    with pytest.raises(PlanError, match="at or below 170"):
        plan('kind = "ramp"\ntravel_deg = 172\nrate_deg_s = 5').check(DEFAULTS, np.array([0.0, 0.0, 160.0]))


def test_plans_that_close_different_axes_do_not_fit_one_flight() -> None:
    first = plan('kind = "hold"\nduration_s = 1')
    other = plan('kind = "hold"\nduration_s = 1', head='axes = ["elevation", "pitch"]\n')
    with pytest.raises(PlanError, match="one after the other"):
        take_off([first, other], DEFAULTS, np.zeros(3))


def test_a_plan_is_found_by_name_or_file(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text(HOLD)
    assert load_plan(tmp_path / "mine.toml").name == "mine"
    with pytest.raises(PlanError, match="did you mean hover"):
        load_plan("hovr")
    (tmp_path / "bad.toml").write_bytes(b"\xff\xfa")
    with pytest.raises(PlanError, match="UTF-8"):
        load_plan(tmp_path / "bad.toml")
    with pytest.raises(PlanError, match="cannot read"):
        load_plan(tmp_path)


KEYS = [
    "kind", "title", "axes", "start", "segment", "points", "signal", "path", "seed", "at_s",
    "duration_s", "rate_deg_s", "period_s", "frequency_Hz", "front_V", "back_V", "start_Hz",
    "stop_Hz", "elevation_deg", "pitch_deg", "travel_deg", "travel_amplitude_deg",
    "elevation_period_s", "settle_s", "x",
]  # fmt: skip
WORDS = [
    "hold", "step", "ramp", "sine", "waypoints", "excite", "land", "smooth", "straight", "prbs",
    "chirp", "elevation", "pitch", "travel",
]  # fmt: skip
LEAVES = st.one_of(
    st.floats(allow_nan=True, allow_infinity=True),
    st.floats(0.1, 60.0),
    st.integers(-(10**20), 10**20),
    st.booleans(),
    st.text(max_size=8),
    st.sampled_from(WORDS),
)
VALUES = st.recursive(
    LEAVES,
    lambda inner: st.one_of(
        st.lists(inner, max_size=3), st.dictionaries(st.sampled_from(KEYS), inner, max_size=4)
    ),
    max_leaves=12,
)


def toml(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return '"' + "".join(c if c.isalnum() else f"\\U{ord(c):08x}" for c in value if c.isprintable()) + '"'
    if isinstance(value, list):
        return "[" + ", ".join(toml(item) for item in value) + "]"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key} = {toml(item)}" for key, item in value.items()) + "}"
    return repr(value)


@pytest.mark.slow
@settings(max_examples=samples(300, 80), deadline=None)
@given(
    head=st.dictionaries(st.sampled_from(KEYS), VALUES, max_size=2),
    segments=st.lists(
        st.tuples(st.sampled_from(WORDS[:7]), st.dictionaries(st.sampled_from(KEYS), VALUES, max_size=5)),
        max_size=3,
    ),
)
def test_no_table_raises_anything_but_a_plan_error(
    head: dict[str, Any], segments: list[tuple[str, dict[str, Any]]]
) -> None:
    rows = [{**keys, "kind": kind} for kind, keys in segments]
    text = "\n".join(f"{key} = {toml(value)}" for key, value in head.items() if key != "segment")
    _survives(text + f"\nsegment = {toml(rows)}\n")


@pytest.mark.medium
@settings(max_examples=samples(200, 60), deadline=None)
@given(st.text(max_size=200))
def test_no_text_raises_anything_but_a_plan_error(text: str) -> None:
    _survives(text)
    _survives(HOLD + text)


def _survives(text: str) -> None:
    try:
        read = Plan.parse(text, "a.toml")
        read.check(DEFAULTS)
    except PlanError as error:
        assert "\n" not in str(error) and str(error).startswith("a.toml")
        return
    points = np.column_stack(read.evaluate(np.linspace(-1.0, read.duration_s + 1.0, 50)))
    assert np.isfinite(points).all()
    assert np.all(np.abs(points[:, 2]) <= 170.0 + 1e-6) and np.all(points[:, 0] <= 22.0 + 1e-6)
