"""Table 6: which of its readings holds pitch and travel still, and on which model."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from heli_host.board.parameters import paper_gains
from heli_host.ui.cli import app
from heli_lab.apps.paper.experiments import fly_plan
from heli_lab.apps.paper.table6 import LoopVerdict, verdicts
from heli_lab.control.tune import cascade_gains_of, is_stable, linear_plant
from heli_sim.model import MultibodyModel, PaperModel
from heli_sim.model.plant import Plant
from heli_sim.rig import load_rig
from typer.testing import CliRunner

pytestmark = pytest.mark.slow

RIG = load_rig("makki2024")


def of(rows: list[LoopVerdict]) -> dict[tuple[str, str, str], LoopVerdict]:
    return {(row.gains, row.reading, row.derivative): row for row in rows}


@pytest.fixture(scope="module")
def on_30() -> dict[tuple[str, str, str], LoopVerdict]:
    return of(verdicts(PaperModel(), RIG))


@pytest.fixture(scope="module")
def on_multibody() -> dict[tuple[str, str, str], LoopVerdict]:
    return of(verdicts(MultibodyModel(), RIG))


@pytest.mark.parametrize("derivative", ["error", "measurement"])
def test_printed_as_a_pitch_setpoint_in_degrees_travel_swings_up_on_either_model(
    on_30: dict[tuple[str, str, str], LoopVerdict],
    on_multibody: dict[tuple[str, str, str], LoopVerdict],
    derivative: str,
) -> None:
    for verdicts_by_reading in (on_30, on_multibody):
        row = verdicts_by_reading["printed", "degrees", derivative]
        assert row.growth_1_per_s == pytest.approx(0.118, abs=0.002)
        assert row.period_s == pytest.approx(10.5, abs=0.1)
        assert verdicts_by_reading["corrected", "degrees", derivative].growth_1_per_s < -0.3


def test_printed_as_u3_on_30_is_stable_by_a_hair_and_only_with_the_exact_derivative_of_the_error(
    on_30: dict[tuple[str, str, str], LoopVerdict],
) -> None:
    exact, standard = on_30["printed", "u3", "error"], on_30["printed", "u3", "measurement"]
    assert -0.035 < exact.growth_1_per_s < -0.025
    assert exact.lag_s < 0.09  # the shortest lag of any real rig
    assert standard.growth_1_per_s > 1.5


def test_printed_as_u3_is_stable_on_a_multibody_rig_because_the_body_hangs_below_the_pitch_axis(
    on_multibody: dict[tuple[str, str, str], LoopVerdict],
) -> None:
    assert on_multibody["printed", "u3", "measurement"].growth_1_per_s < 0.0
    no_pendulum = of(verdicts(MultibodyModel(), RIG.replace(L_phi=1e-4, L_theta=1e-4)))
    assert no_pendulum["printed", "u3", "measurement"].growth_1_per_s > 1.0


def test_corrected_a_step_of_15_degrees_overshoots_to_20_and_printed_as_u3_it_takes_two_minutes(
    on_30: dict[tuple[str, str, str], LoopVerdict],
) -> None:
    corrected, printed = on_30["corrected", "degrees", "measurement"], on_30["printed", "u3", "error"]
    assert corrected.peak_deg == pytest.approx(20.4, abs=0.1)
    assert corrected.settling_time_s == pytest.approx(12.7, abs=0.2)
    assert printed.settling_time_s > 100.0
    assert math.isinf(on_30["printed", "degrees", "error"].settling_time_s)


def test_verdicts_that_are_infinite_are_null_in_json(tmp_path: Path) -> None:
    target = tmp_path / "gains.json"
    assert CliRunner().invoke(app, ["paper", "gains", "--json", str(target)]).exit_code == 0
    rows = json.loads(target.read_text())["models"]["paper"]
    assert [row["settling_time_s"] is None for row in rows] == [row["growth_1_per_s"] > 0.0 for row in rows]


def test_both_analyses_of_table_6_agree_where_they_overlap(
    on_multibody: dict[tuple[str, str, str], LoopVerdict],
) -> None:
    """`heli_lab.control.tune` knows filters and the board's law; this one knows (33) and (34)."""
    for gains in ("printed", "corrected"):
        row = on_multibody[gains, "degrees", "measurement"]
        assert (row.growth_1_per_s < 0.0) == is_stable(
            linear_plant(RIG), cascade_gains_of(paper_gains(gains))
        )


def test_the_growth_of_the_printed_travel_row_is_the_one_that_is_flown() -> None:
    """A swing that grows by 0.118 a second is 3.3 times as large after each 10.5 s."""
    flown = fly_plan("sine", Plant(MultibodyModel(), RIG), "printed", "paper-printed")
    assert math.exp(0.118 * 10.5) == pytest.approx(3.45, abs=0.01)
    t_s, error = flown.flight.t_s, np.abs(flown.error_deg[:, 2])
    early, late = error[(t_s > 6) & (t_s < 17)].max(), error[t_s > t_s[-1] - 11.0].max()
    assert late > 4.0 * early


def test_corrected_table_6_flies_the_sines_and_own_gains_fly_them_better() -> None:
    plant = Plant(MultibodyModel(), RIG)
    rms = []
    for gains in ("paper", None):
        flown = fly_plan("sine", plant, "sine", gains)
        assert flown.outcome == "completed" or "landing" in flown.outcome
        rms.append(float(np.sqrt(np.mean(flown.error_deg[flown.flight.t_s > 8.0, 2] ** 2))))
    assert rms[0] < 6.0
    assert rms[1] < 1.0


def test_gains_of_the_paper_are_refused_on_a_real_board_and_by_a_wrong_name() -> None:
    for arguments, wanted in (
        (["--port", "/dev/nowhere", "--gains", "paper"], "add --sil"),
        (["--sil", "--gains", "best"], "paper-printed"),
    ):
        result = CliRunner().invoke(app, ["fly", "hover", *arguments])
        assert result.exit_code != 0
        assert wanted in result.output
