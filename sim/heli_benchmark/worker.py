"""The process of a case: it sets its limits, calls the method, and writes the answer with its cost."""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

from heli_host.data.files import limit_process

from heli_benchmark.entries import find_method, load_function, load_train
from heli_benchmark.task import answer_content, check_answer, read_case, write_json

_MB = 1 << 20


def main(arguments: list[str]) -> int:
    """Answer a case, or train a method."""
    method_text, case_folder, result_file, resources_text, cpu_limit_s, memory_limit_MB = arguments
    limit_process("CPU", int(cpu_limit_s), int(cpu_limit_s) + 5)
    limit_process("AS", int(memory_limit_MB) * _MB, int(memory_limit_MB) * _MB)
    resources = None if resources_text == "-" else Path(resources_text)
    result: dict[str, Any] = {"answer": None, "failure": ""}
    started_s = time.perf_counter()
    try:
        method = find_method(method_text)
        if case_folder == "-":
            train = load_train(method)
            if train is not None and resources is not None:
                train(resources)
        else:
            case = read_case(Path(case_folder), resources)
            content = load_function(method)(case)
            result["answer"] = answer_content(check_answer(content, case.causes, method_text))
    except BaseException as error:  # noqa: BLE001 - an error of a stranger's method is a row of the table
        result["failure"] = " ".join(f"{type(error).__name__}: {error}".split())[:500]
    result |= {"seconds": time.perf_counter() - started_s, "cpu_s": _cpu_s(), "peak_MB": _peak_MB()}
    write_json(Path(result_file), result)
    return 0


def _cpu_s() -> float:
    """CPU time of this process and its children, imports included."""
    import os

    used = os.times()
    return used.user + used.system + used.children_user + used.children_system


def _peak_MB() -> float | None:
    """Return the peak memory of this process; None on Windows."""
    if sys.platform == "win32":
        return None
    import resource

    # KiB on Linux, bytes on macOS.
    unit = 1 if sys.platform == "darwin" else 1024
    return unit * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / _MB


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
