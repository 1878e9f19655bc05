"""One law, four places: numpy, over the link, a tape on the board, and C."""

import ctypes
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import casadi as ca
import heli_host
import numpy as np
import numpy.typing as npt
import pytest
from heli_host.board.law_program import hash_of
from heli_host.data.arrays import Floats
from heli_host.data.log.reader import read_log
from heli_host.data.log.summary import summarise
from heli_host.data.response import responses
from heli_host.declaration import LAW_INPUTS
from heli_host.errors import BadLaw
from heli_host.fly.recorder import Recorder
from heli_lab.control.law import c_source
from heli_lab.control.law_flight import flight_of_law
from heli_lab.control.streamed import Streamed
from heli_lab.law import Command, Law, control_law, from_function, from_gain, from_state_space
from heli_test_native import law as native_law

from tests.law.flown import LAWS, law_of
from tests.running.long import LONG

NAMES = tuple(sorted(path.stem for path in LAWS.glob("*.py")))


class Compiled:
    """A law's C, called step by step as `heli_lab.control.law.Runner` is."""

    def __init__(self, law: Law, folder: Path) -> None:
        compiler = shutil.which("cc")
        if compiler is None:
            pytest.skip("no C compiler on PATH")
        source, library = folder / "law.c", folder / "law.so"
        source.write_text(c_source(law))
        subprocess.run([compiler, "-O1", "-shared", "-fPIC", source, "-o", library, "-lm"], check=True)
        self.call = ctypes.CDLL(str(library)).law
        self.state = np.array([*law.states.values()], np.float32)
        self.parameters = np.array([*law.parameters.values()], np.float32)
        self.outputs = np.zeros(5 + len(law.signals), np.float32)
        self.work = np.zeros(max(1, law.evaluated.sz_w()), np.float32)

    def __call__(self, inputs: Floats) -> Floats:
        def pointers(*arrays: npt.NDArray[np.float32]) -> ctypes.Array[ctypes.c_void_p]:
            return (ctypes.c_void_p * len(arrays))(*(array.ctypes.data for array in arrays))

        new = self.state.copy()
        given = inputs.astype(np.float32)
        arguments = pointers(given, self.state, self.parameters)
        self.call(arguments, pointers(self.outputs, new), None, ctypes.c_void_p(self.work.ctypes.data), 0)
        self.state = new
        return self.outputs.astype(float)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES if LONG else ("feedback_linearisation",))
def test_numpy_tape_and_c_give_the_same_to_single_precision(name: str, tmp_path: Path) -> None:
    law = law_of(LAWS / f"{name}.py")
    chance = np.random.default_rng(4)
    inputs = chance.normal(scale=0.05, size=(40, len(LAW_INPUTS))).astype(np.float32)
    tape = native_law.Tape()
    assert tape.load(law.program.words, law.program.hash) == (0, law.program.cost, law.program.ticks)
    on_board = tape.run(np.ascontiguousarray(inputs))
    runner, compiled = law.runner(), Compiled(law, tmp_path)
    for row, computed in zip(inputs.astype(float), on_board, strict=True):
        wanted = runner(row)
        # Gains of some hundred volts a radian amplify the last bit of single precision.
        np.testing.assert_allclose(computed, wanted, rtol=1e-4, atol=2e-4)
        np.testing.assert_allclose(compiled(row), wanted, rtol=1e-4, atol=2e-4)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES if LONG else ("lqr",))
@pytest.mark.parametrize("place", ["numpy", "c"])
def test_a_law_flies_over_the_link_and_its_errors_are_reported(name: str, place: str, tmp_path: Path) -> None:
    law = law_of(LAWS / f"{name}.py")
    log = tmp_path / "streamed.mcap"
    with heli_host.connect("sil://", land_on_exit=True) as heli, Recorder(heli, log):
        heli.take_off()
        runner = law.runner() if place == "numpy" else Compiled(law, tmp_path)
        streamed = Streamed(runner, law.dt_s, heli.params)
        streamed.follow(travel=np.radians(20.0))
        report = heli.run_controller(streamed, rate_Hz=min(200.0, law.rate_Hz), duration_s=6.0)
        assert report.takeovers == 0
        assert abs(heli.latest.travel_deg - 20.0) < 10.0
    flight = read_log(log).flight()
    in_flight = flight.state == next(k for k, name in flight.state_names.items() if name == "streamed")
    assert flight.travel_setpoint_rad is not None
    error_deg = np.degrees(flight.travel_rad - flight.travel_setpoint_rad)[in_flight]
    assert 0.2 < float(np.sqrt(np.mean(error_deg**2))) < 6.0
    worst = summarise(read_log(log)).max_error_deg["travel"]
    assert worst is not None
    assert worst == pytest.approx(np.abs(error_deg).max(), abs=0.3)


@pytest.mark.medium
def test_the_names_of_signals_travel_into_log_tables_and_figures(tmp_path: Path) -> None:
    from heli_host.data.log.figure import draw
    from heli_host.data.log.reader import read_flight
    from heli_host.data.log.table import export_mat, export_parquet, write_csv
    from scipy.io import loadmat

    law = law_of(LAWS / "sliding_mode.py")
    log = tmp_path / "a.mcap"
    with heli_host.connect("sil://", land_on_exit=True) as heli:
        heli.take_off()
        with Recorder(heli, log):
            heli.setpoint(travel_deg=10.0)
            heli.fly_law(law.program, duration_s=5.0)
    flight = read_log(log).flight()
    assert law.signals == ("slide_elevation", "slide_travel")
    assert set(law.signals) < set(flight.extra)
    assert "signal_1" not in flight.extra
    assert np.ptp(flight.extra["slide_travel"]) > 0.01
    export_mat(flight, tmp_path / "a.mat")
    assert loadmat(tmp_path / "a.mat")["slide_travel"].shape == (len(flight), 1)
    export_parquet(flight, tmp_path / "a.parquet")
    parquet = pytest.importorskip("pyarrow.parquet")
    assert "slide_elevation" in parquet.read_schema(tmp_path / "a.parquet").names
    write_csv(flight, tmp_path / "a.csv")
    assert "slide_elevation" in read_flight(tmp_path / "a.csv").extra
    legends = [panel.get_legend() for panel in draw(flight, summarise(read_log(log))).axes]
    labels = [text.get_text() for legend in legends if legend is not None for text in legend.get_texts()]
    assert {"slide_elevation", "slide_travel"} < set(labels)
    of_law = flight_of_law(log)
    assert 4.0 < of_law.duration_s < 6.0
    _, _, travel = responses(of_law)
    assert 0.1 < travel.rms_deg < 5.0


