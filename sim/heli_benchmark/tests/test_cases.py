"""The cases hide what they say, in flights that can be flown; the logger zoo notices each mistake."""

import math
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
import pytest
from heli_host.data.arrays import Floats
from heli_host.data.flight import Flight
from heli_host.data.tables import read_table
from heli_host.declaration import AXES
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import catalogue
from heli_sim.rig import load_rig

from heli_benchmark.cases.clean import TRAIN_S, VALIDATE_S, Stream, clean_cases
from heli_benchmark.cases.disturbed import disturbed_cases
from heli_benchmark.effects.disturbances import NOISE
from heli_benchmark.effects.listed import LISTED, MEASURED_EFFECTS, MORE_LISTED, OTHER_FORMS, RandomTorque
from heli_benchmark.effects.unlisted import EQUATIONS, MakeUnlisted
from heli_benchmark.flights import plan
from heli_benchmark.plant import Moment, MujocoPlant
from heli_benchmark.runs.calm import CALM_EFFECTS, calm_case, false_names, unreported
from heli_benchmark.runs.equations import equation_cases, equation_summary, true_equation_effect
from heli_benchmark.runs.noise import NOISE_KINDS, NoiseCounts, noise_case
from heli_benchmark.runs.play import PLAY_AXES, PLAYS_deg, play_case
from heli_benchmark.runs.removed_effects import REMOVED, removed_effect_cases, removed_effect_summary
from heli_benchmark.runs.shocks import SHOCK_LAYOUTS, SLIP_EFFECT, SLIPS_m, is_named, shock_cases
from heli_benchmark.task import PARTS
from heli_benchmark.truth import hidden_in
from heli_benchmark.zoo.case import ImportTruth, Samples
from heli_benchmark.zoo.compare import ImportedFlight, mistakes, row_difference
from heli_benchmark.zoo.containers import write_log
from heli_benchmark.zoo.draw import draw_case
from heli_benchmark.zoo.flights import RECIPES
from heli_benchmark.zoo.words import MOTORS
from tests.model.flown import COMMON, MEASURED

NOT_HIDDEN = {
    "zero_offset.travel": "every place of travel is as good as any other",
    "elevation_drag_quadratic": "elevation turns too slowly for it to show under any disturbances",
    "removed.drag": "the multibody model has no such term",
    "removed.differential_travel": "the multibody model has no such term",
}


def test_every_effect_of_the_list_is_hidden_in_two_sizes_or_in_disturbances_or_gone() -> None:
    hidden = {*LISTED, *MORE_LISTED, *(form.effect for form in OTHER_FORMS.values())}
    assert hidden <= set(catalogue())
    removed = {id for id in catalogue() if id.startswith("removed.")}
    assert {*COMMON, *MEASURED, *removed} <= {*hidden, *MEASURED_EFFECTS, *PARTS, *NOT_HIDDEN}
    names = [name for case in clean_cases() for name, _ in case.effects]
    assert all(names.count(name) >= (1 if name.startswith("removed.") else 2) for name in hidden)
    in_disturbed = {name for case in disturbed_cases() for name, _ in case.effects}
    assert {*MEASURED_EFFECTS, *(part for parts in PARTS.values() for part in parts)} <= in_disturbed


def test_ten_rigs_and_more_have_nothing_hidden_and_differ() -> None:
    rigs = [case.rig() for case in clean_cases() if case.kind == "nothing"]
    assert len(rigs) >= 10
    gains = {rig["thrust_gain"].value for rig in rigs}
    assert len(gains) == len(rigs)
    assert max(gains) / min(gains) > 1.2


def test_cases_have_names_and_seeds_of_their_own() -> None:
    cases = clean_cases()
    assert len({case.name for case in cases}) == len({case.seed for case in cases}) == len(cases)


@pytest.mark.medium
def test_every_plan_can_be_flown() -> None:
    for case in clean_cases():
        for number, duration_s in enumerate((TRAIN_S, VALIDATE_S)):
            plan(case.name, duration_s, Stream.FLOWN_PLAN.rng(case.seed, number)).check({})


def test_the_catalogue_can_make_all_that_is_hidden() -> None:
    kinds = catalogue()
    for case in clean_cases():
        for effect in hidden_in(case, 0.6):
            made = kinds[effect.id].make(effect.start)
            assert {*effect.scalars, *(name for pair in effect.amplitudes for name in pair)} <= set(
                made.values
            )


