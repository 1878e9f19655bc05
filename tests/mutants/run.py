"""Takes mutants one after the other: build, run the tests that reach it, write down what became of it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Final, Protocol

from tests.mutants import session
from tests.mutants.declared import Declaration, declared
from tests.mutants.generate import Mutant
from tests.mutants.reach import Reach
from tests.mutants.results import DECLARED, Result, Results
from tests.mutants.tree import BuildError

_LIMIT_TIMES: Final = 20.0
_MIN_LIMIT_s: Final = 2.0
"""CPU time that a test may take on a mutant: so many times its cost on the original, and at least this.

Below, a busy machine kills mutants that no test notices; above, endless loops cost more than all others.
"""
_MIN_REAL_s: Final = 60.0
_REAL_TIMES: Final = 60.0
"""Real time that all tests may take, for those that wait for what never comes: so many times their CPU time.

A busy machine gives a test a tenth of a processor.
"""
_RECORDED: Final = "tests/flight/test_baseline.py"


class Bench(Protocol):
    """Where mutants of a part of the firmware are built and run."""

    def build(self, mutant: Mutant) -> Callable[[], None]:
        """Compile a mutant; what to call in a fork before its tests."""

    def is_same_code(self, mutant: Mutant) -> bool:
        """Whether the compiler makes the same code of it."""


class Runner:
    """Finds out what becomes of mutants.

    Parameters
    ----------
    bench : Bench
        Builds them.
    reach : Reach
        Which tests to run.
    declarations : list of Declaration
        Those that no test can notice.
    results : Results
        What is known already, and where to write what is new.
    sources, tests : str
        Digests that results depend on.
    """

    def __init__(
        self,
        bench: Bench,
        reach: Reach,
        declarations: list[Declaration],
        results: Results,
        sources: str,
        tests: str,
    ) -> None:
        self._bench, self._reach, self._declarations = bench, reach, declarations
        self._results, self._sources, self._tests = results, sources, tests

    def run(self, mutants: Iterable[Mutant]) -> Iterator[Result]:
        """The result of each mutant, as soon as it is known."""
        for mutant in mutants:
            reason = declared(mutant, self._declarations)
            if reason is not None:
                yield self._result(mutant, DECLARED, reason.reason, 0.0)
                continue
            known = self._results.known(mutant.identity, self._sources, self._tests)
            if known is None:
                known = self._try(mutant)
                self._results.add(known)
            yield known

    def _try(self, mutant: Mutant) -> Result:
        try:
            prepare = self._bench.build(mutant)
        except BuildError as error:
            proven = "static assertion failed" in str(error)
            first = next((line for line in str(error).splitlines() if "error:" in line), str(error)[:200])
            return self._result(mutant, "static_assert" if proven else "invalid", first, 0.0)
        names = self._reach.tests_for(mutant)
        spent_s = 0.0
        # The recorded scripts by themselves first: most mutants need no other file of tests to be imported.
        for part in (
            [n for n in names if n.startswith(_RECORDED)],
            [n for n in names if not n.startswith(_RECORDED)],
        ):
            outcome = session.run_tests(prepare, limits_s(self._reach, part), self._real_s(part))
            spent_s += outcome.spent_s
            if outcome.killed_by:
                return self._result(mutant, outcome.reason, outcome.killed_by, spent_s)
        if self._bench.is_same_code(mutant):
            return self._result(mutant, "same code", "", spent_s)
        return self._result(mutant, "survived" if names else "unreached", "", spent_s)

    def _real_s(self, names: list[str]) -> float:
        return _MIN_REAL_s + _REAL_TIMES * sum(self._reach.costs_s[name] for name in names)

    def _result(self, mutant: Mutant, outcome: str, by: str, spent_s: float) -> Result:
        return Result(
            mutant.identity,
            mutant.file,
            str(mutant),
            outcome,
            by,
            round(spent_s, 2),
            self._sources,
            self._tests,
        )


def limits_s(reach: Reach, names: Iterable[str]) -> dict[str, float]:
    """CPU time that each test may take."""
    return {name: max(_MIN_LIMIT_s, _LIMIT_TIMES * reach.costs_s[name]) for name in names}
