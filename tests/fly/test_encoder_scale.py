"""A finished flight says which encoder counts otherwise than the rig's model predicts, and is else silent."""

import contextlib
import json
import re
from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import mkdtemp

import heli_host
import numpy as np
import pytest
from heli_host.data.flight import Flight
from heli_host.data.log.reader import read_flight
from heli_host.fly.plan import Plan
from heli_host.ui.cli import run
from heli_lab.watch.encoder_scale import (
    Explanation,
    ScaleEstimate,
    finding_of,
    scales_of,
    warning_text,
    wrong_scale,
)
from heli_lab.watch.weak_form import SCALES_AND_FACTOR, VOLTAGE_FACTOR, FlightInWeakForm, Part, TestFunctions
from heli_sim.model import MultibodyModel
from heli_sim.rig import load_rig

from tests.fly.encoder_scale import judged
from tests.running.long import samples

pytestmark = pytest.mark.slow
PLAN = """
title = "Short"
[start]
elevation_deg = 0
rate_deg_s = 12
settle_s = 1
[[segment]]
kind = "sine"
travel_amplitude_deg = 15
travel_period_s = 13
elevation_amplitude_deg = 4
elevation_period_s = 8
duration_s = 26
"""


@cache
def flown(scale: str) -> Path:
    """Fly a short plan by the command line, with a scale for an encoder; returns the folder of its files."""
    folder = Path(mkdtemp())
    (folder / "short.toml").write_text(PLAN)
    plan, log, summary = (str(folder / name) for name in ("short.toml", "flight.mcap", "summary.json"))
    with (folder / "output.txt").open("w") as output, contextlib.redirect_stdout(output):
        run(["fly", plan, "--port", f"sil://?encoder_scale={scale}", "--log", log, "--json", summary])
    return folder


def flight_of(scale: str) -> Flight:
    return read_flight(flown(scale) / "flight.mcap", allow_gaps=True)


@pytest.mark.parametrize(("axis", "scale"), [("travel", 0.5), ("elevation", 0.85)])
def test_a_wrong_scale_is_measured_and_named(axis: str, scale: float) -> None:
    (finding,) = json.loads((flown(f"{axis}:{scale:g}") / "summary.json").read_text())["findings"]
    assert finding["name"] == f"{axis}_encoder_scale"
    assert abs(finding["value"] - scale) < 3.0 * finding["standard_error"] < 0.15
    assert f"check {axis}_counts_per_rev" in finding["text"]


def test_the_summary_and_the_last_lines_have_the_warning() -> None:
    folder = flown("travel:0.5")
    output = (folder / "output.txt").read_text()
    (finding,) = json.loads((folder / "summary.json").read_text())["findings"]
    assert f"warning: {finding['text']}" in output
    assert finding["text"].startswith(f"travel encoder: it counts {finding['value']:.2f}"[:-1])
    assert set(finding) == {"name", "value", "standard_error", "text"}


def test_right_scales_give_no_finding() -> None:
    assert json.loads((flown("travel:1") / "summary.json").read_text())["findings"] == []
    estimates = scales_of(flight_of("travel:1"), load_rig("makki2024"), MultibodyModel())
    assert [estimate.axis for estimate in estimates] == ["elevation", "pitch", "travel"]
    assert all(estimate.sigmas < 2.0 and estimate.standard_error < 0.2 for estimate in estimates)


def test_flights_from_python_are_checked_too() -> None:
    with heli_host.connect("sil://?encoder_scale=pitch:0.8") as heli:
        (finding,) = heli.fly(Plan.parse(PLAN, "short")).findings
    assert finding.name == "pitch_encoder_scale"
    assert finding.value is not None and finding.standard_error is not None
    assert abs(finding.value - 0.8) < 3.0 * finding.standard_error < 0.15


def test_wrong_supply_accuses_no_encoder() -> None:
    """The motors get half the voltage that the board computes, so that axes move less than predicted."""
    with heli_host.connect("sil://?speed=max") as heli:
        heli.params["supply_V"] = 24.0
        (finding,) = heli.fly(Plan.parse(PLAN, "short")).findings
    assert finding.name.endswith("_motion")
    factor = re.search(r"a wrong supply_V \(the motors act as if they had ([\d.]+) times", finding.text)
    assert factor and float(factor[1]) == pytest.approx(0.5, abs=0.05)
    assert "check supply_V" in finding.text and "counts_per_rev" not in finding.text


@pytest.mark.parametrize("out_s", [11.5, 12.0])
def test_time_of_a_dead_encoder_accuses_no_other_encoder(out_s: float) -> None:
    with heli_host.connect(f"sil://?speed=max&encoder_out=pitch:{out_s:g}") as heli:
        summary = heli.fly("sine")
    assert "pitch_motionless" in summary.outcome
    assert summary.findings == ()


def test_encoder_is_named_only_if_nothing_else_is_as_likely() -> None:
    wrong = ScaleEstimate("pitch", 0.8, 0.02, 50.0)
    unlikely, close, better = (Explanation("supply_sag", nats) for nats in (45.0, 46.0, 57.0))
    supply = Explanation("supply_V", 53.0, factor=0.75)
    assert finding_of(wrong, []).name == finding_of(wrong, [unlikely]).name == "pitch_encoder_scale"
    weak = replace(wrong, nats=6.0)
    assert finding_of(weak, [Explanation("supply_sag", 3.0)]).name == "pitch_encoder_scale"
    assert finding_of(weak, [Explanation("supply_sag", 5.0)]).name == "pitch_motion"
    both = finding_of(wrong, [close])
    assert both.name == "pitch_motion" and (both.value, both.standard_error) == (0.8, 0.02)
    assert both.text.startswith("pitch moves 0.80 ± 0.02 (1 standard error) times as far as the rig's model ")
    assert "because of supply_sag or pitch_counts_per_rev: this flight does not show which" in both.text
    # An encoder that is far less likely than something else is not mentioned.
    text = finding_of(wrong, [better, supply]).text
    assert "supply_sag or a wrong supply_V (the motors act as if they had 0.75 times the voltage)" in text
    assert "counts_per_rev" not in text and text.endswith("; check supply_V and the rig's file")
    # Only the best explanations are listed.
    assert finding_of(wrong, [better, close]).text.endswith(
        "because of supply_sag: no encoder explains it as well; find the cause with heli-host diagnose"
    )
    others = [Explanation(f"effect_{number}", 50.0) for number in range(6)]
    assert (
        "effect_2, 3 other effects of the catalogue or pitch_counts_per_rev" in finding_of(wrong, others).text
    )