def test_gusts_differ_between_flights_and_everything_else_is_the_same() -> None:
    case = next(case for case in clean_cases() if case.name == "random_torque.pitch-large")
    first, second = (case.hidden(number)[0] for number in (0, 1))
    assert isinstance(first, RandomTorque)
    assert first.truth == second.truth
    moments = [Moment(0.0, 0.0, np.zeros(2), np.zeros(2), np.zeros(3), np.zeros(3)) for _ in range(2)]
    for effect, at in zip((first, second), moments, strict=True):
        effect.torque(at)
    assert moments[0].torque_Nm[1] != moments[1].torque_Nm[1]


@pytest.mark.parametrize(
    "name", ["nothing-0", "off-slosh-large", "zero_offset.elevation-large", "removed.pendulum.pitch-gone"]
)
def test_the_rig_balances_as_its_masses_do(name: str) -> None:
    case = next(case for case in clean_cases() if case.name == name)
    rig = case.rig()
    plant = MujocoPlant(rig, case.hidden())
    v = {key: rig[key].value for key in ("M_f", "M_b", "M_w", "M_h", "M_l", "L_a", "L_b", "L_x", "g")}
    carried_kg = v["M_f"] + v["M_b"] + v["M_h"]
    lift_N = v["g"] * (carried_kg * v["L_a"] + v["M_l"] * v["L_x"] - v["M_w"] * v["L_b"]) / v["L_a"]
    assert plant.holding_torque_Nm()[0] == pytest.approx(lift_N * v["L_a"], abs=2e-6)


CASES = equation_cases()


def test_25_equations_and_more_come_in_two_sizes_with_unique_seeds() -> None:
    assert len(EQUATIONS) >= 25
    assert len(CASES) == 2 * len(EQUATIONS)
    others = [*clean_cases(), *disturbed_cases()]
    assert len({case.seed for case in (*CASES, *others)}) == len(CASES) + len(others)
    assert all(max(case.disturbances.gusts_Nm) > 0.0 for case in CASES)
    assert 0.4 < np.mean([bool(case.effects) for case in CASES]) < 0.6
    names = {case.name for case in CASES}
    assert names == {f"law-{law}-{size}" for law in EQUATIONS for size in ("small", "large")}


@pytest.mark.medium
@pytest.mark.parametrize("name", EQUATIONS)
def test_mujoco_flies_the_equation_that_the_reference_fit_uses(name: str) -> None:
    hidden = MakeUnlisted(name)(0.1, np.random.default_rng(1))
    effect = true_equation_effect(hidden)
    model_with_effect, plain_model = MultibodyModel((effect,)), MultibodyModel()
    rig = load_rig("makki2024")
    rng = np.random.default_rng(2)
    x, late = rng.uniform(-0.8, 0.8, 6), 0.3 if effect.states else 0.0
    volts = np.array([2.2, 2.6])
    thrust_N = rig["thrust_gain"].value * (volts - rig["dead_zone"].value)
    hidden._late = late
    at = Moment(0.0, 0.0, volts, thrust_N.copy(), x[:3], x[3:])
    hidden.thrust(at)
    hidden.torque(at)
    states = [*x, late] if effect.states else x
    u, t = ca.SX(volts), ca.SX(0.0)
    parameters = ca.SX(model_with_effect.parameter_values(rig))
    # Accelerations: the rates of the second three states.
    fitted = ca.evalf(model_with_effect.dynamics(ca.SX(states), u, parameters, t))[3:6]
    # The same forces, handed to the plain model as such.
    operands = plain_model.driven(ca.SX(x), u, ca.SX(plain_model.parameter_values(rig)), t)
    friction = [-rig[f"friction_{axis}"].value * w for axis, w in zip(_AXES, x[3:], strict=True)]
    steady = [rig[f"torque_{axis}"].value for axis in _AXES]
    torque = ca.SX(at.torque_Nm + np.array(friction) + np.array(steady))
    flown = ca.evalf(plain_model.acceleration(operands, ca.SX(at.thrust_N), torque))
    # What is remembered moves on by half a millisecond.
    np.testing.assert_allclose(np.asarray(fitted), np.asarray(flown), rtol=5e-3 if late else 1e-9, atol=1e-9)


_AXES = ("elevation", "pitch", "travel")


def test_twelve_listed_effects_are_taken_off_the_list_one_by_one() -> None:
    cases = removed_effect_cases()
    assert len(cases) >= 12
    assert len({case.seed for case in (*cases, *CASES, *clean_cases(), *disturbed_cases())}) == len(
        cases
    ) + len((*CASES, *clean_cases(), *disturbed_cases()))
    kinds = catalogue()
    for case in cases:
        name = case.effects[-1][0]
        assert {name, *REMOVED[name]} <= kinds.keys()
        assert not {name, *REMOVED[name]} & {listed for listed, _ in case.effects[:-1]}


