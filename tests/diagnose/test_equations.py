"""Terms of a proposed law are the same in all their notations, and their units fit together."""

import html
import json
from collections import Counter
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import casadi as ca
import numpy as np
import pytest
from heli_host.data.log.table import write_csv
from heli_lab.diagnose import summary, to_json
from heli_lab.explain.candidates import Candidate, CandidateSignals, ExtendedModel, typical_candidate
from heli_lab.explain.comparison import Hypothesis, ModelComparison
from heli_lab.explain.proposal import effect_file, expression
from heli_lab.explain.regression import (
    EquationRefits,
    EquationSearch,
    ListedEffects,
    RefittedEquation,
    discover,
    free_name,
)
from heli_lab.explain.residuals import failing_regions
from heli_lab.explain.screening import Screening, score_of
from heli_lab.explain.term_scores import (
    ScoredTermGroup,
    TermSignals,
    count_by_complexity,
    groups,
    score_groups,
)
from heli_lab.explain.terms import (
    FORMS,
    NAME,
    SYMBOLS,
    Equation,
    EquationTerm,
    Factor,
    Term,
    TermGroup,
    Unit,
    equation_effect,
    rotor_signs,
)
from heli_lab.explain.thresholds import FALSE_DISCOVERY_RATE
from heli_lab.fit.records import prepare
from heli_sim.model import MultibodyModel
from heli_sim.model.effect import AXES
from heli_sim.model.effects import RotorLag, catalogue, effects_of
from heli_sim.rig import load_rig, write_rig
from hypothesis import given
from hypothesis import strategies as st
from scipy.special import ndtr
from scipy.stats import false_discovery_control

from tests.cli.terminal import Terminal
from tests.diagnose.hidden import flights
from tests.diagnose.test_causes import diagnosed

pytestmark = pytest.mark.diagnosis

SPANS = dict.fromkeys(SYMBOLS, (-1.0, 1.2))
ALL_GROUPS = groups(SPANS)
FIRST_OF_FORM = {
    factor.form: group
    for group in reversed(ALL_GROUPS)
    for term in group.terms
    for factor in term.term.factors
}
# A sample of the grammar: every 97th group, one with each function, and those with a lag.
SAMPLE = (
    *ALL_GROUPS[::97],
    *FIRST_OF_FORM.values(),
    *(group for group in ALL_GROUPS if any(f.lag_filter for term in group.terms for f in term.term.factors)),
)[:76]


def state_of(size: int, seed: int) -> list[float]:
    """Return random states."""
    return list(np.random.default_rng(seed).uniform(-0.6, 0.6, size))


def test_no_product_is_tried_twice() -> None:
    products = [(term.channel, frozenset(term.term.factors)) for group in ALL_GROUPS for term in group.terms]
    assert [product for product, count in Counter(products).items() if count > 1] == []


@given(st.tuples(*(st.integers(-3, 3) for _ in range(5))))
def test_a_unit_is_read_back_as_it_was_written(exponents: tuple[int, ...]) -> None:
    unit = Unit(exponents)
    assert Unit.parse(str(unit)) == unit


@pytest.mark.parametrize(
    ("channel", "factors", "unit"),
    [
        ("torque.pitch", (Factor("linear", "elevation"),), "N m/rad"),
        ("torque.travel", (Factor("signed_square", "travel_rate"),), "N m s2/rad2"),
        ("torque.elevation", (Factor("sin", "travel", (("k", 2.0),)),), "N m"),
        ("thrust.both", (Factor("linear", "own_thrust"), Factor("linear", "travel_rate")), "s/rad"),
        ("thrust.front", (Factor("linear", "own_thrust"),), "1"),
        ("measurement.pitch", (Factor("square", "travel"),), "1/rad"),
    ],
)
def test_unit_of_coefficient_times_term_is_the_unit_of_the_channel(
    channel: str, factors: tuple[Factor, ...], unit: str
) -> None:
    assert str(EquationTerm(channel, Term(factors)).coefficient_unit) == unit


