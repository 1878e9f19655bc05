"""Views of samples and flights in a notebook: degrees, rates, tables, figures, a text."""

from __future__ import annotations

import re
import subprocess
import sys
from base64 import b64decode
from pathlib import Path

import numpy as np
import pytest
from heli_host.data.flight import Flight, rate
from heli_host.data.log.reader import read_flight

from tests.log.made import write_made_log

COUNT_RAD = 2.0 * np.pi / 4096


@pytest.fixture(scope="module")
def flight(tmp_path_factory: pytest.TempPathFactory) -> Flight:
    path = tmp_path_factory.mktemp("made") / "a.mcap"
    write_made_log(path, 3000)
    return read_flight(path)


def test_the_packages_show_their_names_and_load_nothing_for_it() -> None:
    script = (
        "import sys, heli_host, heli_lab\n"
        "shown = [name for name in dir(heli_host) if not name.startswith('_')]\n"
        "assert shown == sorted(heli_host.__all__) and 'connect' in shown, shown\n"
        "assert [name for name in dir(heli_lab) if not name.startswith('_')] == ['linearise']\n"
        "assert not {'serial', 'numpy', 'casadi', 'mcap', 'pandas'} & set(sys.modules)\n"
    )
    subprocess.run([sys.executable, "-c", script], check=True)


def test_a_flight_says_how_long_how_fast_which_rig_and_which_states(flight: Flight) -> None:
    assert repr(flight) == (
        "<Flight: 3.0 s, 3000 rows at 1000 Hz; rig makki2024; "
        "idle 6 %, armed 2 %, closed_loop 80 %, landing 12 %>"
    )
    empty = np.zeros(0)
    assert repr(Flight(empty, empty, empty, empty, empty, empty)) == "<Flight: no rows>"


@pytest.mark.parametrize("hertz", [0.5, 1.0, 2.0])
def test_a_rate_is_the_derivative_of_what_the_encoder_counts(hertz: float) -> None:
    t_s = np.linspace(0.0, 3.999, 4000)
    angle_rad = 0.3 * np.sin(2.0 * np.pi * hertz * t_s)
    true = 0.3 * 2.0 * np.pi * hertz * np.cos(2.0 * np.pi * hertz * t_s)
    rate_rad_s = rate(t_s, np.round(angle_rad / COUNT_RAD) * COUNT_RAD)
    inside = slice(60, -60)
    # Half of the parabolas' length loses 4 % at 2 Hz; the module states the noise, which adds to this.
    assert np.abs(rate_rad_s - true)[inside].max() < 0.05 * np.abs(true).max() + np.deg2rad(0.5)
    assert np.std(rate(t_s, angle_rad)[inside]) == pytest.approx(np.std(true[inside]), rel=0.05)


def test_no_rate_is_taken_across_a_gap() -> None:
    t_s = np.delete(np.linspace(0.0, 0.999, 1000), slice(400, 600))
    angle_rad = np.where(t_s < 0.5, 0.0, 1.0)
    np.testing.assert_allclose(rate(t_s, angle_rad), 0.0, atol=1e-12)
    assert np.isnan(rate(t_s[:3], angle_rad[:3])).all()


@pytest.mark.medium
def test_a_table_of_pandas_has_every_column_degrees_and_rates(flight: Flight) -> None:
    table = flight.dataframe()
    assert table.index.name == "t_s" and len(table) == len(flight)
    for name, column in flight.columns().items():
        if name != "t_s":
            np.testing.assert_array_equal(table[name], column)
    np.testing.assert_allclose(table["travel_deg"], np.rad2deg(flight.travel_rad))
    np.testing.assert_array_equal(table["pitch_rate_deg_s"], flight.pitch_rate_deg_s)


@pytest.mark.medium
def test_without_pandas_everything_else_works(flight: Flight, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ImportError):
        flight.dataframe()
    assert flight.elevation_rate_deg_s.shape == flight.t_s.shape


@pytest.mark.medium
def test_a_notebook_gets_the_text_and_a_small_figure(flight: Flight) -> None:
    shown = flight._repr_html_()
    assert "&lt;Flight: 3.0 s" in shown
    embedded = re.search(r'base64,([^"]+)"', shown)
    assert embedded is not None
    picture = b64decode(embedded[1])
    assert picture[:8] == b"\x89PNG\r\n\x1a\n" and len(picture) < 80_000
    assert int.from_bytes(picture[16:20]) == 640 and int.from_bytes(picture[20:24]) == 320


def test_an_export_has_the_counts(flight: Flight, tmp_path: Path) -> None:
    for axis in ("elevation", "pitch", "travel"):
        counts = flight.extra[f"{axis}_count"]
        np.testing.assert_array_equal(counts, np.rint(getattr(flight, f"{axis}_rad") / COUNT_RAD))
