"""Runs tests in a process of their own, against another build of the flight code.

The process is a fork of one that has imported what does not depend on that build, which takes a second.
"""

import contextlib
import ctypes
import importlib
import importlib.machinery
import importlib.util
import json
import os
import resource
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Protocol

import pytest

from tests.mutants.generate import ROOT, BuildError, Mutant
from tests.mutants.reach import Reach
from tests.mutants.results import DECLARED, Declaration, Result, Results, declared

_PRELOADED: Final = (
    "numpy", "scipy.signal", "casadi", "hypothesis", "hypothesis.strategies", "serial", "cobs", "mcap.reader",
    "control", "matplotlib.pyplot", "typer", "ssl", "asyncio", "unittest.mock", "elftools.elf.elffile",
    "heli_host.board.heli", "heli_host.link.session", "heli_host.fly.runner", "tests.running.order",
)  # fmt: skip
EXTENSIONS: Final = ("heli_sim._native", "heli_test_native")
_ARGUMENTS: Final = (
    "-q", "-x", "--tb=no", "-p", "no:cacheprovider", "-p", "no:xdist", "--import-mode=importlib",
    "-o", "addopts=",
)  # fmt: skip
_DIE_WITH_PARENT: Final = 1  # PR_SET_PDEATHSIG
_LAST_LINES: Final = 15
"""Lines of a failed process that are shown: a traceback's end, with the frame that raised it."""
_MEMORY_BYTES: Final = 8 << 30
"""A mutant that allocates without end stops here; a healthy run reserves below 3 GB."""


@dataclass(frozen=True)
class Outcome:
    """Result of the tests of a build."""

    killed_by: str  # The test that failed, or ran into its limit; empty if none
    reason: str  # ``failed``, ``timeout``, ``crashed``, or empty
    spent_s: float  # CPU time


class ChildError(Exception):
    """A process that looks which test reaches which line ended early."""

    def __init__(self, status: int, printed: str) -> None:
        ended = f"signal {signal.Signals(-status).name}" if status < 0 else f"exit status {status}"
        last = "\n".join(printed.strip().splitlines()[-_LAST_LINES:]) or "(it printed nothing)"
        super().__init__(
            f"the process that looks which test reaches which line ended with {ended}; "
            f"correct what its last lines report:\n{last}"
        )


class Selection:
    """A plugin that runs some tests in a given order, each with a limit of CPU time."""

    def __init__(self, limits_s: dict[str, float], report: int) -> None:
        self._limits_s = limits_s
        self._report = report

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        place = {name: index for index, name in enumerate(self._limits_s)}
        items[:] = sorted((i for i in items if i.nodeid in place), key=lambda i: place[i.nodeid])

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_logstart(self, nodeid: str) -> None:
        signal.setitimer(signal.ITIMER_PROF, self._limits_s[nodeid])
        self._write("starts", nodeid)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed:
            self._write("fails", report.nodeid)

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        if report.failed:
            self._write("fails", report.nodeid)

    def _write(self, what: str, name: str) -> None:
        os.write(self._report, f"{what} {name}\n".encode())


def preload() -> None:
    """Import what every run needs and no build of the flight code changes."""
    for name in _PRELOADED:
        with contextlib.suppress(ImportError):
            importlib.import_module(name)
    loaded = [name for name in sys.modules if name in EXTENSIONS]
    assert not loaded, f"{loaded} must be loaded by each run itself"


def load_extensions(library: Path) -> None:
    """Let both extensions come from one library instead of from the installed package."""
    for name in EXTENSIONS:
        loader = importlib.machinery.ExtensionFileLoader(name, str(library))
        spec = importlib.util.spec_from_loader(name, loader)
        assert spec is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[name] = module
        loader.exec_module(module)
        package, _, attribute = name.rpartition(".")
        if package:
            setattr(importlib.import_module(package), attribute, module)


def use_firmware(elf: Path, drivers: Path | None = None) -> None:
    """Let the tests of the Due's firmware take another ELF, and other drivers, than those of the sources."""
    built: Any = importlib.import_module("tests.firmware.built")
    built.built_elf = lambda: elf
    if drivers is not None:
        built.DRIVERS = drivers


