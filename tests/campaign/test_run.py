"""A campaign's file makes the cases that it states; complete results are stored, and cases have limits."""

import math
import os
import pickle
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from heli_lab.apps.campaign import Campaign, Case, JobResult, Store, campaign_results, run_campaign, works
from heli_lab.apps.campaign.cases import Limits
from heli_lab.apps.campaign.file import load_campaign
from heli_lab.apps.campaign.run import CampaignProgress
from heli_lab.apps.campaign.worker import CodeMismatchError, Job, WorkerProcess, code_difference, run_job
from heli_lab.apps.campaign.works import draw_rig
from heli_lab.code_digest import code_digest
from heli_lab.errors import CampaignError
from heli_lab.fit.flight_model import model_functions
from heli_lab.fit.identification import identify
from heli_lab.fit.problem import Budget, Problem
from heli_lab.fit.records import prepare
from heli_lab.fit.shooting import solve
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import parse_effects
from heli_sim.rig import load_rig
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.campaign.killer import Cluster, PATIENCE_s, free_port, kill_all, start_program
from tests.diagnose.hidden import flights
from tests.identify.made import thinned

CASES = tuple(Case(f"case {n}", "tests.campaign.works:count", {"number": n}) for n in range(4))
CAMPAIGN = Campaign("squares", CASES, Limits(30.0, 300.0))


def run(folder: Path) -> list[dict[str, object]]:
    return run_campaign(CAMPAIGN, Store(folder), code="test", processes=2)


def logged(folder: Path, log: Path) -> Campaign:
    cases = tuple(Case(c.name, c.work, {**c.settings, "log": str(log)}) for c in CASES)
    return Campaign("squares", cases, Limits(30.0, 300.0))


@pytest.mark.medium
def test_a_result_that_was_torn_is_computed_again_and_no_other_is(tmp_path: Path) -> None:
    log = tmp_path / "log.txt"
    campaign = logged(tmp_path, log)
    store = Store(tmp_path / "out")
    complete = run_campaign(campaign, store, code="test")
    assert sorted(log.read_text().split()) == ["0", "1", "2", "3"]
    torn, gone = (store.path(case.key("test")) for case in campaign.cases[1:3])
    torn.write_text(torn.read_text()[:40])
    gone.unlink()
    again = run_campaign(campaign, store, code="test")
    assert sorted(log.read_text().split()[4:]) == ["1", "2"]
    assert [row["square"] for row in again] == [row["square"] for row in complete] == [0, 1, 4, 9]


@pytest.mark.medium
def test_results_arrive_as_cases_end_and_those_of_an_earlier_run_do_not(tmp_path: Path) -> None:
    store = Store(tmp_path)
    arrived = list(campaign_results(CAMPAIGN, store, code="test", processes=2))
    assert sorted((result.name, result.row["square"]) for result in arrived) == [
        (f"case {n}", n * n) for n in range(4)
    ]
    assert list(campaign_results(CAMPAIGN, store, code="test")) == []


@pytest.mark.medium
def test_an_error_of_the_campaign_is_raised_where_results_are_waited_for(tmp_path: Path) -> None:
    store = Store(tmp_path)
    with store.locked(), pytest.raises(CampaignError, match="another campaign is writing"):
        list(campaign_results(CAMPAIGN, store, code="test"))


@pytest.mark.medium
def test_cases_are_repeated_on_request(tmp_path: Path) -> None:
    log = tmp_path / "log.txt"
    store = Store(tmp_path / "out")
    run_campaign(logged(tmp_path, log), store, code="test")
    run_campaign(
        logged(tmp_path, log), store, code="test", is_repeated=lambda result: result.row["square"] == 4
    )
    assert log.read_text().split()[4:] == ["2"]


