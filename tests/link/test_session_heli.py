"""The interface that people use: degrees, names, one-line errors, and files of parameters."""

import inspect
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import heli_host
import numpy as np
import pytest
from heli_host import declaration as d
from heli_host import errors
from heli_host.board.heli import Heli
from heli_host.board.parameters import parameters_text, read_parameter_set
from heli_host.board.samples import Sample, SampleRing, Samples
from heli_host.errors import (
    CommandRefused,
    ControllerError,
    ParameterError,
    PlanError,
    SetpointError,
    WaitTimeout,
)
from heli_host.link.frames import Frame
from heli_host.link.session import Session
from heli_host.link.telemetry import Ticks
from heli_host.ui.cli import run
from heli_host.ui.cli.options import chosen_parameters
from heli_lab.apps.campaign import works
from heli_lab.apps.campaign.cases import Campaign

from tests.link.fake_board import FakeBoard, FakeLine, truth

RAD_PER_COUNT = 2.0 * math.pi / 4096.0


def connected(board: FakeBoard, **options: Any) -> Heli:
    session = Session(FakeLine(board))
    session.connect()
    return Heli(session, **options)


def setpoints(board: FakeBoard) -> list[d.SetpointMessage]:
    return [
        d.SetpointMessage.unpack(frame.payload)
        for _, frame in board.heard
        if frame.id == d.MessageId.SETPOINT
    ]


def executed(board: FakeBoard) -> list[d.MessageId]:
    return [d.MessageId(done[0]) for done in board.executed]


@pytest.mark.medium
def test_samples_are_the_raw_channels_in_units(heli: Heli) -> None:
    heli.wait(3.0)
    samples = heli.samples(last_s=1.0)
    assert len(samples) == 1000
    assert (np.diff(samples.tick) == 1).all()
    np.testing.assert_allclose(samples.t_s, samples.tick * 1e-3)
    raw = np.array([truth(int(tick)) for tick in samples.tick])
    for axis in d.AXES:
        counts = raw[:, d.Channel[f"{axis}_count".upper()]]
        np.testing.assert_allclose(getattr(samples, f"{axis}_rad"), counts * RAD_PER_COUNT)
        setpoints_raw = raw[:, d.Channel[f"{axis}_setpoint".upper()]]
        np.testing.assert_allclose(getattr(samples, f"{axis}_setpoint_rad"), setpoints_raw * 1e-5)
    np.testing.assert_allclose(samples.front_V, raw[:, d.Channel.FRONT] * 1e-3)
    np.testing.assert_allclose(samples.back_V, raw[:, d.Channel.BACK] * 1e-3)
    latest = heli.latest
    assert latest.tick == samples.tick[-1]
    for axis in d.AXES:
        angle_rad = getattr(samples, f"{axis}_rad")[-1]
        assert getattr(latest, f"{axis}_deg") == pytest.approx(math.degrees(angle_rad))
    assert latest.state is d.State.IDLE


def test_a_negative_count_parameter_reverses_on_the_board_not_again_here(board: FakeBoard) -> None:
    board.params[d.Param.PITCH_COUNTS_PER_REV] = -2048.0
    sample = connected(board).latest
    assert sample.pitch_rad == pytest.approx(
        truth(sample.tick)[d.Channel.PITCH_COUNT] * 2.0 * math.pi / 2048.0
    )


def test_the_ring_keeps_the_newest_whatever_the_pieces() -> None:
    ring = SampleRing(100)
    tick = 2**32 - 150
    for size in (1, 99, 100, 30, 70, 250, 7):
        numbers = (np.arange(size) + tick).astype(np.uint32)
        ring.append(Ticks(numbers, np.repeat(numbers.view(np.int32)[:, None], len(d.Channel), axis=1)))
        tick += size
    newest = ring.newest()
    assert newest.tick.tolist() == [(tick - 100 + k) % 2**32 for k in range(100)]
    assert (newest.raw == newest.tick.view(np.int32)[:, None]).all()
    assert ring.newest(3).tick.tolist() == newest.tick.tolist()[-3:]