@pytest.mark.parametrize("quantity", ["travel_rate", "thrust", "own_voltage", "time"])
def test_sine_of_a_quantity_that_is_not_an_angle_is_refused(quantity: str) -> None:
    with pytest.raises(ValueError, match="sin of"):
        Factor("sin", quantity, (("k", 1.0),))


def test_every_function_is_tried() -> None:
    assert FIRST_OF_FORM.keys() == FORMS.keys()


def test_grammar_has_thousands_of_distinct_terms_on_all_channels() -> None:
    keys = [group.key for group in ALL_GROUPS]
    assert len(keys) == len(set(keys)) > 2000
    assert {group.terms[0].channel.partition(".")[0] for group in ALL_GROUPS} == {
        "torque",
        "thrust",
        "voltage",
        "measurement",
    }
    counts = count_by_complexity(ALL_GROUPS)
    assert list(counts.values()) == sorted(counts.values())
    assert max(counts.values()) == len(ALL_GROUPS)
    assert all(len(group.terms) <= 2 and len(group.terms[0].term.factors) <= 3 for group in ALL_GROUPS)


def test_sympy_text_of_a_term_has_the_values_along_a_flight() -> None:
    import sympy

    numbers = np.random.default_rng(1).uniform(0.2, 1.0, len(SYMBOLS))
    values = dict(zip(SYMBOLS, numbers, strict=True))
    for group in SAMPLE:
        equation = Equation(group.terms)
        parameters = dict.fromkeys(equation.coefficient_names, 0.7) | {
            inner.name: inner.value for inner in equation.inner_parameters()
        }
        channel = equation.channels[0]
        names = {name: sympy.Symbol(name) for name in (*values, *parameters)}
        # All quantities are constant: their lagged values are equal to them.
        local = {**names, "lag": lambda x, _s: x, "washout": lambda _x, _s: sympy.Integer(0)}
        read = sympy.sympify(expression(equation, channel), locals=local).subs({**values, **parameters})
        expected = 0.0
        for term in equation.terms:
            value = 0.7
            for factor in term.term.factors:
                filtered = 0.0 if factor.lag_filter == "washout" else values[factor.quantity]
                value *= float(factor.value(np, filtered))
            expected += value
        assert float(read) == pytest.approx(expected, rel=1e-9, abs=1e-12), group.key


@pytest.mark.parametrize("number", range(0, len(SAMPLE), 6))
def test_written_effect_file_has_the_fitted_equation(number: int, tmp_path: Path) -> None:
    # An equation of two groups on different channels, together with a lag of the rotors.
    first, second = SAMPLE[number], SAMPLE[-1 - number]
    equation = Equation(tuple(dict.fromkeys((*first.terms, *second.terms))))
    effect = equation_effect(equation, dict.fromkeys(equation.coefficient_names, 1.0))
    values = {**effect.values}
    for i, name in enumerate(equation.coefficient_names):
        values[f"{NAME}_{name}"] = 0.1 + 0.03 * i
    numbers = {
        q.name.removeprefix(f"{NAME}_"): (values[q.name], 0.01 if q.name in effect.priors else 0.0, q.unit)
        for q in effect.parameters
    }
    path = tmp_path / "proposed.py"
    path.write_text(effect_file(effect, numbers, "From a test."), encoding="utf-8")
    kind = catalogue((path,))[NAME]
    lag = catalogue()["rotor_lag"]
    results = []
    for variant in (effect, kind.make(kind.typical)):
        model = MultibodyModel((variant, lag.make(lag.typical)))
        rig = load_rig("makki2024")
        p = [values.get(q.name, rig[q.name].value if q.name in rig else 0.1) for q in model.parameters]
        x, u = ca.SX(state_of(len(model.states), 3)), ca.SX([2.1, 2.4])
        functions = (model.dynamics, model.measurement)
        outputs = [ca.evalf(function(x, u, ca.SX(p), ca.SX(1.5))) for function in functions]
        results.append(np.concatenate([np.asarray(output).ravel() for output in outputs]))
    np.testing.assert_allclose(results[0], results[1], rtol=1e-6, atol=1e-9)
    assert issubclass(type(lag.make()), RotorLag)