def test_the_table_follows_from_the_results(tmp_path: Path) -> None:
    import pyarrow.parquet as pq

    store = Store(tmp_path)
    for number, case in enumerate(CASES):
        store.write(JobResult(case.name, case.key("test"), {"square": number**2}))
    # Nothing is left to do: a campaign that was killed before it wrote the table makes it from the results.
    rows = run(tmp_path)
    assert [row["square"] for row in rows] == [0, 1, 4, 9]
    table = pq.read_table(tmp_path / "cases.parquet").to_pydict()
    assert table["case"] == [case.name for case in CASES]
    assert table["number"] == [0, 1, 2, 3]


@pytest.mark.medium
def test_rows_are_in_the_order_of_the_numbers_in_their_names(tmp_path: Path) -> None:
    names = ["rig seed 100", "rig seed 2", "lag=0.05 seed 10", "rig seed 10", "lag=0.5 seed 1", "rig"]
    ordered = ["lag=0.05 seed 10", "lag=0.5 seed 1", "rig", "rig seed 2", "rig seed 10", "rig seed 100"]
    store = Store(tmp_path)
    store.write_table([{"case": name, "key": name} for name in names])
    assert [row["case"] for row in store.rows()] == ordered
    cases = tuple(Case(str(n), "tests.campaign.works:count", {"number": n}) for n in (100, 1, 10, 2))
    rows = run_campaign(Campaign("squares", cases), Store(tmp_path / "run"), code="test")
    assert [row["number"] for row in rows] == [1, 2, 10, 100]


@pytest.mark.parametrize("package", ["distributed", "pyarrow"])
def test_a_missing_package_names_the_extra_of_campaigns(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, package: str
) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(CampaignError, match=package) as caught:
        Store(tmp_path / "out")
    assert caught.value.remedy == "in your checkout of heli-lab, run: pip install -e '.[campaign]'"
    assert not (tmp_path / "out").exists()