def test_leaving_the_block_stops_motors_where_asked_to(board: FakeBoard) -> None:
    with connected(board, land_on_exit=False) as heli:
        heli.arm()
        heli.control()
    assert executed(board)[-1] == d.MessageId.STOP
    assert board.state is d.State.IDLE


def test_leaving_the_block_by_an_error_on_the_table_stops_the_motors(heli: Heli, board: FakeBoard) -> None:
    with pytest.raises(KeyboardInterrupt), heli:
        heli.arm()
        raise KeyboardInterrupt
    assert executed(board) == [d.MessageId.ARM, d.MessageId.STOP]


def test_a_heli_without_a_function_for_plans_says_where_it_is(heli: Heli, board: FakeBoard) -> None:
    with heli, pytest.raises(PlanError, match="give fly_plans=heli_host"):
        heli.fly("hover")
    assert executed(board) == []


def test_a_failed_callback_does_not_keep_the_motors_running(heli: Heli, board: FakeBoard) -> None:
    def fail(_: Samples) -> None:
        raise ValueError("full")

    with pytest.raises(heli_host.HeliError, match="full"), heli:
        heli.arm()
        heli.on_ticks(fail)
        heli.wait(1.0)
    assert executed(board)[-1] == d.MessageId.STOP


def test_leaving_the_block_in_the_air_lands(heli: Heli, board: FakeBoard) -> None:
    with heli:
        heli.arm()
        heli.control()
    assert executed(board)[-1] == d.MessageId.LAND


def test_a_landing_of_the_board_is_waited_for_and_not_cut(heli: Heli, board: FakeBoard) -> None:
    """An emergency landing after a landing lasts longer than ``landing_timeout_s``."""
    with heli:
        heli.arm()
        heli.control()
        board.state = d.State.EMERGENCY_LANDING
        heli.wait(0.1)
        landed_tick = heli.latest.tick + round(1.8e3 * heli.params["landing_timeout_s"])

        def land(samples: Samples) -> None:
            if len(samples) and samples.tick[-1] >= landed_tick:
                board.state = d.State.FAULT

        heli.on_ticks(land)
        with pytest.raises(heli_host.HeliError, match="fault "):
            heli.land()
        assert heli.latest.tick >= landed_tick
    assert d.MessageId.STOP not in executed(board)


def test_leaving_the_block_while_idle_commands_nothing(heli: Heli, board: FakeBoard) -> None:
    with heli:
        pass
    assert board.executed == []


def test_closing_the_loops_first_aims_where_the_arm_is(board: FakeBoard, heli: Heli) -> None:
    heli.arm()
    heli.control()
    limits = heli.setpoint_limits_deg()
    aimed = setpoints(board)[0]
    assert (
        math.radians(limits["elevation"][0]) - 1e-6
        <= aimed.elevation_rad
        <= math.radians(limits["elevation"][1]) + 1e-6
    )
    assert aimed.pitch_rad == 0.0


def test_a_setpoint_keeps_what_it_does_not_name_and_lies_ahead_in_device_time(
    board: FakeBoard, heli: Heli
) -> None:
    heli.arm()
    heli.control()
    heli.setpoint(elevation_deg=10.0, travel_deg=-20.0)
    heli.setpoint(travel_deg=30.0, lead_s=0.1)
    # The second waits for the rate limit, leaves at the end of a reading, and is heard with the next.
    heli.wait(0.04)
    heli.wait(0.04)
    sent = next(
        setpoint
        for setpoint in setpoints(board)
        if math.isclose(setpoint.travel_rad, math.radians(30.0), rel_tol=1e-6)
    )
    assert sent.elevation_rad == pytest.approx(math.radians(10.0))
    assert 0 < sent.apply_tick - board.tick < 100
    heli.wait(1.0)
    assert setpoints(board)[-1] == sent


@pytest.mark.medium
def test_without_keep_alive_the_board_is_left_to_its_failsafe(board: FakeBoard) -> None:
    heli = connected(board, keep_alive=False)
    heli.arm()
    heli.control()
    heli.setpoint(elevation_deg=1.0)
    heli.wait(0.1)
    before = len(setpoints(board))
    heli.wait(3.0)
    assert len(setpoints(board)) == before
    heli.keep_alive = True
    heli.wait(1.0)
    assert len(setpoints(board)) > before + 5


