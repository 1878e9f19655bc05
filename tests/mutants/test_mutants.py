"""Mutants are made where they mean something, keep their identity, and die."""

import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.mutants import rotation, session
from tests.mutants.generate import ROOT, BuildError, Mutant, digest, mutants_of, sample, sources
from tests.mutants.reach import Reach, Watch, require_passed
from tests.mutants.results import DeclarationError, Result, Results, read_declarations, table
from tests.running.long import LONG

SOURCE = """\
#include <cstdint>
// if (a < b) return;
constexpr float kLimit_rad = 1.5F;
static_assert(kLimit_rad > 0.0F, "a < b");
std::array<std::int32_t, 4> values;
bool Guard::check(int a, int b) {
  if (a < b && enabled_) {
    stop();
    return true;
  }
  const char* text = "a + b";
  sum_ += a + b;
  return !enabled_;
}
"""
ROTATING, MISTAKES = 10, 30
"""Generated and chosen mutants that the suite repeats."""


def changes(kind: str) -> set[tuple[int, str, str]]:
    return {(m.line, m.before, m.after) for m in mutants_of("x.cpp", SOURCE) if m.kind == kind}


def test_relations_conditions_operands_and_statements_are_changed_and_nothing_else_is() -> None:
    assert changes("relation") == {(7, "<", "<="), (7, "<", ">=")}
    assert changes("logic") == {(7, "&&", "||"), (13, "!", "")}
    assert changes("operand") == {(7, "&& enabled_", ""), (7, "a < b && ", ""), (12, "+ b", "")}
    assert changes("arithmetic") == {(12, "+=", "-="), (12, "+", "-")}
    condition = "a < b && enabled_"
    assert changes("condition") == {(7, condition, after) for after in (f"!({condition})", "true", "false")}
    assert changes("statement") == {(8, "stop();", ";"), (12, "sum_ += a + b;", ";")}
    constants = changes("constant")
    assert {after for line, _, after in constants if line == 3} == {"0.0F", "2.5F", "3.0F", "0.75F", "15.0F"}
    assert {line for line, _, _ in constants} == {3, 5, 9}


def test_a_mutant_keeps_its_identity_when_lines_move() -> None:
    before = {m.identity for m in mutants_of("x.cpp", SOURCE)}
    moved = SOURCE.replace("#include <cstdint>\n", "#include <cstdint>\n\n// more\n")
    assert before == {m.identity for m in mutants_of("x.cpp", moved)}
    assert len(before) == len(mutants_of("x.cpp", SOURCE))


def test_each_mutant_of_the_firmware_changes_its_file_in_one_place() -> None:
    file = "firmware/core/law/guard.cpp"
    text = (ROOT / file).read_text(encoding="utf-8")
    for mutant in mutants_of(file, text):
        changed = mutant.apply(text)
        assert changed != text
        assert changed[: mutant.start] == text[: mutant.start]
        assert changed.endswith(text[mutant.start + len(mutant.before) :])


def test_a_seed_chooses_the_same_mutants_each_time_and_another_seed_others() -> None:
    every = mutants_of("x.cpp", SOURCE)
    first, again, other = (sample(every, seed, 5) for seed in ("1", "1", "2"))
    assert first == again != other
    places = [(m.start, m.kind) for m in sample(every, "1", None)]
    assert len(places) == len(set(places))


def test_generated_sources_have_no_mutants() -> None:
    assert "firmware/core/link/declaration.hpp" not in sources()
    assert {"firmware/core/core.cpp", "firmware/due/uart.cpp"} <= set(sources())


def test_every_declaration_of_an_equivalent_mutant_names_a_mutant_and_a_reason() -> None:
    read_declarations()