def test_a_law_in_an_effects_place_counts_if_it_flies_and_takes_most_of_the_error() -> None:
    row: dict[str, Any] = {"expression": "x", "flies": "completed", "share": 0.85}
    rows: dict[str, dict[str, Any]] = {
        "good": row,
        "poor": row | {"share": 0.7},
        "falls": row | {"flies": "limit"},
        "none": {"expression": None, "share": 1.0},
        "died": {"failure": "died"},
    }
    summary = removed_effect_summary(rows)
    assert summary.startswith("effects removed: 4, equations proposed 3, flown 2")
    assert summary.endswith("of the effect 1")


def test_only_visible_equations_count_and_a_proposal_without_one_is_counted() -> None:
    rows: dict[str, dict[str, Any]] = {
        "law-a": {"visibility": {"off-a": 20.0}, "expression": "x", "correlation": 0.95, "error_ratio": 1.1},
        "law-b": {"visibility": {"off-b": 20.0}, "expression": None},
        "law-c": {"visibility": {"off-c": 9.0}, "expression": None},
        "w-nothing-1": {"visibility": {}, "expression": "y"},
        "w-nothing-2": {"failure": "died"},
    }
    summary = equation_summary(rows)
    assert "visible equations: 2, proposed 1" in summary
    assert "where none is hidden: 1 of 1" in summary


def test_seeds_go_through_all_effects_and_some_rates() -> None:
    cases = [calm_case(seed) for seed in range(7000, 7030)]
    assert {case.effects for case in cases} == set(CALM_EFFECTS)
    assert {case.rate_Hz for case in cases} == {100, 250, 500}
    assert len({case.name for case in cases}) == len(cases)
    assert not any(any(case.disturbances.gusts_Nm) for case in cases)


def test_effect_is_reported_if_named_or_too_small_and_other_names_are_false() -> None:
    delay_and_sag = calm_case(7003)
    result = {
        "causes": [{"effect": "input_delay"}, {"effect": "thrust_fade"}],
        "too_small": [{"effect": "supply_fade"}],
    }
    assert false_names(delay_and_sag, result) == ["thrust_fade"]
    assert unreported(delay_and_sag, result) == ["supply_sag"]
    result["too_small"].append({"effect": "supply_sag"})
    assert unreported(delay_and_sag, result) == []


def test_twenty_seeds_give_each_kind_twice_alone_and_with_one_and_two_causes() -> None:
    for first in (8000, 8100):
        cases = [noise_case(seed) for seed in range(first, first + 20)]
        counts = Counter((case.kind, len(case.effects)) for case in cases)
        assert counts == {
            (kind, causes): 2 if causes == 0 else 1 for kind in NOISE_KINDS for causes in range(3)
        }
    assert noise_case(8003) == noise_case(8003)


def _moment(flight_s: float, thrust_N: float = 2.0) -> Moment:
    return Moment(flight_s, flight_s, np.full(2, 5.0), np.full(2, thrust_N), np.zeros(3), np.zeros(3))


def _torques_Nm(kind: str, thrust_N: float = 2.0) -> Floats:
    """Torques about the three axes every 10 ms."""
    hidden = NOISE[kind](np.random.default_rng(5))
    rows = []
    for flight_s in np.arange(0.0, 100.0, 0.01):
        at = _moment(float(flight_s), thrust_N)
        for effect in hidden:
            effect.torque(at)
        rows.append(at.torque_Nm)
    return np.array(rows)


@pytest.mark.medium
def test_bursts_and_kicks_are_rarer_and_larger_than_gusts() -> None:
    def kurtosis(values: Floats) -> float:
        return float(np.mean(values**4) / np.mean(values**2) ** 2)

    steady, bursts, kicks = (_torques_Nm(kind)[:, 1] for kind in ("thrust", "bursts", "kicks"))
    assert kurtosis(steady) < 4.0 < min(kurtosis(bursts), kurtosis(kicks))
    assert np.allclose(_torques_Nm("thrust", 4.0), 2.0 * _torques_Nm("thrust", 2.0))


def test_a_supply_that_wanders_changes_both_voltages_alike() -> None:
    hidden = NOISE["supply"](np.random.default_rng(5))
    shares = []
    for flight_s in np.arange(0.0, 100.0, 0.5):
        at = _moment(float(flight_s))
        for effect in hidden:
            effect.volts(at)
        assert at.volts_V[0] == at.volts_V[1]
        shares.append(at.volts_V[0] / 5.0 - 1.0)
    assert 0.01 < np.std(shares) < 0.06