@pytest.mark.parametrize(
    ("axis", "value_deg", "range_text"),
    [
        ("elevation", 22.5, "-26 to 22"),
        ("travel", -171.0, "-170 to 170"),
        ("pitch", 31.0, "-30 to 30"),
        ("travel", math.nan, "-170 to 170"),
    ],
)
def test_a_setpoint_outside_the_boards_limits_is_not_sent(
    board: FakeBoard, heli: Heli, axis: str, value_deg: float, range_text: str
) -> None:
    with pytest.raises(
        SetpointError, match=f"{axis} setpoint of .* is outside the board's limits; give {range_text}"
    ):
        heli.setpoint(**{f"{axis}_deg": value_deg})
    heli.wait(0.5)
    assert setpoints(board) == []


def test_limits_are_those_of_the_boards_parameters(board: FakeBoard) -> None:
    board.params[d.Param.ELEVATION_MAX_DEG] = 12.0
    with pytest.raises(SetpointError, match="-26 to 10 degrees"):
        connected(board).setpoint(elevation_deg=11.0)


def test_voltages_outside_the_boards_limits_are_not_sent(board: FakeBoard, heli: Heli) -> None:
    with pytest.raises(SetpointError, match="give 0 to 10 V"):
        heli.voltages(front_V=11.0, back_V=3.0)
    heli.voltages(front_V=2.0, back_V=3.0, valid_s=0.02)
    heli.wait(0.01)
    sent_values = [
        d.VoltagesMessage.unpack(frame.payload)
        for _, frame in board.heard
        if frame.id == d.MessageId.VOLTAGES
    ]
    assert sent_values == [d.VoltagesMessage(front_V=2.0, back_V=3.0, valid_ms=20)]


def test_excitations_go_by_name_and_a_wrong_name_lists_the_right_ones(board: FakeBoard, heli: Heli) -> None:
    heli.excite("chirp", front_V=0.25, back_V=-0.5, start_Hz=0.5, stop_Hz=4.0, duration_s=8.0)
    sent = d.ExciteMessage.unpack(b"\0" + board.executed[-1][1:])
    assert sent == d.ExciteMessage(
        request=0,
        kind=d.Excitation.CHIRP,
        front_V=0.25,
        back_V=-0.5,
        start_Hz=0.5,
        stop_Hz=4.0,
        duration_s=8.0,
        seed=1,
    )
    with pytest.raises(ParameterError, match="unknown excitation wobble; choose from step, doublet"):
        heli.excite("wobble", front_V=1.0)


@pytest.mark.medium
def test_waiting_for_what_does_not_happen_ends_in_device_time(heli: Heli) -> None:
    began = heli.latest.tick
    with pytest.raises(WaitTimeout, match="did not happen within 2 s"):
        heli.wait_until(lambda sample: sample.state is d.State.FAULT, 2.0)
    assert 2000 <= heli.latest.tick - began <= 2100


def test_parameters_read_set_and_save_by_name(board: FakeBoard, heli: Heli) -> None:
    assert heli.params["hover_V"] == d.PARAMS[d.Param.HOVER_V].default
    heli.params["elevation_kd"] = 0.35
    assert heli.params["elevation_kd"] == 0.35
    assert board.params[d.Param.ELEVATION_KD] == pytest.approx(0.35)
    heli.params.save()
    assert executed(board) == [d.MessageId.PARAM_SET, d.MessageId.PARAMS_SAVE]
    assert list(heli.params) == [spec.name for spec in d.PARAMS]


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("hover_v", 1.0, "unknown parameter hover_v; did you mean hover_V"),
        ("hover_V", 21.0, "hover_V = 21 is out of range; give a number from 0 to 20 V"),
        ("hover_V", math.nan, "hover_V = nan is out of range"),
        ("pitch_counts_per_rev", 0.0, "not 0"),
        ("telemetry_batch_ticks", 4.5, "a whole number from 4 to 32"),
    ],
)
def test_a_bad_parameter_is_one_line_with_the_range_and_nothing_is_sent(
    heli: Heli, board: FakeBoard, name: str, value: float, words: str
) -> None:
    with pytest.raises(ParameterError) as caught:
        heli.params[name] = value
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)
    assert board.executed == []


