"""Exports hold the same numbers, figures are drawn, summaries say what the log says."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from heli_host.data.flight import Flight
from heli_host.data.log.figure import draw, write_figure
from heli_host.data.log.reader import read_flight, read_log
from heli_host.data.log.summary import summarise, tracking_errors_deg
from heli_host.data.log.table import export_mat, export_parquet, write_csv
from heli_host.data.response import flown_rows
from heli_host.declaration import Axis, Channel, State
from heli_host.errors import LogWriteError

from tests.log.made import make_samples, open_writer, write_made_log


@pytest.fixture
def flight(tmp_path: Path) -> Flight:
    write_made_log(tmp_path / "a.mcap", 3000)
    return read_flight(tmp_path / "a.mcap")


@pytest.mark.medium
def test_matlab_gets_columns_parameters_and_plan(tmp_path: Path, flight: Flight) -> None:
    from scipy.io import loadmat

    export_mat(flight, tmp_path / "a.mat")
    content = loadmat(tmp_path / "a.mat", squeeze_me=True)
    np.testing.assert_array_equal(content["travel_rad"], flight.travel_rad)
    assert float(content["parameters"]["hover_V"]) == flight.parameters["hover_V"]
    assert "made" in str(content["plan"])
    export_mat(flight, tmp_path / "b.mat")
    assert (tmp_path / "a.mat").read_bytes() == (tmp_path / "b.mat").read_bytes()


def test_a_table_gets_every_column(tmp_path: Path, flight: Flight) -> None:
    write_csv(flight, tmp_path / "a.csv")
    header = (tmp_path / "a.csv").read_text().partition("\n")[0]
    assert header.split(",") == list(flight.columns())


@pytest.mark.medium
def test_parquet_gets_every_column_or_says_what_to_install(
    tmp_path: Path, flight: Flight, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(LogWriteError, match="pip install"):
        export_parquet(flight, tmp_path / "a.parquet")
    monkeypatch.undo()
    parquet = pytest.importorskip("pyarrow.parquet", reason="skipped: no pyarrow")
    export_parquet(flight, tmp_path / "a.parquet")
    table = parquet.read_table(tmp_path / "a.parquet")
    np.testing.assert_array_equal(table["pitch_rad"].to_numpy(), flight.pitch_rad)


@pytest.mark.parametrize("export", [write_csv, export_mat])
def test_an_export_into_a_missing_folder_is_one_line(tmp_path: Path, flight: Flight, export: object) -> None:
    assert callable(export)
    with pytest.raises(LogWriteError, match="choose another folder"):
        export(flight, tmp_path / "missing" / "a")


def test_errors_count_in_closed_loop_between_take_off_and_landing(flight: Flight) -> None:
    rows = flown_rows(flight)
    assert not rows[flight.t_s < 0.6].any() and rows[(flight.t_s >= 0.6) & (flight.t_s < 2.55)].all()
    assert not rows[flight.t_s >= 2.55].any()
    setpoint = flight.setpoints_rad
    assert setpoint is not None
    expected_deg = np.rad2deg(flight.angles_rad[rows] - setpoint[rows])
    np.testing.assert_allclose(tracking_errors_deg(flight), expected_deg)


def test_without_phases_all_of_the_closed_loop_counts(flight: Flight) -> None:
    by_hand = replace(flight, events=())
    assert flown_rows(by_hand).sum() == np.sum(flight.state == 2)


def test_a_summary_says_what_the_log_says(tmp_path: Path, flight: Flight) -> None:
    summary = summarise(read_log(tmp_path / "a.mcap"))
    errors_deg = tracking_errors_deg(flight)
    content = summary.as_dict()
    assert content["outcome"] == "completed" and summary.completed
    assert content["ticks_logged"] == 3000 and content["ticks_lost"] == 0
    assert content["duration_s"] == pytest.approx(2.999)
    assert content["rms_error_deg"]["travel"] == pytest.approx(
        np.sqrt(np.mean(errors_deg[:, Axis.TRAVEL] ** 2)), abs=1e-4
    )
    assert content["link"] == {"frames_ok": 150, "frames_bad": 0, "retries": 0, "reconnects": 0}
    assert content["plans"] == ["sine"] and content["rig"] == "makki2024"
    summary.write_json(tmp_path / "new" / "summary.json")
    assert json.loads((tmp_path / "new" / "summary.json").read_text()) == {"schema": 1, **content}


def test_a_log_that_was_not_closed_says_so_in_its_summary(tmp_path: Path) -> None:
    data = (write_made_log(tmp_path / "a.mcap", 3000), (tmp_path / "a.mcap").read_bytes())[1]
    (tmp_path / "cut.mcap").write_bytes(data[: len(data) // 2])
    summary = summarise(read_log(tmp_path / "cut.mcap"))
    assert summary.outcome.startswith("not closed") and summary.notes
    assert summary.ticks_logged == 1000


def test_an_axis_that_was_never_closed_has_no_error(tmp_path: Path) -> None:
    tick, raw = make_samples(1500)
    raw[:, Channel.STATE] = State.OPEN_LOOP
    writer = open_writer(tmp_path / "open.mcap")
    writer.write_ticks(tick, raw)
    writer.close()
    summary = summarise(read_log(tmp_path / "open.mcap"))
    assert summary.rms_error_deg == {"elevation": None, "pitch": None, "travel": None}
    assert summary.outcome == "recorded"
    json.dumps(summary.as_dict(), allow_nan=False)


@pytest.mark.slow
def test_a_figure_shows_angles_setpoints_voltages_and_states(tmp_path: Path, flight: Flight) -> None:
    summary = summarise(read_log(tmp_path / "a.mcap"))
    figure = draw(flight, summary)
    texts = [text.get_text() for axes in figure.axes for text in axes.texts]
    assert "sine" in texts and "closed loop" in texts
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    assert any(f"error {summary.rms_error_deg['travel']:.2f}° rms" in title for title in titles)
    lines = {line.get_label() for axes in figure.axes for line in axes.lines}
    assert {"measured", "setpoint", "front", "back"} <= lines
    write_figure(flight, summary, tmp_path / "new" / "figure.png")
    assert (tmp_path / "new" / "figure.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


@pytest.mark.medium
def test_a_long_flight_is_thinned_without_losing_a_peak(tmp_path: Path) -> None:
    tick, raw = make_samples(60_000)
    raw[31_234, Channel.PITCH_COUNT] = 4000
    writer = open_writer(tmp_path / "long.mcap")
    writer.write_ticks(tick, raw)
    writer.close()
    log = read_log(tmp_path / "long.mcap")
    figure = draw(log.flight(), summarise(log))
    line = next(line for line in figure.axes[1 + Axis.PITCH].lines if line.get_label() == "measured")
    points_deg = np.asarray(line.get_ydata())
    assert len(points_deg) < 10_000
    assert points_deg.max() == pytest.approx(4000 * 360 / 4096)


@pytest.mark.medium
def test_a_figure_leaves_no_trace_in_pyplot(tmp_path: Path, flight: Flight) -> None:
    write_figure(flight, summarise(read_log(tmp_path / "a.mcap")), tmp_path / "a.png")
    pyplot = sys.modules.get("matplotlib.pyplot")
    assert pyplot is None or not pyplot.get_fignums()


@pytest.mark.medium
def test_a_figure_of_an_unknown_kind_is_one_line(tmp_path: Path, flight: Flight) -> None:
    with pytest.raises(LogWriteError, match=r"\.png"):
        write_figure(flight, summarise(read_log(tmp_path / "a.mcap")), tmp_path / "a.docx")
