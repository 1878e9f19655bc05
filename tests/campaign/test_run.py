"""A campaign stores complete results and limits its cases; flights, fits and gain checks as cases."""

from __future__ import annotations

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
from heli_lab.apps.campaign.run import CampaignProgress
from heli_lab.apps.campaign.worker import CodeMismatchError, Job, WorkerProcess, code_difference, run_job
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
    run_campaign(logged(tmp_path, log), store, code="test", again=lambda answer: answer.row["square"] == 4)
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