def test_a_dump_restores_what_differs_and_only_that(heli: Heli) -> None:
    dump = heli.params.dump()
    heli.params["elevation_kp"] = 0.75
    heli.params["hover_V"] = 2.0
    assert heli.params.restore(dump) == {"elevation_kp": dump["elevation_kp"], "hover_V": dump["hover_V"]}
    assert heli.params.dump() == dump


def test_a_dump_of_which_one_value_is_refused_changes_nothing(board: FakeBoard, heli: Heli) -> None:
    before = heli.params.dump()
    execute = board._execute

    def refuse_supply(frame: Frame) -> bytes:
        is_set = frame.id == d.MessageId.PARAM_SET
        if is_set and d.ParamSetMessage.unpack(frame.payload).index == d.Param.SUPPLY_V:
            board.refusals[d.MessageId.PARAM_SET] = (d.Result.UNSAFE_NOW, d.Param.SUPPLY_V, 0.0)
        reply = execute(frame)
        board.refusals.clear()
        return reply

    board._execute = refuse_supply  # type: ignore[method-assign]
    with pytest.raises(CommandRefused, match="supply_V may only be set while idle; land first, or stop"):
        heli.params.restore({"hover_V": 2.0, "pitch_kp": 0.5, "supply_V": 13.0, "pitch_kd": 0.5})
    assert heli.params.dump() == before


def test_a_control_law_faster_than_telemetry_allows_is_refused_before_anything_moves(
    heli: Heli, board: FakeBoard
) -> None:
    with pytest.raises(ControllerError, match="at most 250 Hz"):
        heli.run_controller(lambda _: (0.0, 0.0), rate_Hz=500.0, duration_s=1.0)
    assert board.executed == []


@pytest.mark.medium
def test_a_control_law_runs_on_device_time_and_hands_over_to_the_board_afterwards(
    board: FakeBoard, heli: Heli
) -> None:
    heli.arm()
    received: list[int] = []

    def law(sample: Sample) -> tuple[float, float]:
        received.append(sample.tick)
        return 1.0, 99.0

    report = heli.run_controller(law, rate_Hz=50.0, duration_s=2.0)
    assert report.calls == len(received) == 100
    assert report.misses == 0
    assert report.clipped == 100
    assert report.rate_Hz == pytest.approx(50.0)
    assert (np.diff(received) == 20).all()
    assert board.state is d.State.CLOSED_LOOP
    assert board.params[d.Param.TELEMETRY_BATCH_TICKS] == d.PARAMS[d.Param.TELEMETRY_BATCH_TICKS].default
    assert "100 calls at 50.0 Hz" in str(report)


@pytest.mark.parametrize(
    ("law", "words"),
    [
        (lambda _: 1 / 0, "the control law failed: ZeroDivisionError"),
        (lambda _: 1.0, "for every sample"),
        (lambda _: (math.nan, 0.0), "returned nan and 0 V"),
    ],
)
def test_a_control_law_that_fails_leaves_the_board_holding_its_position(
    board: FakeBoard, heli: Heli, law: Callable[[Sample], tuple[float, float]], words: str
) -> None:
    heli.arm()
    with pytest.raises(ControllerError, match=words):
        heli.run_controller(law, duration_s=1.0)
    assert board.state is d.State.CLOSED_LOOP
    assert board.params[d.Param.TELEMETRY_BATCH_TICKS] == d.PARAMS[d.Param.TELEMETRY_BATCH_TICKS].default


@pytest.fixture
def simulated() -> str:
    pytest.importorskip("heli_sim._native")
    return "sil://?seed=3"


@pytest.mark.medium
def test_ten_lines_fly_a_simulated_board(simulated: str) -> None:
    with heli_host.connect(simulated) as heli:
        heli.take_off(elevation_deg=0.0)
        heli.setpoint(travel_deg=20.0)
        heli.wait(12.0)
        reached = heli.latest
        heli.land()
        samples = heli.samples()
        counters = heli.counters
    assert abs(reached.elevation_deg) < 1.0
    assert reached.travel_deg == pytest.approx(20.0, abs=1.0)
    assert (counters.ticks_lost, counters.frames_bad, counters.retries) == (0, 0, 0)
    assert samples.elevation_rad[-1] < math.radians(-20.0)
    assert samples.front_V[-1] == 0.0


