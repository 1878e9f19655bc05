"""Runs what a document says to type: each command a process, forked from one that has read the libraries.

Most commands compute for a moment. To start Python and to import NumPy, CasADi and the host takes each of
them half a second of CPU; SciPy's signals and matplotlib take two more. As a program this is that process:
it takes commands from its standard input, one per line as JSON, and answers each with its exit code and its
CPU time.
"""

from __future__ import annotations

import atexit
import functools
import gc
import hashlib
import importlib
import json
import os
import pickle
import signal
import subprocess
import sys
import threading
import traceback
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Final, NoReturn

from tests.running import alone

ROOT: Final = Path(__file__).resolve().parents[2]
LIBRARIES: Final = (
    "heli_host.fly.runner",
    "heli_sim.sil.transport",
    "heli_sim.sil.world",
    "heli_lab.fit",
    "heli_lab.explain",
    "matplotlib.backends.backend_agg",
    "matplotlib.pyplot",
    "scipy.signal",
)
"""Modules that commands of several documents import."""
HELI_HOST: Final = "heli-host"
PYTHON: Final = "python"
PATIENCE_S: Final = 900
"""After which a command is ended by SIGALRM: no test waits for ever."""


class Typed:
    """Commands and programs, run one after the other."""

    def __init__(self, output_file: Path) -> None:
        self._output_file = output_file
        self._charged_s = 0.0
        environment = {**os.environ, "MPLBACKEND": "agg"}
        self._started = subprocess.Popen(
            [sys.executable, "-m", "tests.repo.typed", str(output_file)],
            cwd=ROOT,
            env=environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def __enter__(self) -> Typed:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is not None:
            self._started.kill()
        self._started.communicate()
        # Waited for, it brings along what its commands took.
        alone.charge(-self._charged_s)

    def run(self, words: Sequence[str], folder: Path, shorter: Sequence[str] = ()) -> tuple[int, str]:
        """Run ``heli-host ...`` or ``python -c ...`` in a folder; its exit code, and what it said."""
        assert self._started.stdin is not None
        assert self._started.stdout is not None
        self._started.stdin.write(json.dumps([str(folder), list(shorter), *words]) + "\n")
        self._started.stdin.flush()
        code, cpu_s = json.loads(self._started.stdout.readline() or "[-1, 0.0]")
        self._charged_s += cpu_s
        alone.charge(cpu_s)
        return code, self._output_file.read_text(encoding="utf-8", errors="replace")


def main() -> None:
    """Fork for each command, and in its process become it."""
    for name in LIBRARIES:
        importlib.import_module(name)
    from heli_host.ui.cli.entry import command_line
    from heli_host.ui.cli.verb import installed_verbs

    for verb in installed_verbs():
        parse_nothing(command_line(verb))
    # What is there already is shared with each command; a collector that looks at it would copy it.
    gc.collect()
    gc.freeze()
    for line in sys.stdin:
        child = os.fork()
        if child == 0:
            folder, shorter, *words = json.loads(line)
            os.chdir(folder)
            if shorter:
                shorten(shorter)
            end(exit_code_of(words, sys.argv[1]))
        _, status, used = os.wait4(child, 0)
        print(json.dumps([os.waitstatus_to_exitcode(status), used.ru_utime + used.ru_stime]), flush=True)


def parse_nothing(command: Any) -> None:
    """Make the parsers of a command's options, and of its commands': that takes each process 0.1 s."""
    command.make_context("heli-host", [], resilient_parsing=True)
    for part in getattr(command, "commands", {}).values():
        parse_nothing(part)


def exit_code_of(words: list[str], output_file: str) -> int:
    """Exit code of a command, which says on its standard error what went wrong with it."""
    try:
        become(words, output_file)
    except SystemExit as ended:
        if ended.code is None or isinstance(ended.code, int):
            return ended.code or 0
        print(ended.code, file=sys.stderr)
        return 1
    except BaseException:  # noqa: BLE001  -- of a document's program, as Python shows it
        traceback.print_exc()
        return 1
    return 0


def end(code: int) -> NoReturn:
    """End this process as Python does, except that nothing is freed: that takes half of a short command."""
    # It waits for threads first, and nothing else in Python does so before the functions of `atexit`.
    threading._shutdown()  # type: ignore[attr-defined]
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    os._exit(code)


def become(words: list[str], output_file: str) -> None:
    """Be a command, with nothing to read and its output in a file."""
    signal.alarm(PATIENCE_S)
    with Path(os.devnull).open("rb") as nothing, Path(output_file).open("wb") as output:
        os.dup2(nothing.fileno(), 0)
        for number in (1, 2):
            os.dup2(output.fileno(), number)
    program, *sys.argv[1:] = words
    # Where it lies itself is no place for what a document imports; where a command runs is.
    sys.path[0] = ""
    if program == HELI_HOST:
        from heli_host.ui.cli import main as heli_host

        sys.argv[0] = program
        heli_host()
    elif program != PYTHON:
        os.execvp(program, words)
    else:
        sys.argv[:] = ["-c"]
        exec(compile(words[-1], "<document>", "exec"), {"__name__": "__main__"})


PLANS: Final = "plans"
"""Fly only the first seconds of a plan."""
WORK: Final = "work"
"""Use less of each flight, fewer refits, fewer iterations, coarser figures; analyse equal flights once."""
SEGMENTS_s: Final = 20.0
"""Duration of a plan's segments, s: at 16 s the sine of the plan `identify` is refused as too short."""
USED_s: Final = 16.0
"""Used part of each flight that a document fits, s: at 11 s, hidden effects are not named."""
REFITS: Final = 2
"""Refits of a search for causes: with 1 no cause is named."""
ITERATIONS: Final = 20
"""Iterations of an optimizer, which the design of gains starts four times."""
DPI: Final = 20
"""Resolution of written figures, dots per inch."""


def shorten(parts: Iterable[str]) -> None:
    """Shorten `parts`, `PLANS` or `WORK`, of what this process does from now on."""
    import heli_host.fly.plan
    import heli_lab.explain
    import heli_lab.explain.run
    import heli_lab.fit
    import heli_lab.fit.records
    import scipy.optimize
    from matplotlib.figure import Figure

    if PLANS in parts:
        _wrap(heli_host.fly.plan, "parse_toml", _short_plan)
    if WORK in parts:
        _wrap(heli_lab.explain, "diagnose", _computed_once)
        _wrap(heli_lab.fit, "identify", _computed_once)
        _wrap(heli_lab.fit.identification, "identify", _computed_once)
        _wrap(heli_lab.explain.run, "prepare", _short_record)
        _wrap(heli_lab.explain.run, "search", _small_search)
        _wrap(heli_lab.fit.records, "prepare", _short_record)
        _wrap(scipy.optimize, "minimize", _few_iterations)
        _wrap(Figure, "savefig", _coarse_figure)


def _wrap(holder: Any, name: str, how: Callable[..., Any]) -> None:
    original = getattr(holder, name)

    @functools.wraps(original)
    def wrapped(*arguments: Any, **options: Any) -> Any:
        return how(original, *arguments, **options)

    setattr(holder, name, wrapped)


def _short_plan(parse: Callable[[str], dict[str, Any]], text: str) -> dict[str, Any]:
    """Read TOML, and leave out of a plan what comes after so many seconds."""
    values = parse(text)
    rows, left_s = values.get("segment"), SEGMENTS_s
    if not isinstance(rows, list):
        return values
    kept: list[Any] = []
    for row in rows:
        duration_s = row.get("duration_s", 0.0)
        if kept and duration_s > left_s:
            break
        # A first segment may be longer than all that is left; waypoints have their times in their points.
        kept.append({**row, "duration_s": left_s} if duration_s > left_s and "points" not in row else row)
        left_s -= duration_s
    return {**values, "segment": kept}


def _computed_once(compute: Callable[..., Any], *arguments: Any, **options: Any) -> Any:
    """Return the result of an earlier call with equal arguments, which a second run of a notebook makes."""
    if not all(isinstance(value, int | float | str) for value in options.values()):
        return compute(*arguments, **options)
    model, rig, *roles = arguments
    given = [[(f.t_s, f.angles_rad, f.voltages_V, f.parameters) for f in role] for role in roles]
    effects = [(effect.name, sorted(effect.values.items())) for effect in model.effects]
    named = (compute.__name__, model.name, effects, rig, given, options)
    key = hashlib.sha256(pickle.dumps(named)).hexdigest()
    # Next to the folder of the document, in which a test looks for what the document writes.
    kept = Path.cwd().with_name(f"result-{key}.pickle")
    if not kept.exists():
        kept.write_bytes(pickle.dumps(compute(*arguments, **options)))
    return pickle.loads(kept.read_bytes())


def _short_record(prepare: Callable[..., Any], flight: Any, *arguments: Any, **options: Any) -> Any:
    return prepare(flight.between(flight.t_s[0], flight.t_s[0] + USED_s), *arguments, **options)


def _small_search(search: Callable[..., Any], *arguments: Any, refits: float, **options: Any) -> Any:
    return search(*arguments, refits=min(refits, REFITS), **options)


def _few_iterations(
    minimize: Callable[..., Any], *arguments: Any, options: dict[str, Any] | None = None, **more: Any
) -> Any:
    return minimize(*arguments, options={**(options or {}), "maxiter": ITERATIONS}, **more)


def _coarse_figure(savefig: Callable[..., None], *arguments: Any, **options: Any) -> None:
    savefig(*arguments, **{**options, "dpi": DPI})


if __name__ == "__main__":
    main()