def test_scale_whose_search_has_not_converged_is_no_finding() -> None:
    wrong = ScaleEstimate("pitch", 0.8, 0.02, 50.0)
    assert wrong_scale([wrong]) is wrong
    assert wrong_scale([replace(wrong, converged=False)]) is None


def test_drawn_rigs_with_right_encoders_give_no_warning() -> None:
    for seed in range(901, 901 + samples(30, 1)):
        for plan in ("step", "sine"):
            finding = judged(plan, seed)
            assert finding is None or finding.warned is None, (plan, seed)


def test_gusts_that_the_law_answers_are_no_wrong_elevation() -> None:
    # With the noise of the residuals alone elevation showed 0.68 ± 0.06 of its counts.
    flown = judged("step", 210)
    assert flown is not None and flown.warned is None


def test_a_hover_says_nothing_of_travel() -> None:
    hover = Plan.parse(PLAN.split("[[segment]]", maxsplit=1)[0] + HOLD, "hover")
    with heli_host.connect("sil://?encoder_scale=travel:0.5") as heli:
        assert heli.fly(hover).findings == ()


HOLD = """
[[segment]]
kind = "hold"
duration_s = 8
"""


def test_the_most_likely_of_several_axes_is_named() -> None:
    def estimate(axis: str, scale: float, error: float, nats: float) -> ScaleEstimate:
        return ScaleEstimate(axis, scale, error, nats)

    likely = estimate("elevation", scale=0.8, error=0.01, nats=20.0)
    most_likely = estimate("travel", scale=0.5, error=0.02, nats=90.0)
    assert wrong_scale([likely, most_likely]) is most_likely
    uncertain = estimate("pitch", scale=0.2, error=0.3, nats=80.0)
    no_likelier_than_1 = estimate("travel", scale=0.5, error=0.02, nats=1.0)
    assert wrong_scale([uncertain, no_likelier_than_1]) is None
    assert "it counts 0.498 ± 0.008 (1 standard error)" in warning_text(
        estimate("travel", scale=0.4981, error=0.0083, nats=90.0)
    )
    assert "it counts 0.50 ± 0.03 (1 standard error)" in warning_text(
        estimate("travel", scale=0.5, error=0.03, nats=90.0)
    )


def test_test_functions_give_means_and_second_derivatives() -> None:
    step_s = 0.02
    t_s = np.arange(500, dtype=np.float64) * step_s
    angles = np.column_stack((0.5 * 0.3 * t_s**2, 1.0 + 2.0 * t_s, np.sin(0.5 * t_s)))
    part = Part(t_s, angles, np.zeros((500, 3)), np.ones((500, 2)), step_s)
    functions = TestFunctions(part)
    derivatives = functions.second_derivative(angles)
    assert derivatives[0] == pytest.approx(0.3, abs=1e-9)
    assert derivatives[1] == pytest.approx(0.0, abs=1e-9)
    assert derivatives[2] == pytest.approx(functions.mean(2, -0.25 * np.sin(0.5 * t_s)), abs=2e-4)
    assert part.lagged_V(0.1) == pytest.approx(1.0)


def test_a_lag_is_the_mean_of_its_response_over_each_step() -> None:
    step_s, lag_s = 0.02, 0.1
    volts = np.repeat([[1.0], [2.0]], [10, 190], axis=0)
    part = Part(np.linspace(0.0, 199 * step_s, 200), np.zeros((200, 3)), np.zeros((200, 3)), volts, step_s)
    fine_s = np.arange(190 * 200) * step_s / 200 + 0.5 * step_s / 200
    wanted = (2.0 - np.exp(-fine_s / lag_s)).reshape(190, 200).mean(axis=1)
    assert part.lagged_V(lag_s)[10:, 0] == pytest.approx(wanted, abs=1e-5)


@pytest.mark.parametrize("factor", [1.0, 0.4])
def test_derivatives_are_those_of_the_residuals_also_in_the_dead_zone(factor: float) -> None:
    """With the factor 0.4, many voltages are in the dead zone, in which neither factor nor lag counts."""
    flight = FlightInWeakForm(flight_of("travel:1"), load_rig("makki2024"), MultibodyModel())
    unknowns = flight.mean.copy()
    unknowns[VOLTAGE_FACTOR] = np.log(factor)
    _, jacobians = flight.residuals(unknowns)
    for column in (*range(SCALES_AND_FACTOR + 3), len(unknowns) - 1):
        step = np.zeros(len(unknowns))
        step[column] = 1e-4
        after, before = (flight.residuals(unknowns + sign * step)[0] for sign in (1.0, -1.0))
        for axis in range(3):
            slope = (after[axis] - before[axis]) / 2e-4
            size = max(np.abs(slope).max(), 1e-3)
            assert jacobians[axis][:, column] == pytest.approx(slope, abs=0.01 * size), (column, axis)