@pytest.mark.parametrize(
    ("line", "reason", "problem"),
    [
        ("return front_V + 1;", "The sum is bounded by the limits before.", "no mutant changes"),
        ("const float share = params.get(Param::law_envelope);", "", "the reason is missing"),
    ],
)
def test_a_declaration_that_does_not_hold_is_an_error(
    tmp_path: Path, line: str, reason: str, problem: str
) -> None:
    path = tmp_path / "declared.toml"
    path.write_text(
        f'[[equivalent]]\nfile = "firmware/core/law/guard.cpp"\nline = "{line}"\nbefore = "+"\n'
        'after = ["-"]\n'
        f'reason = "{reason}"\n'
    )
    with pytest.raises(DeclarationError, match=problem):
        read_declarations(path)


def a_mutant(file: str, line: int) -> Mutant:
    return Mutant(
        file=file,
        line=line,
        last_line=line,
        source_line="",
        occurrence=0,
        column=0,
        kind="constant",
        before="1.5F",
        after="15.0F",
        start=0,
    )


def test_a_constant_is_reached_by_the_tests_of_what_uses_it() -> None:
    file = "firmware/core/flight/supervisor.cpp"
    lines = (ROOT / file).read_text(encoding="utf-8").splitlines()
    declared = next(
        k for k, line in enumerate(lines, 1) if line.startswith("constexpr Quantity kTouchdown_rad ")
    )
    used = next(k for k, line in enumerate(lines, 1) if "magnitude(above_rest_rad) < kTouchdown_rad" in line)
    reach = Reach({"slow": 0.3, "quick": 0.01, "other": 0.01}, {file: {used: frozenset({"slow", "quick"})}})
    assert reach.tests_for(a_mutant(file, declared)) == ["quick", "slow"]


def test_tests_that_were_not_seen_to_reach_a_mutant_come_last_of_their_cost() -> None:
    file = "firmware/due/registers.hpp"
    costs_s = {"reaches": 0.012, "reads": 0.011, "expensive": 0.4}
    reach = Reach(costs_s, {file: {1: frozenset({"reaches"})}}, {file: frozenset({"reads", "expensive"})})
    assert reach.tests_for(a_mutant(file, 1)) == ["reaches", "reads", "expensive"]


SHARED = """
import time
import pytest

@pytest.fixture(scope="module")
def table():
    end_s = time.process_time() + 0.2
    while time.process_time() < end_s:
        pass

def test_first(table): pass
def test_second(table): pass
def test_alone(): pass
"""


def test_the_cost_of_a_fixture_counts_for_each_test_that_uses_it(tmp_path: Path) -> None:
    """A limit of CPU time that does not include a fixture would kill every mutant that meets it."""
    file = tmp_path / "test_shared.py"
    file.write_text(SHARED, encoding="utf-8")

    def look() -> dict[str, object]:
        watch = Watch(set, keeps_all=True)
        session.run_pytest([str(file)], [watch])
        return watch.result()

    costs_s = {
        name.rpartition("::")[2]: cost_s for name, cost_s in session.call_in_fork(look)["costs_s"].items()
    }
    assert costs_s["test_first"] >= 0.2
    assert costs_s["test_second"] >= 0.2
    assert costs_s["test_alone"] < 0.2


SIDE_BY_SIDE = """
import pytest

@pytest.fixture(scope="session")
def table(): pass

def test_quick(table): pass

@pytest.mark.slow
def test_left_out(table): pass

def test_wrong(): assert False
"""


def test_a_test_that_a_marker_leaves_out_has_no_cost_though_it_shares_a_fixture(tmp_path: Path) -> None:
    file = tmp_path / "test_side_by_side.py"
    file.write_text(SIDE_BY_SIDE, encoding="utf-8")

    def look() -> dict[str, object]:
        watch = Watch(set, keeps_all=True)
        session.run_pytest([str(file)], [watch], "-m", "not slow")
        return watch.result()

    looked = session.call_in_fork(look)
    assert [name.rpartition("::")[2] for name in looked["costs_s"]] == ["test_quick"]
    with pytest.raises(BuildError, match=r"a mutant: .*::test_wrong \(assert False\); make them pass"):
        require_passed(looked)


