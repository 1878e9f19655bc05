"""Clusters that cannot be used are said in one line; workers of other code are left out."""

from __future__ import annotations

from pathlib import Path

import pytest
from heli_lab.apps.campaign import Campaign, Case, Store, cluster, run_campaign
from heli_lab.apps.campaign.run import CampaignProgress
from heli_lab.apps.campaign.worker import CodeMismatch, Job, code_difference, run_job
from heli_lab.apps.campaign.worker_process import Limits
from heli_lab.code_digest import code_digest
from heli_lab.errors import CampaignError

from tests.campaign.killer import Cluster, free_port

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
    monkeypatch.setattr(cluster, "CONNECT_s", 0.5)
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
    refused = run_job(order)
    assert isinstance(refused, CodeMismatch)
    assert "the campaign's has other" in refused.why
    assert not list(store.cases.iterdir())


def test_a_worker_without_the_package_says_so() -> None:
    assert code_difference(code_digest(WORKS), WORKS) == ""
    assert "no_such_package" in code_difference("x", ("no_such_package.module:work",))


@pytest.mark.medium
def test_cases_that_fail_are_named_and_the_others_go_on(tmp_path: Path) -> None:
    bad = [Case(how, "tests.campaign.works:bad", {"how": how}) for how in ("crashes", "raises", "fine")]
    states: list[CampaignProgress] = []
    rows = run_campaign(
        Campaign("bad", tuple(bad), Limits(5.0, 60.0)), Store(tmp_path), on_progress=states.append
    )
    assert {row["case"]: row["failure"] for row in rows} == {
        "crashes": "its process crashed: SIGSEGV",
        "raises": "ValueError: seven lines of it",
        "fine": "",
    }
    assert [(state.ended, state.failed) for state in states][-1] == (3, 2)
    again = run_campaign(Campaign("bad", tuple(bad), Limits(5.0, 60.0)), Store(tmp_path))
    assert [{**row} for row in again] == rows, "what failed is done again only if that is asked for"