@pytest.mark.parametrize(
    ("channel", "signs"), [("thrust.both", (1, 1)), ("thrust.difference", (1, -1)), ("voltage.back", (0, 1))]
)
def test_rotor_channel_acts_on_the_rotors_in_its_name(channel: str, signs: tuple[int, int]) -> None:
    assert rotor_signs(channel) == signs


HIDDEN_Nm_per_rad = 0.05


def test_equation_is_found_with_its_coefficient_and_confirmed() -> None:
    diagnosis = diagnosed(unlisted=True)
    assert diagnosis.label == "unexplained"
    proposed = diagnosis.proposed_term
    assert proposed is not None
    assert [term.key for term in proposed.equation.terms] == ["torque.pitch: elevation"]
    ((value, std, unit),) = proposed.discovery.values.values()
    assert unit == "N m/rad"
    assert abs(value - HIDDEN_Nm_per_rad) < 3.0 * std < 0.1 * HIDDEN_Nm_per_rad
    assert proposed.discovery.held_out_nats is not None
    assert proposed.discovery.held_out_nats > 50.0
    assert diagnosis.proposal is not None
    assert diagnosis.proposal.evaluation.reductions["pitch"].ratio < 0.2
    assert np.corrcoef(proposed.trace.term_Nm, proposed.trace.missing_Nm)[0, 1] > 0.9


def test_the_json_has_the_keys_that_were_promised() -> None:
    numbers = json.loads(json.dumps(to_json(diagnosed(unlisted=True)), allow_nan=False))
    equation = numbers["proposed_term"]
    assert (equation["channel"], equation["unit"]) == ("torque.pitch", "N m")
    assert equation["expression"] == "c1_Nm_per_rad*elevation"
    assert equation["symbols"] == {"elevation": "rad"}
    assert equation["numbers"].keys() == {"c1_Nm_per_rad"}
    assert equation["rivals"] == sorted(equation["rivals"], key=lambda rival: rival["log_likelihood_ratio"])
    assert 0.5 < equation["confidence"] < 1.0
    (matters,) = equation["matters"]
    assert 0.0 < matters["rms"] < matters["largest"]
    fails = numbers["failing_regions"]
    assert (fails["axis"], fails["x"], fails["false_discovery_rate"]) == (
        "pitch",
        "elevation",
        FALSE_DISCOVERY_RATE,
    )
    assert fails["before"]["share_of_time"] > 0.5
    assert fails["after"]["share_of_time"] < 0.1


def test_nothing_hidden_and_a_listed_cause_have_no_equation() -> None:
    for diagnosis in (diagnosed(), diagnosed("rotor_lag=0.06")):
        assert to_json(diagnosis)["proposed_term"] is None


def test_rig_has_the_equation_on_request_and_flies_with_its_effect_file(
    terminal: Terminal, tmp_path: Path
) -> None:
    diagnosis = diagnosed(unlisted=True)
    proposed = diagnosis.proposed_term
    assert proposed is not None
    assert diagnosis.rig("extended").effects == {}
    path = tmp_path / "proposed.py"
    path.write_text(proposed.effect_file("From a test."), encoding="utf-8")
    write_rig(diagnosis.rig("with_term", with_term=True), tmp_path / "with_term.toml")
    (effect,) = effects_of(load_rig(tmp_path / "with_term.toml"), (path,))
    assert list(effect.values.values()) == pytest.approx(list(proposed.numbers.values()))
    plan = "title = 'Up'\n[[segment]]\nkind = 'hold'\nduration_s = 1.0\n"
    (tmp_path / "up.toml").write_text(plan)
    logs = {}
    for name, options in {
        "without": (),
        "with": ("--effect-file", path, "--effect", "proposed_term"),
        "in_rig": ("--rig", "with_term.toml", "--effect-file", path),
    }.items():
        result = terminal("fly", "up.toml", "--sil", *options, "--speed", "max", "--log", f"{name}.mcap")
        assert result.code == 0, result.err
        logs[name] = Path(f"{name}.mcap").read_bytes()
    # The extended rig has other parameters too, so all three flights differ.
    assert len({*logs.values()}) == 3


