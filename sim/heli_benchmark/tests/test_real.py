"""Known effects, hidden in a log: what the log then shows, and how a diagnosis of it is judged."""

from typing import Any

import numpy as np
import pytest
from heli_host.data.flight import Flight
from heli_lab.diagnose import diagnose, to_json
from heli_lab.fit.records import prepare
from heli_sim.model import MultibodyModel
from heli_sim.rig import load_rig

from heli_benchmark.real import HIDDEN_EFFECTS, HiddenResult, KnownEffect, hide, score
from tests.diagnose.hidden import flights
from tests.measured.hidden import main, summary

COUNT_RAD = np.full(3, 2.0 * np.pi / 4096.0)
t_s = np.arange(5_000) / 500.0
FLIGHT = Flight(
    t_s,
    3.0 + np.sin(2.0 * t_s),
    3.0 + np.cos(1.3 * t_s),
    *(COUNT_RAD[0] * np.round(np.outer((0.2, 0.3, 2.0), np.sin(0.7 * t_s)) / COUNT_RAD[0])),
)
RIG = load_rig("makki2024").replace(dead_zone=0.0, reverse_thrust=1.0)


def flight_with_hidden_effect(id_: str, size: float) -> Flight:
    return hide(FLIGHT, KnownEffect(id_, size), 5.0, COUNT_RAD)


def answer(*causes: dict[str, Any], undetectable: tuple[str, ...] = ()) -> dict[str, Any]:
    return {"causes": list(causes), "rig": {"numbers": {}}, "undetectable": list(undetectable)}


def cause(effect: str, *others: str, **numbers: tuple[float, float]) -> dict[str, Any]:
    spelled = {name: {"value": value, "std": std} for name, (value, std) in numbers.items()}
    return {"effect": effect, "confidence": 0.6, "ambiguous_with": list(others), "parameters": spelled}


SQUARE = cause("rotor_speed_lag", rotor_speed_lag_begins=(0.0, 0.0))


def judged(
    effect: KnownEffect, result: dict[str, Any], reference: dict[str, Any] | None = None
) -> HiddenResult:
    log = hide(FLIGHT, effect, 5.0, COUNT_RAD)
    return score(effect, result, reference or answer(), log.voltages_V, log.t_s, RIG)


def test_with_a_delay_the_voltages_of_the_log_act_later() -> None:
    log = flight_with_hidden_effect("input_delay", 0.06)
    assert np.array_equal(log.front_V, FLIGHT.front_V[30:])
    assert np.array_equal(log.pitch_rad, FLIGHT.pitch_rad[:-30])


def test_a_rotor_that_loses_voltage_is_logged_with_more_than_acts() -> None:
    log = flight_with_hidden_effect("thrust_step.front", 0.1)
    later = t_s >= 5.0
    np.testing.assert_allclose(0.9 * log.front_V[later], FLIGHT.front_V[later])
    assert np.array_equal(log.front_V[~later], FLIGHT.front_V[~later])
    assert np.array_equal(log.back_V, FLIGHT.back_V)


def test_an_encoder_with_play_lags_by_half_of_it_in_whole_counts() -> None:
    log, play_rad = flight_with_hidden_effect("backlash.pitch", 0.05), 0.05
    behind_rad = log.pitch_rad - FLIGHT.pitch_rad
    assert np.abs(behind_rad).max() == pytest.approx(0.5 * play_rad, abs=COUNT_RAD[1])
    counts = log.pitch_rad / COUNT_RAD[1]
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-6)


@pytest.mark.parametrize("effect", HIDDEN_EFFECTS, ids=lambda effect: f"{effect.id} {effect.size:.3g}")
def test_each_effect_changes_the_log(effect: KnownEffect) -> None:
    log = hide(FLIGHT, effect, 5.0, COUNT_RAD)
    rows = len(log)
    changed = [
        not np.array_equal(getattr(log, name), getattr(FLIGHT, name)[:rows])
        for name in ("front_V", "back_V", "elevation_rad", "pitch_rad", "travel_rad")
    ]
    assert any(changed) and not all(changed)


@pytest.mark.parametrize(
    ("others", "id_", "suffix", "truth"),
    [
        ((), "thrust_asymmetry", "thrust_asymmetry_share", 0.1),
        ((SQUARE,), "thrust_asymmetry", "thrust_asymmetry_share", (1.21 - 0.81) / (1.21 + 0.81)),
        ((), "thrust_step.front", "thrust_step_front_share", 0.1),
        ((SQUARE,), "thrust_step.front", "thrust_step_front_share", 0.19),
    ],
    ids=["line", "square", "step, line", "step, square"],
)
def test_ten_percent_of_voltage_are_more_thrust_where_it_is_the_square(
    others: tuple[dict[str, Any], ...], id_: str, suffix: str, truth: float
) -> None:
    # With the square, 10 % more and less voltage are thrusts of 1.21 and 0.81. A size is right within two
    # standard errors of 0.01.
    right, wrong = (cause(id_, **{suffix: (size, 0.01)}) for size in (truth + 0.019, truth + 0.021))
    assert judged(KnownEffect(id_, 0.1), answer(*others, right)).size_is_right
    assert not judged(KnownEffect(id_, 0.1), answer(*others, wrong)).size_is_right