def test_a_law_compiles_to_what_is_needed_and_no_more() -> None:
    @control_law(states={"x": 0.0}, parameters={"k": 2.0})
    def law(now, state, parameter):  # type: ignore[no-untyped-def]
        wasted = now.travel_rad * 1.0 + 0.0
        front = 0.5 * now.pitch_rad - 0.25 * now.elevation_rad + parameter.k * state.x + wasted - 3.0
        return Command(front, 1.0, states={"x": state.x})

    codes = [instruction.code for instruction in law.program.instructions]
    # One sum of five products; and a copy of the state, which may not be read once it is written.
    assert len(codes) == 2
    assert max(len(instruction.terms) for instruction in law.program.instructions) == 5


@pytest.mark.slow
@pytest.mark.parametrize("board", ["native", "due"])
def test_a_law_flies_where_no_compiler_is_on_the_path(board: str, tmp_path: Path) -> None:
    if board == "due":
        pytest.importorskip("due_emulator._due", reason="the emulated Due is not built: make setup")
    (tmp_path / "bin").mkdir()
    start = "from heli_host.ui.cli.entry import main; main()"
    command = [
        "law",
        "fly",
        str(LAWS / "lqr.py"),
        "--sil",
        "--speed",
        "max",
        "--board",
        board,
        "--duration",
        "2",
    ]
    process = subprocess.run(
        [sys.executable, "-c", start, *command],
        capture_output=True, text=True, check=False, env={**os.environ, "PATH": str(tmp_path / "bin")},
    )  # fmt: skip
    assert process.returncode == 0, process.stderr
    assert "RMS error" in process.stdout


# ruff: noqa: E501  -- a row each


def law(function: Callable[..., Any], **options: Any) -> Law:
    made: Law = control_law(**options)(function)
    made.program  # noqa: B018  -- made when asked for
    return made


def of_the_wrong_shape() -> Law:
    import control

    return from_state_space(control.ss(1, 1, 1, 0), hover_V=1.4)


BAD_SOURCES: dict[str, tuple[Callable[[], Any], str]] = {
    "a gain of the wrong shape": (lambda: from_gain(np.eye(3), hover_V=1.4), "give 2 x 6"),
    "a gain that is no number": (
        lambda: from_gain(np.diag([1.0, np.nan]) @ np.ones((2, 6)), hover_V=1.4),
        "the gain of differential on elevation_rad is nan",
    ),
    "gains in words": (lambda: from_gain("1 2 3", hover_V=1.4), "no array of numbers"),
    "a rate that is no number": (
        lambda: from_gain(np.ones((2, 6)), hover_V=1.4, rate_Hz=np.nan),
        "rate_Hz is nan",
    ),
    "a system of the wrong shape": (of_the_wrong_shape, "6 inputs"),
    "a function of the wrong shape": (
        lambda: from_function(ca.Function("f", [ca.SX.sym("x", 3)], [ca.SX(2, 1)])), "write it with [17",
    ),
}  # fmt: skip


@pytest.mark.medium
@pytest.mark.parametrize("name", BAD_SOURCES)
def test_a_bad_gain_system_or_function_is_one_line_with_its_remedy(name: str) -> None:
    make, remedy = BAD_SOURCES[name]
    with pytest.raises(BadLaw) as caught:
        make()
    assert "\n" not in str(caught.value)
    assert remedy in str(caught.value)
    assert caught.value.remedy


@pytest.mark.medium
def test_any_words_above_a_valid_hash_are_refused_or_run_within_the_tape() -> None:
    chance = np.random.default_rng(5)
    good = np.array(law(lambda n, s, p: Command(n.pitch_rad * s.x + p.k, ca.atan2(n.travel_rad, 2.0), states={"x": n.front_V}), states={"x": 1.0}, parameters={"k": 2.0}).program.words, np.uint32)  # fmt: skip
    tape, accepted = native_law.Tape(), 0
    inputs = chance.normal(size=(3, 17)).astype(np.float32)
    for _ in range(20_000):
        words = good.copy()
        for _ in range(int(chance.integers(1, 4))):
            words[chance.integers(len(words))] ^= np.uint32(1 << int(chance.integers(32)))
        words = words[: len(words) - int(chance.integers(0, 2))]
        error, _, ticks = tape.load(words.tolist(), hash_of(words.tolist()))
        if error == 0:
            accepted += 1
            assert 1 <= ticks <= 16
            tape.run(inputs)
    assert 100 < accepted < 19_000


@pytest.mark.medium
def test_an_upload_that_ends_anywhere_leaves_no_law() -> None:
    words = law(lambda n, s, p: Command(n.pitch_rad + 1.0, 1.0)).program.words
    for length in range(len(words)):
        tape = native_law.Tape()
        assert tape.load(words[:length], hash_of(words))[0] != 0
        with pytest.raises(ValueError, match="no law"):
            tape.restart()