def test_equation_that_a_held_out_flight_contradicts_is_dropped() -> None:
    fit, _ = flights(unlisted=True)
    rig = load_rig("makki2024")
    train = prepare(fit, rig, "fit")
    # The held-out flight is one of a rig without the equation.
    other = prepare(flights()[1], rig, "other")
    comparison = ModelComparison(MultibodyModel(), rig, [train], [other])
    assert discover(comparison, comparison.refit([])) is None


def test_second_equation_gets_another_name() -> None:
    assert free_name(()) == "proposed_term"
    assert free_name(("proposed_term", "rotor_lag")) == "proposed_term_2"
    assert free_name(("proposed_term", "proposed_term_2")) == "proposed_term_3"
    equation = Equation((EquationTerm("torque.pitch", Term((Factor("linear", "elevation"),))),))
    first, second = (
        equation_effect(equation, dict.fromkeys(equation.coefficient_names, 1.0), name=name)
        for name in ("first", "second")
    )
    assert len(MultibodyModel((first, second)).parameters) == len(MultibodyModel().parameters) + 2


def scored_as(channel: str, quantity: str, nats: float) -> ScoredTermGroup:
    """Return a term that is linear in a quantity, with this score."""
    group = TermGroup((EquationTerm(channel, Term((Factor("linear", quantity),))),), 1)
    return ScoredTermGroup(group, nats, np.ones(1), (1.0,))


def equation_search(base: Hypothesis) -> EquationSearch:
    """Return a search that has scored a hundred terms of one factor; it cannot refit."""
    comparison = cast(ModelComparison, SimpleNamespace(rows=1000))
    return EquationSearch(EquationRefits(comparison, base, "proposed_term", {1: 100}), lambda _: None)


def test_encoder_errors_do_not_fill_all_places_of_the_finalists() -> None:
    search = equation_search(cast(Hypothesis, SimpleNamespace(ids=())))
    on_encoders = [scored_as(f"measurement.{axis}", axis, 80.0 + i) for i, axis in enumerate(AXES)]
    chosen = search.finalists([*on_encoders, scored_as("torque.pitch", "travel", 40.0)])
    channels = [finalist.group.terms[0].channel for finalist in chosen]
    assert channels == ["measurement.travel", "measurement.pitch", "torque.pitch"]


def test_terms_hidden_by_a_slow_disturbance_are_scored_without_it() -> None:
    proposed = diagnosed(unlisted=True).proposed_term
    assert proposed is not None
    base = proposed.discovery.base
    equation, encoder = (
        scored_as(f"{kind}.pitch", "elevation", 0.0).group for kind in ("torque", "measurement")
    )
    signals = TermSignals(Screening(base.estimate))
    fast_std_Nm = base.estimate.disturbances.fast_std
    calm, drifting = (
        replace(base.estimate.disturbances, slow_std=fast_std_Nm * [0.5, times, 0.5], curvature=None)
        for times in (0.5, 30.0)
    )
    assert equation_search(base).slow_finalists(base, calm, signals, [equation, encoder]) == []
    (with_drift,) = score_groups(
        Screening(replace(base.estimate, disturbances=drifting)), signals, [equation]
    )
    (without_drift,) = equation_search(base).slow_finalists(base, drifting, signals, [equation, encoder])
    assert without_drift.group is equation
    assert without_drift.log_likelihood_gain > 1.2 * with_drift.log_likelihood_gain