def test_a_file_of_tests_that_cannot_be_imported_is_not_one_that_reaches_nothing(tmp_path: Path) -> None:
    file = tmp_path / "test_broken.py"
    file.write_text("import no_such_module", encoding="utf-8")

    def look() -> dict[str, object]:
        watch = Watch(set, keeps_all=True)
        session.run_pytest([str(file)], [watch])
        return watch.result()

    with pytest.raises(BuildError, match=r"test_broken.py \(.*No module named 'no_such_module'\)"):
        require_passed(session.call_in_fork(look))


def test_a_fork_that_fails_reports_its_last_lines_and_not_a_wait_status() -> None:
    def look() -> None:
        os.write(1, b"what a test printed\n")
        raise KeyError("a name that nobody knows")

    with pytest.raises(session.ChildError) as failed:
        session.call_in_fork(look)
    text = str(failed.value)
    assert "exit status 70" in text and "what a test printed" in text
    assert text.endswith("KeyError: 'a name that nobody knows'")
    with pytest.raises(session.ChildError, match=r"signal SIGKILL; .*\n.*printed nothing"):
        session.call_in_fork(lambda: os.kill(os.getpid(), signal.SIGKILL))


def a_result(outcome: str, sources_digest: str = "s", tests_digest: str = "t") -> Result:
    return Result(
        identity="id",
        file="a.cpp",
        text="a.cpp:1: < -> <=",
        outcome=outcome,
        by="test_a",
        spent_s=0.1,
        sources=sources_digest,
        tests=tests_digest,
    )


def test_a_killed_mutant_stays_killed_when_tests_are_added_and_a_survivor_is_tried_again(
    tmp_path: Path,
) -> None:
    for outcome, with_other_tests in (("failed", True), ("survived", False)):
        path = tmp_path / f"{outcome}.jsonl"
        Results(path).add(a_result(outcome))
        again = Results(path)
        assert again.known("id", "s", "t") == a_result(outcome)
        assert (again.known("id", "s", "more") is not None) is with_other_tests
        assert again.known("id", "changed", "t") is None


def test_the_table_lists_survivors_and_leaves_out_what_is_no_other_program() -> None:
    text = table([a_result("failed"), a_result("survived"), a_result("same code")])
    assert "killed or declared: 50.0 % of 2" in text
    assert "survived: a.cpp:1: < -> <=" in text
    assert "not counted: 1" in text


def repeated(*options: str) -> list[str]:
    """Outcomes of mutants, others after each change of the firmware, against the test of each."""
    command = [sys.executable, "-m", "tests.mutants", *options, "--seed", digest("firmware")]
    process = subprocess.run(
        command, cwd=ROOT, capture_output=True, text=True, check=False, env={**os.environ, "HELI_LONG": ""}
    )
    assert process.returncode == 0, process.stdout + process.stderr
    return process.stdout.splitlines()


@pytest.mark.slow
def test_some_mutants_that_were_killed_once_are_killed_again() -> None:
    assert len(repeated("--rotating", str(ROTATING))) == ROTATING, "run make mutants with --record"


@pytest.mark.emulated
def test_some_mistakes_of_every_driver_are_noticed_by_the_tests_that_must() -> None:
    for tool in ("arm-none-eabi-g++", "make"):
        if shutil.which(tool) is None:
            pytest.skip(f"{tool} is not installed: make firmware")
    mistakes = repeated("--mistakes", "0" if LONG else str(MISTAKES))
    assert len(mistakes) >= MISTAKES


def test_the_test_that_must_notice_a_mistake_exists() -> None:
    assert [test for _, test in rotation.mistakes(None, "") if not rotation.exists(test)] == []
    assert not rotation.exists("tests/mutants/test_mutants.py::test_that_is_not_there[1]")


def test_every_driver_has_a_mistake() -> None:
    # These two have no register of their own: arithmetic, and memory.
    without = {"firmware/due/memory.cpp", "firmware/due/due_board.cpp"}
    drivers = {file for file in sources(only="firmware/due") if file.endswith(".cpp")} - without
    assert drivers <= {mutant.file for mutant, _ in rotation.mistakes(None, "")}