def test_what_the_unchanged_flights_have_is_no_false_name_and_adds_to_the_size() -> None:
    delay = KnownEffect("input_delay", 0.06)
    before = answer(cause("input_delay", input_delay_s=(0.01, 0.001)), SQUARE)
    row = judged(delay, answer(cause("input_delay", input_delay_s=(0.07, 0.001)), SQUARE), before)
    assert row.named and row.size_is_right and not row.new_names
    new = judged(delay, answer(cause("input_delay", input_delay_s=(0.07, 0.001)), SQUARE))
    assert not new.size_is_right and new.new_names == (("rotor_speed_lag", 0.6),)


def test_another_lag_of_the_same_family_is_no_new_name() -> None:
    lags = {"family": {"members": ["rotor_lag", "rotor_speed_lag"]}}
    delay, named = KnownEffect("input_delay", 0.06), cause("input_delay", input_delay_s=(0.06, 0.001))
    row = judged(delay, answer(named, cause("rotor_lag") | lags), answer(SQUARE | lags))
    assert not row.new_names
    assert judged(delay, answer(named, cause("rotor_lag") | lags)).new_names == (("rotor_lag", 0.6),)


def test_a_new_name_that_the_unchanged_flights_support_is_marked() -> None:
    play = KnownEffect("backlash.pitch", 0.02)
    named = answer(cause("backlash.pitch", backlash_pitch_rad=(0.02, 0.001)), cause("flywheel"))

    def refitted(*gains: float | None) -> dict[str, Any]:
        accepted = {"round": 1, "candidate": "rotor_speed_lag", "train": 90.0, "penalty": 7.0, "taken": True}
        rows = [
            {"round": round_, "candidate": "flywheel", "train": gain, "penalty": 7.0, "taken": False}
            for round_, gain in enumerate(gains, 1)
        ]
        return answer(SQUARE) | {"ranking": [accepted, *rows]}

    supported, early, weak, unscored = (
        judged(play, named, refitted(*gains)) for gains in ((3.0, 9.0), (9.0,), (3.0, 3.0), (9.0, None))
    )
    assert supported.supported_names == ("flywheel",)
    for row in (early, weak, unscored, judged(play, named)):
        assert row.new_names and not row.supported_names
    assert summary([supported, weak])[3:5] == [
        "no new name: 0 of 2",
        "no new name that the unchanged flights do not support: 1 of 2",
    ]


def test_a_miss_counts_unless_the_flights_could_not_show_the_effect() -> None:
    play = KnownEffect("backlash.pitch", 0.02)
    missed, unseen = judged(play, answer()), judged(play, answer(undetectable=("backlash.pitch",)))
    among = judged(play, answer(cause("coulomb_friction.pitch", "backlash.pitch")))
    assert among.named
    assert summary([missed, unseen, among])[:2] == [
        "detectable and named: 1 of 2",
        "declared undetectable: 1 of 3",
    ]


@pytest.mark.diagnosis
def test_an_effect_that_is_hidden_in_a_log_is_named_with_its_size() -> None:
    rig, effect = load_rig("makki2024"), KnownEffect("input_delay", 0.03)
    logs = [hide(flight, effect, 0.0, COUNT_RAD) for flight in flights()]
    train, held_out = (prepare(log, rig) for log in logs)
    result = to_json(diagnose(MultibodyModel(), rig, [train], [held_out], labels=["a", "b"]))
    row = score(effect, result, answer(), train.voltages_V, train.t_s, rig)
    assert row.named and row.size_is_right and not row.new_names, row


def test_without_the_shared_flights_the_command_says_so(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Any
) -> None:
    monkeypatch.setattr("tests.measured.hidden.MEASURED", tmp_path / "none")
    assert main([]) == 2
    assert capsys.readouterr().out == "skipped: no shared data\n"


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["nobody"], "there is no pair 'nobody'; choose from "),
        (["--effect", "none"], "invalid choice: 'none'"),
    ],
)
def test_an_unknown_pair_or_effect_is_refused_in_one_line(
    words: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as ended:
        main(words)
    assert ended.value.code == 2
    assert says in capsys.readouterr().err.splitlines()[-1]