def test_scores_of_all_channels_are_those_of_the_effect_itself() -> None:
    rig = load_rig("makki2024")
    comparison = ModelComparison(MultibodyModel(), rig, [prepare(flights()[0], rig, "fit")], [])
    screening = Screening(comparison.refit([]).estimate)
    signals = TermSignals(screening)
    own_thrust = Factor("linear", "own_thrust")
    one_per_kind_of_channel = [
        EquationTerm("torque.travel", Term((Factor("signed_square", "travel_rate"),))),
        EquationTerm("thrust.difference", Term((own_thrust, Factor("linear", "travel_rate")))),
        EquationTerm("thrust.back", Term((own_thrust, Factor("sin", "travel", (("k", 2.0),))))),
        EquationTerm("voltage.both", Term((Factor("square", "own_voltage"),))),
        EquationTerm("measurement.pitch", Term((Factor("linear", "travel"),))),
    ]
    for term in one_per_kind_of_channel:
        (scored,) = score_groups(screening, signals, [TermGroup((term,), 1)])
        equation = Equation((term,))
        effect = equation_effect(
            equation, dict(zip(equation.coefficient_names, scored.prior_std, strict=True))
        )
        coefficient_names = tuple(f"proposed_term_{name}" for name in equation.coefficient_names)
        extended = ExtendedModel(MultibodyModel(), effect, coefficient_names)
        (flight,) = signals.linearised_flights
        rates, _ = extended.run(flight.trajectory, effect.values)
        _, angles = extended.run(flight.nodes, effect.values)
        change = CandidateSignals(rates, angles if np.any(angles) else None)
        (statistics,) = screening.information([change], [1])
        gain, coefficients, _ = score_of(*statistics, np.array(scored.prior_std))
        assert scored.log_likelihood_gain == pytest.approx(gain, rel=1e-6), term.key
        assert scored.coefficients == pytest.approx(coefficients, rel=1e-6)


def test_right_model_has_no_failing_region_in_95_percent_of_cases() -> None:
    estimate = diagnosed().search.baseline.estimate
    screening = Screening(estimate)
    rng = np.random.default_rng(1)
    # The innovations of a right model are white: they are drawn, and the regressors are those of a diagnosis.
    # Cells are bands of elevation, 0.04 rad wide, in which a flight was for at least 61 steps.
    inside = [
        (flight.trajectory.state[:, 0] > low) & (flight.trajectory.state[:, 0] <= low + 0.04)
        for flight in screening.filtered.linearised_flights
        for low in np.arange(-0.16, 0.16, 0.04)
    ]
    cells = np.column_stack([cell for cell in inside if cell.sum() > 60]).astype(float)
    regressors = list(screening.filtered.disturbance_regressors(estimate.disturbances, 1, [cells]))
    (parameter_regressors,) = (innovations[:, 1:] for innovations in screening._innovations.flights)
    false_alarms = 0
    for _ in range(200):
        white = rng.standard_normal(screening.measurements)
        # A refit of the free parameters projects them out of the innovations.
        step = screening._solve(parameter_regressors.T @ white)
        screening._step = screening._step._replace(error=[white - parameter_regressors @ step])
        statistics = screening.projected(regressors, [1] * cells.shape[1])
        z = np.array([score[0] / np.sqrt(information[0, 0]) for information, score in statistics])
        p_values = 2.0 * ndtr(-np.abs(z))
        false_alarms += bool((false_discovery_control(p_values) <= FALSE_DISCOVERY_RATE).any())
    # 5 % of 200 are 10; three standard deviations more are 19.
    assert false_alarms <= 19


def test_a_region_in_which_nothing_is_missing_is_not_outlined() -> None:
    diagnosis = diagnosed(unlisted=True)
    proposed = diagnosis.proposed_term
    assert proposed is not None
    discovery = proposed.discovery
    regions = failing_regions(discovery.base.estimate, discovery.hypothesis.estimate, "travel")
    assert regions.after.share < 0.1