@pytest.mark.medium
def test_the_same_simulated_session_twice_is_the_same(simulated: str) -> None:
    flown = []
    for _ in range(2):
        with heli_host.connect(simulated) as heli:
            heli.take_off(elevation_deg=5.0)
            heli.wait(2.0)
            heli.land()
            flown.append((heli.samples(), [event.text for event in heli.events], heli.counters))
    assert flown[0][1:] == flown[1][1:]
    for name in Samples.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(flown[0][0], name), getattr(flown[1][0], name))


@pytest.mark.medium
def test_a_200_Hz_law_in_python_flies_the_simulated_board_and_its_latency_is_measured(simulated: str) -> None:
    with heli_host.connect(simulated) as heli:
        heli.take_off()
        before: list[Sample] = [heli.latest]

        def law(sample: Sample) -> tuple[float, float]:
            step_s = max(sample.t_s - before[0].t_s, 1e-3)
            climb_deg_s = (sample.elevation_deg - before[0].elevation_deg) / step_s
            roll_deg_s = (sample.pitch_deg - before[0].pitch_deg) / step_s
            before[0] = sample
            both_V = 3.4 - 0.5 * sample.elevation_deg - 0.2 * climb_deg_s
            apart_V = -0.4 * sample.pitch_deg - 0.1 * roll_deg_s
            return (both_V + apart_V) / 2.0, (both_V - apart_V) / 2.0

        report = heli.run_controller(law, rate_Hz=200.0, duration_s=5.0)
        assert abs(heli.latest.elevation_deg) < 5.0
        heli.land()
    assert report.rate_Hz == pytest.approx(200.0, abs=1.0)
    assert report.misses == 0
    assert report.takeovers == 0
    assert report.latency_count > 20
    # A batch of 5 ticks takes 4 ms to fill, 3 to send, and its bridge hands it over every 4 ms.
    assert 4.0 <= report.latency_p50_ms <= 12.0


def test_a_setpoint_for_a_board_whose_loops_are_open_is_an_error(board: FakeBoard, heli: Heli) -> None:
    with pytest.raises(SetpointError, match="the board is idle, and does not follow setpoints"):
        heli.setpoint(elevation_deg=1.0)
    heli.arm()
    with pytest.raises(SetpointError, match="the board is armed"):
        heli.setpoint(elevation_deg=1.0)
    heli.wait(0.5)
    assert setpoints(board) == []
    heli.control()
    heli.setpoint(elevation_deg=1.0)


DEFAULTS = {spec.name: spec.default for spec in d.PARAMS}


def written(folder: Path, *changes: tuple[str, str]) -> Path:
    """A dump in which texts were replaced."""
    text = parameters_text({**DEFAULTS, "hover_V": 1.75}, "a board")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    file = folder / "parameters.toml"
    file.write_text(text, encoding="utf-8")
    return file


OTHER = (f"{d.PARAMS_HASH:08x}", f"{d.PARAMS_HASH ^ 1:08x}")


def test_a_file_of_the_same_schema_is_taken_whole(tmp_path: Path) -> None:
    parameter_set = read_parameter_set(written(tmp_path))
    assert parameter_set.values == {**DEFAULTS, "hover_V": 1.75}
    assert (parameter_set.dropped, parameter_set.new) == ((), ())


def test_a_file_of_another_schema_keeps_what_is_known(tmp_path: Path) -> None:
    changes = (OTHER, ("hover_slope =", "hover_curve ="))
    parameter_set = read_parameter_set(written(tmp_path, *changes))
    assert parameter_set.values["hover_V"] == 1.75
    assert len(parameter_set.values) == len(d.PARAMS) - 1
    assert parameter_set.dropped == ("unknown parameter hover_curve",)
    assert parameter_set.new == ("hover_slope",)


def test_a_value_out_of_the_new_range_is_dropped_and_named(tmp_path: Path) -> None:
    parameter_set = read_parameter_set(written(tmp_path, OTHER, ("hover_V = 1.75", "hover_V = 1e6")))
    assert "hover_V" not in parameter_set.values
    assert parameter_set.dropped == ("hover_V = 1e+06 is out of range",)