def test_columns_may_differ_from_case_to_case(tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.write_table(
        [
            {"case": "a", "x": 1, "said": "yes"},
            {"case": "b", "x": math.inf},
            {"case": "c", "x": 0.5, "said": 3},
            {"case": "d", "x": None},
        ]
    )
    assert store.rows() == [
        {"case": "a", "x": 1.0, "said": "yes"},
        {"case": "b"},
        {"case": "c", "x": 0.5, "said": "3"},
        {"case": "d"},
    ]


def test_a_place_that_cannot_be_written_is_said(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(CampaignError, match="results cannot be saved"):
        Store(tmp_path / "file")


BAD = "tests.campaign.works:bad"
PAIR = "return (row, detail): a dict by column, and anything that JSON holds"
CASE_LIMITS = Limits(cpu_s=1.0, wait_s=60.0)
FINE = Case("fine", "tests.campaign.works:count", {"number": 3})


@pytest.fixture(scope="module")
def cage() -> Iterator[WorkerProcess]:
    with WorkerProcess(CASE_LIMITS) as process:
        yield process


def done(cage: WorkerProcess, how: str) -> JobResult:
    return cage.run(Case(how, "tests.campaign.works:bad", {"how": how}), "key")


@pytest.mark.medium
@pytest.mark.parametrize(
    ("how", "message"),
    [
        ("crashes", "its process crashed: SIGSEGV"),
        ("leaves", "its process crashed: exit status 7"),
        pytest.param("runs away", "the case used more than 1 s of CPU", marks=pytest.mark.slow),
        ("raises", "ValueError: seven lines of it"),
        ("refuses", "no such thing; ask for another"),
        ("returns a dict", f"{BAD} returned a dict; {PAIR}"),
        ("returns three", f"{BAD} returned 3 values; {PAIR}"),
        ("returns a list as its row", f"{BAD} returned a list for its row; {PAIR}"),
        ("returns a row by number", f"{BAD} returned a row with columns that are no texts; {PAIR}"),
        ("returns no JSON", "its result is no JSON: set is no JSON"),
    ],
)
def test_what_a_case_does_wrong_is_said_in_a_line_and_the_next_is_done(
    cage: WorkerProcess, how: str, message: str
) -> None:
    answer = done(cage, how)
    assert (answer.failure, answer.row, answer.name) == (message, {}, how)
    after = cage.run(FINE, "other")
    assert (after.failure, dict(after.row)) == ("", {"square": 9})


@pytest.mark.medium
def test_a_case_that_waits_for_ever_is_ended_by_the_clock() -> None:
    with WorkerProcess(Limits(cpu_s=60.0, wait_s=0.5)) as cage:
        assert done(cage, "hangs").failure == "no answer within 0.5 s"


@pytest.mark.medium
def test_good_cases_share_a_process(cage: WorkerProcess) -> None:
    pids = {cage.run(FINE, "key").detail["pid"] for _ in range(3)}
    assert len(pids) == 1
    assert pids != {os.getpid()}


@pytest.mark.medium
def test_a_process_does_not_outlive_its_parent() -> None:
    program = """
import sys, time
from heli_lab.apps.campaign import Case
from heli_lab.apps.campaign.cases import Limits
from heli_lab.apps.campaign.worker import WorkerProcess
case = Case("fine", "tests.campaign.works:count", {"number": 3})
cage = WorkerProcess(Limits())
print(cage.run(case, "key").detail["pid"], flush=True)
cage.run(Case("long", "tests.campaign.works:count", {"number": 3, "nap_s": 3600}), "key")
"""
    parent = start_program("-c", program)
    assert parent.stdout is not None
    pid = int(parent.stdout.readline())
    # Killed alone: nobody else ends the process that it started.
    parent.kill()
    until_s = time.monotonic() + PATIENCE_s
    while os.path.exists(f"/proc/{pid}") and time.monotonic() < until_s:  # noqa: PTH110 - a process, no file
        time.sleep(0.02)
    assert not os.path.exists(f"/proc/{pid}")  # noqa: PTH110
    kill_all(parent)


WORKS = ("tests.campaign.works:count",)


def squares(count: int) -> Campaign:
    cases = tuple(Case(f"{number}", WORKS[0], {"number": number}) for number in range(count))
    return Campaign("squares", cases, Limits(30.0, 300.0))


@pytest.mark.medium
@pytest.mark.parametrize(
    "address", ["tcp://127.0.0.1:{port}", "nonsense://x", "tcp://no.such.host.invalid:1"]
)
def test_an_address_that_does_not_answer_is_said_so(
    address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("heli_lab.apps.campaign.run.CONNECT_s", 0.5)
    address = address.format(port=free_port())
    with pytest.raises(CampaignError, match="no scheduler answers at") as caught:
        run_campaign(squares(1), Store(tmp_path), scheduler=address)
    assert address in caught.value.cause


@pytest.mark.slow
def test_a_worker_of_other_code_is_named_and_the_others_do_its_cases(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    states: list[CampaignProgress] = []
    # One file differs on the path of the second worker, as after an upgrade of one machine.
    other = tmp_path / "other" / "tests" / "campaign"
    other.mkdir(parents=True)
    for folder in (other, other.parent):
        (folder / "__init__.py").touch()
    (other / "works.py").write_text("def count(settings):\n    return {'square': -1}, None\n")
    with Cluster(workers=1) as cluster:
        monkeypatch.setenv("PYTHONPATH", "")
        cluster.add_worker(path=other.parents[1])
        cluster.wait_for_workers(2)
        rows = run_campaign(
            squares(12), Store(tmp_path / "out"), scheduler=cluster.address, on_progress=states.append
        )
    assert [row["square"] for row in rows] == [number**2 for number in range(12)]
    (note,) = [state.note for state in states if state.note]
    assert "is not used: its code has the digest" in note
    assert code_digest(WORKS) in note


def test_a_worker_of_other_code_refuses_also_what_it_gets_later(tmp_path: Path) -> None:
    store = Store(tmp_path)
    order = Job(
        Case("a", WORKS[0], {"number": 1}), "k", "other", WORKS, Limits(), str(store.cases), store.token
    )
    with pytest.raises(CodeMismatchError, match="the campaign's has other"):
        run_job(order)
    assert not list(store.cases.iterdir())


def test_a_worker_without_the_package_says_so() -> None:
    assert code_difference(code_digest(WORKS), WORKS) == ""
    assert "no_such_package" in code_difference("x", ("no_such_package.module:work",))


MODEL = MultibodyModel(parse_effects(["rotor_lag=0.08", "coulomb_friction.travel=0.02"]))
HOVER = "title = 'Short'\n[start]\nsettle_s = 3\n[[segment]]\nkind = 'hold'\nduration_s = 6\n"


@pytest.fixture
def plan(tmp_path: Any) -> str:
    path = tmp_path / "short.toml"
    path.write_text(HOVER)
    return str(path)


@pytest.mark.medium
def test_a_flight_is_its_settings_and_nothing_else(plan: str) -> None:
    settings = {**works.DEFAULTS, "plan": plan, "draw": {"thrust_gain": {"share": 0.2}}}
    row, _ = works.fly(settings)
    assert row["outcome"] == "completed"
    assert 0.8 < float(row["drawn_thrust_gain"] or 0.0) / load_rig("makki2024")["thrust_gain"].value < 1.2
    assert 9.0 < float(row["duration_s"] or 0.0) < 40.0
    assert works.fly(settings)[0] == row
    other, _ = works.fly({**settings, "seed": 2})
    assert other["elevation_rms_deg"] != row["elevation_rms_deg"]
    late, _ = works.fly({**settings, "effects": ["rotor_lag=0.15"]})
    assert float(late["elevation_rms_deg"] or 0.0) > 1.1 * float(row["elevation_rms_deg"] or 0.0)


@pytest.mark.slow
def test_gains_without_margin_fail_where_the_defaults_fly(tmp_path: Any) -> None:
    bold = tmp_path / "bold.toml"
    bold.write_text("[parameters]\npitch_kp = 1.5\npitch_kd = 0.05\n")
    settings = {**works.DEFAULTS, "effects": ["rotor_lag"], "draw": {"rotor_lag": {"range": [0.1, 0.15]}}}
    good, detail = works.gains(settings)
    assert good["outcome"] == "completed"
    assert 0.1 <= float(detail["effects"][0].partition("=")[2]) <= 0.15
    assert good["drawn_rotor_lag"] == float(detail["effects"][0].partition("=")[2])
    bad, _ = works.gains({**settings, "params": str(bold)})
    assert bad["outcome"] != "completed"


@pytest.mark.slow
def test_a_fit_is_compared_with_the_rig_that_flew() -> None:
    settings = {**works.DEFAULTS, "plan": "identify", "validate": "sine", "draw": "tolerances", "seed": 3}
    row, detail = works.identify(settings)
    assert row["converged"] and row["outcome"]
    assert sum(name.startswith("drawn_") for name in row) > 10
    assert float(row["held_out_normalised"] or 9.9) < 1.1
    assert float(row["within_2_std"] or 0.0) > 0.8
    assert set(detail["standard_errors_off"]) <= set(detail["values"])


@pytest.mark.medium
def test_the_number_of_threads_changes_no_number() -> None:
    rig = load_rig("makki2024")
    record = prepare(thinned(flights("rotor_lag=0.08")[0], 2), rig, "a", stop_s=20.0)
    fitted_values = [
        identify(MultibodyModel(), rig, [record], free=["thrust_gain"], threads=threads).fit.params
        for threads in (1, 3)
    ]
    assert fitted_values[0] == fitted_values[1]


@pytest.mark.medium
def test_a_fit_that_was_pickled_predicts_the_same() -> None:
    rig = load_rig("makki2024")
    record = prepare(thinned(flights("rotor_lag=0.08")[0], 4), rig, "a", stop_s=16.0)
    problem = Problem(MultibodyModel(), rig, [record], free=["thrust_gain"], threads=1)
    fit = solve(problem, budget=Budget(max_evaluations=4), scatter=False)
    copied = pickle.loads(pickle.dumps(fit))
    assert copied.params == fit.params
    before, after = (each.problem.evaluation(0, each.theta, each.states[0]) for each in (fit, copied))
    assert np.array_equal(before.residual, after.residual)
    assert np.array_equal(before.normal_matrix, after.normal_matrix)
    functions = pickle.loads(pickle.dumps(model_functions(MODEL, ("thrust_gain", "rotor_lag_s"))))
    assert (functions.free, functions.extra_states) == (("thrust_gain", "rotor_lag_s"), 2)
    with pytest.raises(TypeError):
        pickle.loads(pickle.dumps(rig)).numbers["thrust_gain"] = rig["g"]


GOOD = """
title = "Lags"
work = "fly"
worst = "-travel_rms_deg"
[cases]
rig = ["makki2024", "mine.toml"]
effects = [[], ["rotor_lag=0.1", "input_delay=0.02"]]
seed = { from = 3, to = 5 }
[draw]
"M_*" = { share = 0.03 }
[limits]
cpu_s = 20
"""


def read(folder: Path, text: str) -> Campaign:
    path = folder / "c.toml"
    path.write_text(text)
    return load_campaign(path)


def test_every_value_meets_every_other(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").touch()
    campaign = read(tmp_path, GOOD)
    assert (campaign.title, campaign.worst, campaign.limits.cpu_s) == ("Lags", "-travel_rms_deg", 20.0)
    settings = [
        (case.settings["rig"], case.settings["effects"], case.settings["seed"]) for case in campaign.cases
    ]
    mine = str((tmp_path / "mine.toml").resolve())
    lags = ["rotor_lag=0.1", "input_delay=0.02"]
    assert settings == [(r, e, s) for r in ("makki2024", mine) for e in ([], lags) for s in (3, 4, 5)]
    assert len({case.name for case in campaign.cases}) == 12
    assert campaign.cases[-1].name == "mine rotor_lag=0.1+input_delay=0.02 seed 5"
    assert all(case.settings["draw"] == {"M_*": {"share": 0.03}} for case in campaign.cases)


def test_a_case_is_another_when_a_setting_or_the_code_is(tmp_path: Path) -> None:
    first, second, *_ = read(tmp_path, GOOD).cases
    assert first.key("code") == read(tmp_path, GOOD).cases[0].key("code")
    assert len({first.key("code"), first.key("other code"), second.key("code")}) == 3


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("[cases]", "[cases", "is not TOML"),
        ('work = "fly"', 'work = "swim"', "work = 'swim' is unknown"),
        ('work = "fly"', "", "work is missing"),
        ('work = "fly"', 'work = "module:"', "work = 'module:' is unknown"),
        ("seed =", "sead =", r"\[cases\] has the unknown name sead"),
        ("to = 5", "to = 1", r"\[cases\] seed is not a range"),
        ("to = 5", "to = 900000", "seed has 899998 values"),
        ("{ from = 3, to = 5 }", "[]", "seed has no value"),
        ("{ from = 3, to = 5 }", "[1, 1]", "two cases have the name"),
        ("{ from = 3, to = 5 }", '"one"', "seed = 'one' is invalid; each value is a whole number"),
        ("{ from = 3, to = 5 }", "-1", "seed = -1 is too small"),
        ("share = 0.03", "share = 3", "share = 3 is invalid"),
        ("share = 0.03", "part = 3", "needs exactly one of share, factor, range"),
        ("cpu_s = 20", "cpu_s = 0", "cpu_s = 0 is invalid"),
        ("cpu_s = 20", "cpus = 2", r"\[limits\] has the unknown name cpus"),
        ("[draw]", "[drew]", "the file has the unknown name drew"),
    ],
)
def test_what_is_wrong_is_said(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in GOOD
    with pytest.raises(CampaignError, match=message) as caught:
        read(tmp_path, GOOD.replace(old, new))
    assert "\n" not in str(caught.value)
    assert caught.value.remedy


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.sampled_from(["from", "to", "share", "range", "x"]), inner, max_size=3)
    ),
    max_leaves=8,
)
TABLES = st.dictionaries(
    st.sampled_from(["title", "work", "worst", "cases", "draw", "limits", "other"]),
    VALUES | st.dictionaries(st.sampled_from(["rig", "seed", "effects", "cpu_s"]), VALUES, max_size=3),
)


@pytest.mark.medium
@settings(max_examples=60, deadline=None)
@given(TABLES, st.sampled_from(["fly", "diagnose", "a.b:c", None]))
def test_any_table_is_a_campaign_or_refused(table: dict[str, Any], work: str | None) -> None:
    from heli_lab.apps.campaign.file import _campaign_of_table

    try:
        campaign = _campaign_of_table(Path("c.toml"), {**table, **({"work": work} if work else {})})
    except CampaignError:
        return
    assert all(isinstance(case.key("code"), str) for case in campaign.cases)


def test_rigs_are_drawn_as_said_and_a_seed_draws_the_same_again() -> None:
    rig = load_rig("makki2024")
    how: dict[str, Any] = {
        "M_*": {"share": 0.03},
        "friction_*": {"factor": 2.0},
        "rotor_lag": {"range": [0.05, 0.15]},
    }
    lags, masses, frictions = [], [], []
    for seed in range(40):
        draw = draw_rig(rig, ["rotor_lag", "input_delay=0.02"], how, seed)
        true, effects = draw.rig, draw.effects
        name, _, lag = effects[0].partition("=")
        assert (name, effects[1]) == ("rotor_lag", "input_delay=0.02")
        lags.append(float(lag))
        masses.append(true["M_w"].value / rig["M_w"].value)
        frictions.append(true["friction_travel"].value / rig["friction_travel"].value)
        assert true["thrust_gain"] == rig["thrust_gain"]
        # The table has each number that was drawn, and no other.
        changed = {name for name in rig if true[name].value != rig[name].value}
        assert set(draw.row) == {f"drawn_{name}" for name in (*changed, "rotor_lag")}
        assert draw.row["drawn_M_w"] == true["M_w"].value and draw.row["drawn_rotor_lag"] == float(lag)
    assert 0.05 <= min(lags) < 0.07 and 0.13 < max(lags) <= 0.15
    assert 0.97 <= min(masses) < 0.98 and 1.02 < max(masses) <= 1.03
    assert 0.5 <= min(frictions) < 0.65 and 1.5 < max(frictions) <= 2.0
    assert draw_rig(rig, ["rotor_lag"], how, 3) == draw_rig(rig, ["rotor_lag"], how, 3)
    with pytest.raises(CampaignError, match="no number of rig makki2024 and no effect"):
        draw_rig(rig, [], how, 1)


def test_tolerances_draw_what_the_file_says_of_each_number() -> None:
    rig = load_rig("makki2024")
    drawn_z = []
    for seed in range(60):
        draw = draw_rig(rig, [], "tolerances", seed)
        true = draw.rig
        assert draw.row["drawn_thrust_gain"] == true["thrust_gain"].value
        number = rig["thrust_gain"]
        drawn_z.append((true["thrust_gain"].value - number.value) / number.tolerance)
        assert true["g"] == rig["g"] or rig["g"].tolerance > 0.0
    rms = (sum(z**2 for z in drawn_z) / len(drawn_z)) ** 0.5
    assert 0.4 < rms < 0.6


def test_a_function_that_is_built_into_python_has_a_digest_as_any_other() -> None:
    # Frozen, built in, and with a file.
    assert len({code_digest([work]) for work in ("os:getpid", "sys:exit", "json:dumps")}) == 3
