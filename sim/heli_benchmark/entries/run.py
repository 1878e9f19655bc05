"""Run a method on all cases of a split; each case is a process with limits, and has a file of its own."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

from heli_host.data.files import file_digest

from heli_benchmark.entries.case_process import RunLimits, run_case
from heli_benchmark.entries.method import MethodAddress, find_method
from heli_benchmark.errors import BenchmarkError
from heli_benchmark.task.commitments import COMMITMENTS_FILE
from heli_benchmark.task.json_file import read_json, write_json
from heli_benchmark.task.split import CAUSES_FILE, SCHEMA, Split

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
    """Run a method on the cases of a split that have no result yet.

    `distribute`: Runs the cases on other machines, such as those of a cluster, and yields the name and the
    result of each. They must see the folders of split, method and resources under the same paths.
    """
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