def test_a_value_in_another_unit_is_dropped_and_named(tmp_path: Path) -> None:
    parameter_set = read_parameter_set(written(tmp_path, OTHER, ('hover_V = "V"', 'hover_V = "mV"')))
    assert "hover_V" not in parameter_set.values
    assert parameter_set.dropped == ("hover_V was in mV and is in V now",)


def test_fly_takes_known_values_of_another_schema_and_lists_the_others(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = written(tmp_path, OTHER, ("hover_slope =", "hover_curve ="))
    values = chosen_parameters(file, None)
    assert values["hover_V"] == 1.75
    assert "hover_curve" not in values
    assert capsys.readouterr().out == "dropped: unknown parameter hover_curve\n"


@pytest.mark.medium
def test_a_campaign_takes_known_values_of_another_schema_and_lists_the_others(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    file = written(tmp_path, OTHER, ("hover_slope =", "hover_curve ="))
    campaign = tmp_path / "study.toml"
    campaign.write_text(f'work = "gains"\n[cases]\nparams = ["{file.name}", ""]\n')
    tried_parameters = []

    def tried(plant: object, parameters: dict[str, float], *rest: object) -> None:
        tried_parameters.append(parameters)
        raise KeyboardInterrupt

    monkeypatch.setattr("heli_lab.control.tune.trial.try_gains", tried)
    monkeypatch.setattr("heli_lab.apps.campaign.run.run_campaign", first_case)
    assert run(["campaign", str(campaign), "-o", str(tmp_path / "out")]) == 2
    assert f"{file}: dropped: unknown parameter hover_curve\n" in capsys.readouterr().out
    assert tried_parameters[0]["hover_V"] == 1.75
    assert "hover_curve" not in tried_parameters[0]


def first_case(campaign: Campaign, *_: object, **__: object) -> None:
    """Do the first case in this process."""
    works.gains(campaign.cases[0].settings)


def test_under_its_own_schema_a_wrong_value_refuses_the_file(tmp_path: Path) -> None:
    with pytest.raises(ParameterError, match="hover_V"):
        read_parameter_set(written(tmp_path, ("hover_V = 1.75", "hover_V = 1e6")))


def printed_tree() -> dict[str, str]:
    """Parent of every class in the tree at the top of the file, by its depth of indentation."""
    parents: dict[str, str] = {}
    path = ["Exception"]
    for line in (errors.__doc__ or "").splitlines():
        entry = re.match(r"^    ([│ ├└─]*)([A-Z]\w+) ", line)
        if entry:
            depth = len(entry[1]) // 4
            del path[depth + 1 :]
            parents[entry[2]] = path[-1]
            path.append(entry[2])
    return parents


def test_the_printed_tree_is_the_tree() -> None:
    classes = {
        name: thing.__mro__[1].__name__
        for name, thing in vars(errors).items()
        if inspect.isclass(thing) and issubclass(thing, Exception)
    }
    assert printed_tree() == classes


def test_a_message_is_one_line_whatever_goes_into_it() -> None:
    assert str(errors.PlanError("two\nlines ", " of\n\ttext")) == "two lines; of text"
    assert str(errors.PlanError("cause alone")) == "cause alone"


def test_every_fault_says_its_name_its_limit_and_its_remedy() -> None:
    for spec in d.FAULTS:
        text = errors.fault_text(spec.code)
        assert text.startswith(f"{spec.name}: ")
        assert text.endswith(spec.remedy)
        assert spec.parameter is None or spec.parameter in text
    assert errors.fault_text(0) == "no fault"
    assert "unknown to this host" in errors.fault_text(250)


def test_every_parameter_says_its_range_in_words() -> None:
    for spec in d.PARAMS:
        text = errors.range_text(d.Param(spec.index))
        if spec.name.endswith("_sign"):
            assert text == "-1 or 1"
            continue
        assert f"{spec.min:g} to {spec.max:g}" in text
        assert ("whole" in text) == spec.integer
        assert ("not 0" in text) == spec.nonzero
