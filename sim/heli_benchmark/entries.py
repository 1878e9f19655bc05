"""Runs of methods on a split: a method by its name, the process of each case, and cases on a cluster."""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path
from types import ModuleType
from typing import Any, Final

from heli_host.data.files import file_digest

from heli_benchmark.errors import BenchmarkError
from heli_benchmark.task import CAUSES_FILE, COMMITMENTS_FILE, SCHEMA, Split, read_json, write_json

_METHODS: Final = Path(__file__).parent / "methods"
_SHARED: Final = tuple(
    # A file comes before those that it imports.
    _METHODS / f"{stem}.py"
    for stem in ("boosting", "terms")
)
_FUNCTION: Final = "diagnose"
_TRAIN: Final = "train"


@dataclass(frozen=True)
class MethodAddress:
    """Where a method is."""

    file: Path  # Python file that defines it
    function: str  # Name of the function that answers a case
    builtin: bool  # Whether the file belongs to this package

    @property
    def text(self) -> str:
        """Text from which `find_method` finds it in any folder."""
        return self.file.stem if self.builtin else f"{self.file}:{self.function}"

    @property
    def digest(self) -> str:
        """Digest of the code: of the file, and of what methods of this package share if it uses that."""
        content = self.file.read_bytes()
        for shared in _SHARED:
            if self.builtin and shared.stem.encode() in content:
                content += shared.read_bytes()
        return hashlib.sha256(content).hexdigest()


def builtin_methods() -> list[str]:
    """Return the names of the methods of this package: files with a function `diagnose`."""
    definition = f"\ndef {_FUNCTION}("
    return sorted(
        path.stem for path in _METHODS.glob("*.py") if definition in path.read_text(encoding="utf-8")
    )


def find_method(text: str) -> MethodAddress:
    """Find a method."""
    if text in builtin_methods():
        return MethodAddress(_METHODS / f"{text}.py", _FUNCTION, builtin=True)
    name, _, function = text.rpartition(":")
    if not name or not function.isidentifier():
        raise BenchmarkError(
            f"unknown method '{text}'", f"give FILE.py:FUNCTION, or one of {', '.join(builtin_methods())}"
        )
    file = Path(name)
    if not file.is_file():
        raise BenchmarkError(f"the file of the method, {name}, does not exist", "check the path")
    return MethodAddress(file.resolve(), function, builtin=False)


def load_function(method: MethodAddress) -> Callable[..., Any]:
    """Import a method, and return its function."""
    function = getattr(_import_module(method), method.function, None)
    if not callable(function):
        raise BenchmarkError(f"{method.file} has no function '{method.function}'", "give another name")
    # What it takes and returns is checked when it answers a case.
    return function  # type: ignore[no-any-return]


def load_train(method: MethodAddress) -> Callable[[Path], None] | None:
    """Import a method, and return its function `train`, or None if it has none."""
    return getattr(_import_module(method), _TRAIN, None)


def _import_module(method: MethodAddress) -> ModuleType:
    """Import the module of a method; a user's file may import its neighbours."""
    if method.builtin:
        return importlib.import_module(f"heli_benchmark.methods.{method.file.stem}")
    sys.path.insert(0, str(method.file.parent))
    spec = importlib.util.spec_from_file_location(f"entered_{method.file.stem}", method.file)
    if spec is None or spec.loader is None:
        raise BenchmarkError(f"{method.file} is not a Python file", "give FILE.py:FUNCTION")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


WALL_FACTOR: Final = 30.0
"""Elapsed time per CPU time from which a process counts as hanging without work. At 4, a case on a computer
with 25 busy processes was stopped before its CPU limit."""


@dataclass(frozen=True)
class RunLimits:
    """Limits of the process of a case."""

    cpu_s: int = 300  # CPU time
    memory_MB: int = 6000  # Address space


def run_case(
    method: MethodAddress, case: str, resources: Path | None, limits: RunLimits, file: Path
) -> dict[str, Any]:
    """Run a method on the folder of a case in a process, and return its result; the case "-" trains it."""
    resources_text = "-" if resources is None else str(resources.resolve())
    command = [
        sys.executable,
        "-m",
        "heli_benchmark.worker",
        method.text,
        case,
        str(file.resolve()),
        resources_text,
    ]
    command += [str(limits.cpu_s), str(limits.memory_MB)]
    # Threads that wait for each other cost CPU time, and sums in another order change the last digits.
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    environment = {**os.environ, **threads, "PYTHONHASHSEED": "0"}
    failure = ""
    try:
        process = subprocess.run(
            command,
            env=environment,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=WALL_FACTOR * limits.cpu_s,
            check=False,
        )
        if process.returncode:
            failure = f"the process ended with code {process.returncode}; its limits are {limits}"
    except subprocess.TimeoutExpired:
        failure = f"the process took more than {WALL_FACTOR * limits.cpu_s:.0f} s"
    if failure:
        write_json(file, {"answer": None, "failure": failure, "cpu_s": None, "peak_MB": None})
    return read_json(file, "run the method again")


Distribute = Callable[
    [MethodAddress, Sequence[Path], Path | None, RunLimits], Iterator[tuple[str, dict[str, Any]]]
]
"""Runs a method on cases with resources and limits, and yields names and results."""
RUN_FILE: Final = "run.json"
_TRAINED_FILE: Final = "trained.json"