def run_tests(prepare: Callable[[], None], limits_s: dict[str, float], most_s: float) -> Outcome:
    """Run tests in a fork until one fails."""
    if not limits_s:
        return Outcome("", "", 0.0)
    reading, writing = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reading)
        nowhere = os.open(os.devnull, os.O_WRONLY)
        _in_child(lambda: _run_selection(prepare, limits_s, writing), nowhere)
    os.close(writing)
    output, ended = _read_until_end(reading, most_s)
    if not ended:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child, signal.SIGKILL)
    _, status, usage = os.wait4(child, 0)
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(child, signal.SIGKILL)
    spent_s = usage.ru_utime + usage.ru_stime
    lines = [line.partition(" ") for line in output.decode(errors="replace").splitlines()]
    failed = next((name for what, _, name in lines if what == "fails"), None)
    if failed is not None:
        return Outcome(failed, "failed", spent_s)
    last = next((name for what, _, name in reversed(lines) if what == "starts"), "before the first test")
    if not ended or (os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGPROF):
        return Outcome(last, "timeout", spent_s)
    if not os.WIFEXITED(status) or os.WEXITSTATUS(status) not in (0, pytest.ExitCode.NO_TESTS_COLLECTED):
        return Outcome(last, "crashed", spent_s)
    return Outcome("", "", spent_s)


def _run_selection(prepare: Callable[[], None], limits_s: dict[str, float], report: int) -> int:
    signal.signal(signal.SIGPROF, signal.SIG_DFL)
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY_BYTES, _MEMORY_BYTES))
    prepare()
    return run_pytest(files_of(limits_s), [Selection(limits_s, report)])


def run_pytest(files: Sequence[str], plugins: Iterable[object], *options: str) -> int:
    """Run pytest in this process, with nothing of its own kept; its exit code."""
    from tests.running.kept import KEPT

    # A flight of a mutant must not be kept as one of the flight code.
    KEPT.folder = Path(tempfile.gettempdir()) / "kept"
    return int(pytest.main([*_ARGUMENTS, *options, *files], plugins=list(plugins)))


def files_of(names: Iterable[str]) -> list[str]:
    """Files of tests, each once."""
    return list(dict.fromkeys(name.partition("::")[0] for name in names))


def _in_child(run: Callable[[], int], output: int) -> None:
    """Run a function, print to the file descriptor `output`, and end this process with its status."""
    status = 70
    try:
        os.setpgid(0, 0)
        # A run that is stopped leaves no test behind (Linux only; elsewhere the tests end by themselves).
        if sys.platform == "linux":
            ctypes.CDLL(None).prctl(_DIE_WITH_PARENT, signal.SIGKILL)
        os.chdir(ROOT)
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        for descriptor in (1, 2):
            os.dup2(output, descriptor)
        with tempfile.TemporaryDirectory(prefix="heli-mutant-") as folder:
            tempfile.tempdir = folder
            os.environ["TMPDIR"] = folder
            os.environ["PYTEST_DEBUG_TEMPROOT"] = folder
            status = run()
    except BaseException:  # noqa: BLE001 - the parent reads why its child ended
        _flush()
        os.write(output, traceback.format_exc().encode())
    finally:
        _flush()
        os._exit(status)


def _flush() -> None:
    """Write what Python still holds: a process that ends with `_exit` does not."""
    for stream in (sys.stdout, sys.stderr):
        with contextlib.suppress(OSError, ValueError):
            stream.flush()


def _read_until_end(reading: int, most_s: float) -> tuple[bytes, bool]:
    """Output of a child, and whether it closed its end in time."""
    import select

    output, deadline_s = b"", time.monotonic() + most_s
    with os.fdopen(reading, "rb", buffering=0) as pipe:
        while (rest_s := deadline_s - time.monotonic()) > 0:
            ready, _, _ = select.select([pipe], [], [], rest_s)
            if not ready:
                break
            part = pipe.read(65536)
            if not part:
                return output, True
            output += part
    return output, False


def call_in_fork(run: Callable[[], object]) -> Any:
    """The result of a function, as JSON, from a fork of this process."""
    with (
        tempfile.NamedTemporaryFile(suffix=".json") as file,
        tempfile.NamedTemporaryFile(suffix=".txt") as printed,
    ):
        # The child would write a second time what this process still holds.
        _flush()
        child = os.fork()
        if child == 0:

            def write_result() -> int:
                Path(file.name).write_text(json.dumps(run()), encoding="utf-8")
                return 0

            _in_child(write_result, printed.fileno())
        _, status = os.waitpid(child, 0)
        if status != 0:
            raise ChildError(
                os.waitstatus_to_exitcode(status), Path(printed.name).read_text(errors="replace")
            )
        return json.loads(Path(file.name).read_text(encoding="utf-8"))


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
    """Finds out what becomes of mutants."""

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
            outcome = run_tests(prepare, limits_s(self._reach, part), self._real_s(part))
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
            identity=mutant.identity,
            file=mutant.file,
            text=str(mutant),
            outcome=outcome,
            by=by,
            spent_s=round(spent_s, 2),
            sources=self._sources,
            tests=self._tests,
        )


def limits_s(reach: Reach, names: Iterable[str]) -> dict[str, float]:
    """CPU time that each test may take."""
    return {name: max(_MIN_LIMIT_s, _LIMIT_TIMES * reach.costs_s[name]) for name in names}
