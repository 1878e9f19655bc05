"""``python -m tests.repo.size`` counts files and lines by folder;
``python -m tests.repo.size entered -- ARGUMENTS`` counts the files that a command of ``heli-host`` enters.
"""

from __future__ import annotations

import ast
import io
import subprocess
import sys
import tokenize
from collections import Counter
from pathlib import Path
from types import FrameType
from typing import Any, Final

ROOT: Final = Path(__file__).resolve().parents[2]
SOURCES: Final = (".py", ".pyi", ".cpp", ".hpp", ".c", ".h", ".md")
NOT_CODE: Final = {
    *(tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER)
}
PACKAGES: Final = ("host/heli_host", "sim/heli_sim", "sim/heli_lab", "sim/heli_benchmark")


def tracked() -> list[Path]:
    """Files that git tracks."""
    names = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    return [Path(name) for name in names.splitlines() if (ROOT / name).is_file()]


def code_and_docstrings(source: str) -> tuple[int, int]:
    """Count the lines of code, and those of docstrings."""
    docstrings: set[int] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)):
            first = node.body[0] if node.body else None
            if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant):
                docstrings |= set(range(first.lineno, (first.end_lineno or first.lineno) + 1))
    code: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type not in NOT_CODE:
            code |= set(range(token.start[0], token.end[0] + 1))
    return len(code - docstrings), len(docstrings)


def room_of(path: Path) -> str:
    """Folder that a file is counted in: one level for tests and firmware, two for packages."""
    depth = 3 if path.parts[0] in ("host", "sim") else 2
    return "/".join(path.parts[: min(depth, max(1, len(path.parts) - 1))])


def print_sizes() -> None:
    """Print files, lines, and lines of code per Python file, by folder and in all."""
    files, lines, python, code, docstrings = (Counter[str]() for _ in range(5))
    for path in tracked():
        in_tests = "tests" in path.parts
        for room in {room_of(path), "all", "all tests" if in_tests else "all but tests"}:
            files[room] += 1
            if path.suffix not in SOURCES:
                continue
            source = (ROOT / path).read_text(errors="replace")
            lines[room] += source.count("\n")
            if path.suffix == ".py":
                of_code, of_docstrings = code_and_docstrings(source)
                python[room] += 1
                code[room] += of_code
                docstrings[room] += of_docstrings
        for package in PACKAGES:
            if str(path).startswith(package + "/") and path.suffix == ".py" and not in_tests:
                of_code, of_docstrings = code_and_docstrings((ROOT / path).read_text())
                name = f"all of {package}"
                files[name] += 1
                python[name] += 1
                code[name] += of_code
                docstrings[name] += of_docstrings
    print(f"{'folder':<32}{'files':>7}{'lines':>9}{'code':>9}{'docstrings':>12}{'code per .py':>14}")
    for room in sorted(files, key=lambda room: (room.startswith("all"), room)):
        per_file = code[room] / max(1, python[room])
        print(
            f"{room:<32}{files[room]:>7}{lines[room]:>9}{code[room]:>9}{docstrings[room]:>12}{per_file:>14.0f}"
        )


def print_entered(arguments: list[str]) -> int:
    """Run a command of ``heli-host``, print the files of the project that it enters, and return its code."""
    entered: set[str] = set()

    def note(frame: FrameType, event: str, _: Any) -> None:
        if event == "call":
            entered.add(frame.f_code.co_filename)

    import threading

    from heli_host.ui.cli.entry import run

    sys.setprofile(note)
    threading.setprofile(note)
    try:
        code = run(arguments)
    finally:
        sys.setprofile(None)
    ours = sorted(
        str(Path(name).relative_to(ROOT))
        for name in entered
        if name.startswith(str(ROOT)) and "/.venv/" not in name and not name.startswith(str(ROOT / "tests"))
    )
    print("\n".join(ours))
    print(f"{len(ours)} files entered")
    return code


if __name__ == "__main__":
    if sys.argv[1:2] == ["entered"]:
        sys.exit(print_entered(sys.argv[3:] if sys.argv[2:3] == ["--"] else sys.argv[2:]))
    print_sizes()