def test_counts_are_of_explained_flights_named_causes_and_false_names() -> None:
    nothing, one_cause = noise_case(8000), noise_case(8010)
    counts = NoiseCounts()
    counts.add(nothing, {"verdict": "explained", "causes": []}, 4.0)
    counts.add(nothing, {"verdict": "unexplained", "causes": []}, 4.0)
    hidden = one_cause.effects[0][0]
    counts.add(
        one_cause, {"verdict": "cause_found", "causes": [{"effect": hidden}, {"effect": "other"}]}, 10.0
    )
    assert str(counts) == (
        "explained 1 of 2, causes named 1 of 1, false names 1, all named but unexplained 1 of 3, 6.0 s"
    )


def test_nine_consecutive_seeds_have_each_axis_with_each_size_once() -> None:
    for first in (9000, 9108):
        cases = [play_case(seed) for seed in range(first, first + 9)]
        causes = [case.effects[0] for case in cases]
        nearest_deg = [
            PLAYS_deg[int(np.argmin(np.abs(np.divide(PLAYS_deg, deg) - 1.0)))] for _, deg in causes
        ]
        expected = {(f"backlash.{axis}", size) for axis in PLAY_AXES for size in PLAYS_deg}
        assert set(zip((name for name, _ in causes), nearest_deg, strict=True)) == expected
        strengths = [case.disturbances.gusts_Nm for case in cases]
        assert sorted(strengths.count(strength) for strength in set(strengths)) == [3, 3, 3]


def test_a_case_is_drawn_from_its_seed_alone() -> None:
    assert play_case(9003) == play_case(9003)
    assert play_case(9003) != play_case(9012)


def test_a_seed_gives_twelve_cases_whose_slip_comes_where_the_layout_says() -> None:
    cases = list(shock_cases(5000))
    assert len(cases) == len({case.name for case in cases}) == 2 * len(SLIPS_m) * len(SHOCK_LAYOUTS)
    assert cases == list(shock_cases(5000)) != list(shock_cases(5001))
    for case in cases:
        comes = [math.isfinite(moment_s) for moment_s in case.moments_s]
        assert comes == {"fit": [True, False], "both": [True, True], "second": [False, True]}[case.layout]
        assert case.moments_s[0] != case.moments_s[1]
    assert sum(any(case.disturbances.gusts_Nm) for case in cases) == 6


def test_a_slip_counts_as_named_if_it_is_the_only_cause_and_of_the_right_size() -> None:
    case = next(case for case in shock_cases(5000) if case.slip_m == 0.01)

    def result(*causes: tuple[str, float]) -> dict[str, object]:
        number = {f"{SLIP_EFFECT}_m": {"value": 0.0, "std": 1e-4, "unit": "m"}}
        return {
            "causes": [
                {
                    "effect": effect,
                    "parameters": {name: {**value, "value": size} for name, value in number.items()},
                }
                for effect, size in causes
            ]
        }

    assert is_named(case, result((SLIP_EFFECT, 0.0102)))
    assert not is_named(case, result((SLIP_EFFECT, 0.0104)))
    assert not is_named(case, result())
    assert not is_named(case, result((SLIP_EFFECT, 0.01), ("rotor_lag", 0.01)))


STEP_S = 0.02


def made_flight(step_s: float = STEP_S) -> Flight:
    """A motion with several frequencies, whose voltages change from row to row."""
    t_s = step_s * np.arange(round(40.0 / step_s), dtype=np.float64)
    wave = [
        np.sin(2.0 * np.pi * (t_s / period + phase))
        for period, phase in ((7.1, 0.0), (2.9, 0.2), (11.3, 0.5))
    ]
    noise = np.random.default_rng(1).standard_normal((2, t_s.size))
    front = 1.8 + 0.3 * wave[1] + 0.1 * noise[0]
    back = 1.6 - 0.3 * wave[1] + 0.1 * noise[1]
    return Flight(t_s, front, back, 0.15 * wave[0] - 0.1, 0.2 * wave[1], 0.6 * wave[2] + 0.05 * t_s)


def truth_of(flight: Flight) -> ImportTruth:
    samples = {axis: Samples(flight.t_s, getattr(flight, f"{axis}_rad")) for axis in AXES}
    samples |= {motor: Samples(flight.t_s, getattr(flight, f"{motor}_V")) for motor in MOTORS}
    return ImportTruth(samples, len(flight), 0.004 + 0.6 * STEP_S, dict.fromkeys((*AXES, *MOTORS), 1e-3))


