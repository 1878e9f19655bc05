"""The folder of a campaign has complete results and their table, and serves one campaign at a time."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import pytest
from heli_lab.apps.campaign import Campaign, Case, JobResult, Store, campaign_results, run_campaign
from heli_lab.apps.campaign.store import row_of
from heli_lab.apps.campaign.worker_process import Limits
from heli_lab.errors import CampaignError

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
    with store.locked(), pytest.raises(CampaignError, match="another campaign"):
        list(campaign_results(CAMPAIGN, store, code="test"))


@pytest.mark.medium
def test_results_of_other_code_are_other_results(tmp_path: Path) -> None:
    log = tmp_path / "log.txt"
    store = Store(tmp_path / "out")
    for code in ("one", "other", "one"):
        run_campaign(logged(tmp_path, log), store, code=code)
    assert len(log.read_text().split()) == 8


@pytest.mark.medium
def test_cases_are_repeated_on_request(tmp_path: Path) -> None:
    log = tmp_path / "log.txt"
    store = Store(tmp_path / "out")
    run_campaign(logged(tmp_path, log), store, code="test")
    run_campaign(logged(tmp_path, log), store, code="test", again=lambda answer: answer.row["square"] == 4)
    assert log.read_text().split()[4:] == ["2"]


def test_the_table_follows_from_parts_and_from_results_without_a_row(tmp_path: Path) -> None:
    import pyarrow.parquet as pq

    store = Store(tmp_path)
    answers = [JobResult(case.name, case.key("test"), {"square": n**2}) for n, case in enumerate(CASES)]
    for answer in answers:
        store.write(answer)
    store.append([row_of(CASES[0], answers[0])])
    store.append([row_of(CASES[1], answers[1])])
    # Nothing is left to do: what was killed before its rows were written has them from the results.
    rows = run(tmp_path)
    assert [row["square"] for row in rows] == [0, 1, 4, 9]
    table = pq.read_table(tmp_path / "cases.parquet").to_pydict()
    assert table["case"] == [case.name for case in CASES]
    assert table["number"] == [0, 1, 2, 3]
    assert not list((tmp_path / "parts").iterdir())


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
    store.append([{"case": "a", "key": "a", "x": 1, "said": "yes"}, {"case": "b", "key": "b", "x": math.inf}])
    store.append([{"case": "c", "key": "c", "x": 0.5, "said": 3}, {"case": "d", "key": "d", "x": None}])
    rows = {row["key"]: row for row in store.rows()}
    assert rows["a"]["x"] == 1 and rows["c"]["x"] == 0.5
    assert "x" not in rows["b"] and "x" not in rows["d"]
    store.write_table(store.rows())
    assert [row.get("said") for row in store.rows()] == ["yes", None, "3", None]


def test_a_second_campaign_is_kept_out(tmp_path: Path) -> None:
    store = Store(tmp_path)
    with store.locked(), pytest.raises(CampaignError, match="another campaign is writing"):
        run(tmp_path)


def test_a_place_that_cannot_be_written_is_said(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(CampaignError, match="results cannot be saved"):
        Store(tmp_path / "file")