def run_method(
    split: Split,
    text: str,
    folder: Path,
    *,
    limits: RunLimits | None = None,
    resources: Path | None = None,
    workers: int = 1,
    distribute: Distribute | None = None,
    say: Callable[[str, str], None] | None = None,
) -> None:
    """Run a method on the cases of a split that have no result yet."""
    # `distribute`: Runs the cases on other machines, such as those of a cluster, and yields the name and the
    # result of each. They must see the folders of split, method and resources under the same paths. Without
    # it, the cases run here, on `workers` processes. With `resources`, the method is trained first. `say`
    # takes the name and the failure of each case.
    limits = limits or RunLimits()
    method = find_method(text)
    _check_folder(split, method, text, folder, limits)
    if resources is not None and not (folder / _TRAINED_FILE).exists():
        result = run_case(method, "-", resources, limits, folder / _TRAINED_FILE)
        if result["failure"]:
            (folder / _TRAINED_FILE).unlink()
            raise BenchmarkError(f"{text} cannot be trained: {result['failure']}", "correct the method")
    waiting = [case for case in split.cases if not (folder / f"{case.name}.json").exists()]

    if distribute is not None:
        for name, result in distribute(method, waiting, resources, limits):
            write_json(folder / f"{name}.json", result)
            if say is not None:
                say(name, result["failure"])
        return

    def work(case: Path) -> None:
        result = run_case(method, str(case), resources, limits, folder / f"{case.name}.json")
        if say is not None:
            say(case.name, result["failure"])

    with ThreadPoolExecutor(workers) as pool:
        jobs = [pool.submit(work, case) for case in waiting]
        try:
            for job in jobs:
                job.result()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise


def read_run(folder: Path, split: Split) -> dict[str, dict[str, Any]]:
    """Read the results of a run by case."""
    run_file = folder / RUN_FILE
    if run_file.exists() and read_json(run_file, "run again").get("split_digest") != split_digest(split):
        raise BenchmarkError(f"{folder} has answers to another split", f"run the method on {split.folder}")
    results = {}
    for case in split.cases:
        path = folder / f"{case.name}.json"
        content = read_json(path, "run `heli-host benchmark run` again, it continues")
        # An answer from another program has no costs.
        results[case.name] = content if "answer" in content else {"answer": content, "failure": ""}
    return results


def split_digest(split: Split) -> str:
    """Return a digest of the definition of a split, with its commitments if it is sealed."""
    digest = file_digest(split.folder / CAUSES_FILE)
    return digest if split.commitments is None else digest + file_digest(split.folder / COMMITMENTS_FILE)


def _check_folder(split: Split, method: MethodAddress, text: str, folder: Path, limits: RunLimits) -> None:
    """Refuse a folder with results of another method, split or limit; otherwise prepare it."""
    folder.mkdir(parents=True, exist_ok=True)
    content = {
        "schema": SCHEMA,
        "split": split.name,
        "split_digest": split_digest(split),
        "method": text,
        "method_digest": method.digest,
        "limits": asdict(limits),
    }
    run_file = folder / RUN_FILE
    if run_file.exists():
        earlier = read_json(run_file, "choose another folder")
        changed = [name for name, value in content.items() if earlier.get(name) != value]
        if changed:
            raise BenchmarkError(
                f"{folder} has results with another {changed[0].replace('_', ' ')}",
                "choose another folder, or delete it",
            )
    write_json(run_file, content)


_WORK: Final = "heli_benchmark.entries:answer_case"
_MARGIN_s: Final = 60.0
"""Time for which the engine waits longer than the limit of a case, so that the case reports its end."""


def answer_case(settings: Mapping[str, Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Answer a case on a worker, in a process with limits."""
    method = find_method(settings["method"])
    if method.digest != settings["digest"]:
        raise BenchmarkError(f"{method.file} differs on this worker", "install the same version there")
    resources = None if settings["resources"] is None else Path(settings["resources"])
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "result.json"
        result = run_case(method, settings["case"], resources, RunLimits(**settings["limits"]), file)
    return {"answered": not result["failure"]}, result


def run_on_cluster(
    scheduler: str, method: MethodAddress, cases: Sequence[Path], resources: Path | None, limits: RunLimits
) -> Iterator[tuple[str, dict[str, Any]]]:
    """Run a method on cases, and yield the name and the result of each case that ends."""
    # `method`: File and function, which every worker must see under the same path.
    if not cases:
        return
    # Only a run on a cluster needs Dask.
    from heli_lab.apps.campaign import Campaign, Case, Store, campaign_results
    from heli_lab.apps.campaign.cases import Limits

    settings = {
        "method": method.text,
        "digest": method.digest,
        "resources": None if resources is None else str(resources.resolve()),
        "limits": asdict(limits),
    }
    campaign = Campaign(
        "benchmark",
        tuple(Case(case.name, _WORK, {"case": str(case.resolve()), **settings}) for case in cases),
        Limits(wait_s=WALL_FACTOR * limits.cpu_s + _MARGIN_s),
    )
    with tempfile.TemporaryDirectory() as folder:
        for result in campaign_results(campaign, Store(Path(folder)), scheduler=scheduler):
            unanswered = {"answer": None, "failure": result.failure, "cpu_s": None, "peak_MB": None}
            yield result.name, unanswered if result.failure else result.detail