def imported_of(flight: Flight) -> ImportedFlight:
    columns = {axis: getattr(flight, f"{axis}_rad") for axis in AXES}
    columns |= {motor: getattr(flight, f"{motor}_V") for motor in MOTORS}
    return ImportedFlight(flight.t_s + 3.0, columns)


def changed(name: str, change: Callable[[Floats], Floats]) -> Callable[[ImportedFlight], ImportedFlight]:
    return lambda imported: replace(
        imported, columns={**imported.columns, name: change(imported.columns[name].copy())}
    )


def with_spike(values: Floats) -> Floats:
    values[702] += 0.12
    return values


def late(values: Floats) -> Floats:
    return np.roll(values, 6)


def cut(imported: ImportedFlight) -> ImportedFlight:
    return ImportedFlight(
        imported.t_s[:1500], {name: values[:1500] for name, values in imported.columns.items()}
    )


def exchanged(imported: ImportedFlight) -> ImportedFlight:
    columns = dict(imported.columns)
    columns["front"], columns["back"] = columns["back"], columns["front"]
    return replace(imported, columns=columns)


@pytest.mark.parametrize(
    ("change", "mistake"),
    [
        (changed("elevation", lambda values: -values), "elevation: opposite sign"),
        (changed("pitch", lambda values: 1.1 * values), "pitch: scale 1.1"),
        (changed("travel", lambda values: values[::-1].copy()), "travel: "),
        (changed("elevation", lambda values: values + 0.1), "elevation: zero differs by 5.7 deg"),
        (changed("pitch", with_spike), "pitch: a row differs by 6.9 deg"),
        (changed("pitch", late), "pitch: values differ"),
        (changed("front", lambda values: 0.9 * values), "front: scale 0.9"),
        (changed("back", late), "back: late by 0.1"),
        (exchanged, "mirror: front and back are exchanged"),
        (cut, "rows: 10.0 of 40.0 s are not imported"),
        (lambda imported: replace(imported, t_s=1.1 * imported.t_s), "clock: 44.0 s instead of 40.0 s"),
    ],
)
def test_each_mistake_is_noticed(change: Callable[[ImportedFlight], ImportedFlight], mistake: str) -> None:
    flight = made_flight()
    noticed = mistakes([change(imported_of(flight))], truth_of(flight))
    assert any(item.startswith(mistake) for item in noticed), noticed


def test_a_right_import_has_no_mistake_and_its_clock_may_begin_anywhere() -> None:
    flight = made_flight()
    imported = imported_of(flight)
    assert mistakes([imported], truth_of(flight)) == []
    halves = [
        ImportedFlight(
            imported.t_s[part] - imported.t_s[part][0], {k: v[part] for k, v in imported.columns.items()}
        )
        for part in (slice(0, 900), slice(900, None))
    ]
    assert mistakes(halves, truth_of(flight)) == []
    assert row_difference(halves, truth_of(flight)) == 0


@pytest.mark.parametrize("late_rows", [0, 2])
def test_voltages_of_a_slow_quantised_part_are_late_only_if_they_were_moved(late_rows: int) -> None:
    exact = made_flight(0.01)
    counts = {f"{axis}_rad": 0.003 * np.round(getattr(exact, f"{axis}_rad") / 0.003) for axis in AXES}
    flight = replace(exact, **counts)
    part = imported_of(flight)
    columns = {name: values[2850:].copy() for name, values in part.columns.items()}
    for motor in MOTORS:
        columns[motor] = np.roll(columns[motor], late_rows)
    truth = replace(truth_of(flight), lost_s=28.5, time_tolerance_s=0.01)
    noticed = mistakes([ImportedFlight(part.t_s[2850:], columns)], truth)
    expected = [f"{motor}: late by 0.02 s" for motor in MOTORS] if late_rows else []
    assert noticed == expected


@pytest.mark.slow
def test_a_drawn_case_is_a_file_with_the_rows_of_its_truth(tmp_path: Path) -> None:
    flights = [made_flight(0.002)] * len(RECIPES)
    containers = set()
    for number in range(4):
        case = draw_case(3, number, RECIPES, flights)
        assert draw_case(3, number, RECIPES, flights).traits == case.traits
        containers.add(case.container)
        if not case.row_faults and not case.recording.clock_texts:
            table = read_table(write_log(case, tmp_path / str(number)))
            assert len(table.aligned()) == pytest.approx(case.truth.row_count, abs=2)
    assert len(containers) > 1
