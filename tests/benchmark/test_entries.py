"""Methods run in processes with limits; a run that was interrupted continues."""

from __future__ import annotations

import json
import re
import sys
import textwrap
from pathlib import Path

import pytest
from heli_benchmark.entries import RunLimits, read_run, run_method
from heli_benchmark.entries.method import builtin_methods, find_method
from heli_benchmark.errors import BenchmarkError

from tests.benchmark.small_split import make

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "validation" / "benchmark.md"
METHODS = ROOT / "sim" / "heli_benchmark" / "methods"


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no limits of a process")
def test_a_run_goes_on_after_a_failed_case_and_continues(tmp_path: Path) -> None:
    split = make(tmp_path / "small", cases=3)
    example = textwrap.dedent(re.findall(r"```python\n(.*?)```", PAGE.read_text(), re.DOTALL)[0])
    # The method of the page answers the first case; the others fail as a stranger's method may.
    wrong = (
        '\n\ndef entered(case):\n    if case.name == "case-002":\n        raise ValueError("no\\nroot")\n'
        '    while case.name == "case-003":\n        pass\n    return diagnose(case)\n'
    )
    method = tmp_path / "mine.py"
    method.write_text(example + wrong)
    ended: list[tuple[str, str]] = []

    def run(cpu_s: int = 2) -> None:
        limits = RunLimits(cpu_s, 4000)
        run_method(
            split,
            f"{method}:entered",
            tmp_path / "run",
            limits=limits,
            say=lambda case, failure: ended.append((case, failure)),
        )

    run()
    assert [case for case, _ in ended] == ["case-001", "case-002", "case-003"]
    assert ended[0][1] == ""
    assert ended[1][1] == "ValueError: no root"
    assert ended[2][1].startswith("the process ended with code -")
    results = read_run(tmp_path / "run", split)
    assert results["case-001"]["cpu_s"] > 0.0
    (tmp_path / "run" / "case-002.json").unlink()
    ended.clear()
    run()
    assert ended == [("case-002", "ValueError: no root")]
    with pytest.raises(BenchmarkError, match="has results with another limits; choose another folder"):
        run(cpu_s=3)
    method.write_text(method.read_text() + "\n")
    with pytest.raises(BenchmarkError, match="another method digest"):
        run()


def test_a_method_that_does_not_exist_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(
        BenchmarkError, match=r"unknown method 'our'; give FILE.py:FUNCTION, or one of base_r"
    ):
        find_method("our")
    with pytest.raises(BenchmarkError, match=r"mine.py, does not exist; check the path"):
        find_method(f"{tmp_path}/mine.py:diagnose")


def test_an_adaptor_has_at_most_60_lines_of_code() -> None:
    for name in builtin_methods():
        text = (METHODS / f"{name}.py").read_text()
        code = re.sub(r'"""(.|\n)*?"""', "", text)
        lines = [line for line in code.splitlines() if line.strip() and not line.strip().startswith("#")]
        assert len(lines) <= 60, f"{name} has {len(lines)} lines"


@pytest.mark.medium
def test_answers_to_another_split_are_refused(tmp_path: Path) -> None:
    split = make(tmp_path / "small", cases=1)
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "run.json").write_text(json.dumps({"split_digest": "other"}))
    with pytest.raises(BenchmarkError, match="has answers to another split; run the method on"):
        read_run(folder, split)