def test_command_writes_equation_curve_and_effect_file(
    terminal: Terminal, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The search itself is what the tests above have done.
    diagnosis = diagnosed(unlisted=True)
    monkeypatch.setattr("heli_lab.explain.diagnose", lambda *_args, **_more: diagnosis)
    paths = tmp_path / "a.csv.gz", tmp_path / "b.csv.gz"
    for flight, path in zip(flights(unlisted=True), paths, strict=True):
        write_csv(flight, path)
    files = ("--report", "why", "--json", "why.json", "--save-rig", "with_term.toml", "--with-term")
    result = terminal("diagnose", paths[0], "--validate", paths[1], "--rig", "makki2024", *files)
    assert result.code == 0, result.err
    assert "proposed equation: torque.pitch = 0.0" in result.out
    assert "why/proposed.py" in result.out
    for name in ("curves.png", "equation.png", "regions.png", "proposed.py"):
        assert Path("why", name).exists(), name
    assert "proposed_term" in Path("with_term.toml").read_text()
    page = html.unescape(Path("why/index.html").read_text(encoding="utf-8"))
    assert "<h1>The model lacks an effect that the catalogue does not list</h1>" in page
    # Page, terminal and JSON have the same sentence.
    assert page.count(summary(diagnosis)) == result.out.count(summary(diagnosis)) == 1
    # The first section after the verdict is about the unexplained part, which the headline names.
    assert page.index("<h2>The unexplained part") == page.index("<h2>")
    assert "A torque about pitch that depends on elevation predicts" in page
    for axis in ("pitch", "elevation", "travel"):
        assert f"<li>About {axis}: the model with all named causes lacks " in page
    assert "Proposed equation" in page
    # The equation is unknown to the model, and its curve predicts the error of the validation flight.
    numbers = json.loads(Path("why.json").read_text(encoding="utf-8"))
    assert numbers["sentence"] == summary(diagnosis)
    parts = numbers["forecast_error"]["axis"]["pitch"]
    assert parts["unknown"]["share"] > 0.5
    assert numbers["forecast_error"]["depends_on"] == ["torque.pitch on elevation"]
    assert numbers["saved_rig"] == {"effects": ["proposed_term"], "left_out": []}
    assert "What the forecast error consists of" in page
    assert "A torque about pitch that depends on elevation predicts a part of the unknown error" in result.out


@pytest.mark.parametrize(
    ("periods", "errors", "whole"),
    [
        # The weaker of the two says little about its period.
        ((2.02, 2.6), (0.02, 0.4), 2.0),
        ((2.015, 2.015), (1e-4, 1e-4), 2.0),
        ((2.03, 2.03), (1e-4, 1e-4), None),
        ((0.02, 0.02), (0.02, 0.02), None),
    ],
)
def test_sine_and_cosine_of_a_wave_share_their_whole_number(
    monkeypatch: pytest.MonkeyPatch,
    periods: tuple[float, float],
    errors: tuple[float, float],
    whole: float | None,
) -> None:
    equation = Equation(
        tuple(
            EquationTerm("torque.elevation", Term((Factor(form, "travel", (("k", 2.0),)),)))
            for form in ("sin", "cos")
        )
    )
    effect = equation_effect(equation, dict.fromkeys(equation.coefficient_names, 0.1))
    theta = np.array([0.03, 0.02, *periods])
    names = [f"{effect.prefix}_{name}" for name in ("c1_Nm", "c2_Nm", "k1", "k2")]
    assert set(names) == set(effect.priors)
    std = dict(zip(names, (1e-3, 1e-3, *errors), strict=True))
    refitted_hypothesis = SimpleNamespace(
        candidates=[SimpleNamespace(effect=effect)],
        params=dict(zip(names, theta, strict=True)),
        std=std,
        log_likelihood=100.0,
        ids=(),
    )
    base = cast(Hypothesis, SimpleNamespace(ids=(), candidates=(), params={}, log_likelihood=0.0))
    refits = equation_search(base).refits
    monkeypatch.setattr(
        refits, "prior_std", lambda equation, _: dict.fromkeys(equation.coefficient_names, 0.1)
    )
    monkeypatch.setattr(
        refits,
        "refit",
        lambda equation, signals, start, *rest: SimpleNamespace(log_likelihood=99.0, start=start),
    )
    refitted = RefittedEquation(
        equation, cast(Hypothesis, refitted_hypothesis), 20.0, TermGroup(equation.terms, 2)
    )
    restricted = refits.with_whole_periods(refitted, cast(TermSignals, None))
    if whole is None:
        assert restricted is refitted
        return
    assert restricted.held == {"k1", "k2"}
    start = restricted.hypothesis.start  # type: ignore[attr-defined]
    assert [start[name] for name in ("k1", "k2")] == [whole, whole]


KINDS = catalogue()
PENALTY = 10.0


def equivalent_effect(hidden: str, equation: Equation, *ids: str, unlisted: bool = False) -> list[str | None]:
    """Return the effect that is equivalent to an `equation`, for several catalogues of a single effect
    each.
    """
    # `hidden`: Effect that is hidden in the flight.
    # `equation`: The proposed equation.
    # `ids`: The only effect of each catalogue.
    # `unlisted`: Whether an effect that no catalogue has is hidden too.
    rig = load_rig("makki2024")
    flight = flights(hidden, unlisted=unlisted)[0]
    comparison = ModelComparison(MultibodyModel(), rig, [prepare(flight, rig, "fit")], [])
    base = comparison.refit([])
    effect = equation_effect(equation, dict.fromkeys(equation.coefficient_names, 0.1))
    warm_start = comparison.refit(
        [Candidate(effect.name, effect, tuple(effect.priors))], {**effect.values, **base.params}, base
    )
    assert warm_start.log_likelihood > base.log_likelihood + 50.0 + PENALTY
    return [
        ListedEffects(comparison, base, {id_: KINDS[id_]}, lambda _: None).equivalent_effect(
            equation, warm_start, PENALTY
        )
        for id_ in ids
    ]


@pytest.mark.slow
def test_listed_effect_of_the_same_form_is_equivalent() -> None:
    equation = Equation((EquationTerm("torque.travel", Term((Factor("linear", "travel"),))),))
    equivalent_ids = equivalent_effect(
        "cable_spring.travel=0.1", equation, "coulomb_friction.pitch", "cable_spring.travel"
    )
    assert equivalent_ids == [None, "cable_spring.travel"]


@pytest.mark.slow
def test_equation_is_dropped_while_a_stronger_listed_effect_is_missing() -> None:
    equation = Equation((EquationTerm("torque.pitch", Term((Factor("linear", "elevation"),))),))
    equivalent_ids = equivalent_effect(
        "cable_spring.travel=0.3", equation, "cable_spring.travel", unlisted=True
    )
    assert equivalent_ids == ["cable_spring.travel"]


@pytest.mark.parametrize(
    ("equation_nats", "effect_nats", "both_nats", "stays"),
    [
        (100.0, 80.0, 104.0, True),
        (100.0, 80.0, 130.0, True),
        (100.0, 80.0, 94.0, False),  # With the effect, the equation adds 14 nats and needs 16.
        (80.0, 100.0, 130.0, False),  # The effect adds more to the equation than the reverse.
    ],
)
def test_equation_that_encompasses_the_effect_stays(
    equation_nats: float, effect_nats: float, both_nats: float, stays: bool
) -> None:
    def model(nats: float) -> Hypothesis:
        """Return a model of this log-likelihood; its last candidate is the equation."""
        return cast(Hypothesis, SimpleNamespace(log_likelihood=nats, params={}, candidates=("equation",)))

    comparison = SimpleNamespace(
        rows=1500, held_out=(), refit=lambda candidates, start, warm_start: model(both_nats)
    )
    base = cast(Hypothesis, SimpleNamespace(candidates=(), log_likelihood=0.0))
    listed = ListedEffects(cast(ModelComparison, comparison), base, KINDS, lambda _: None)
    effect = typical_candidate(KINDS["input_delay"])
    assert listed.encompasses(model(equation_nats), model(effect_nats), effect, PENALTY) is stays
