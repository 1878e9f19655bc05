"""``python -m tests.repo.size`` counts files and lines by folder;
``python -m tests.repo.size entered -- ARGUMENTS`` counts the files that a command of ``heli-host`` enters.
"""

import ast
import io
import subprocess
import sys
import threading
import tokenize
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
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


def rooms_of(path: Path) -> Iterator[str]:
    """Folders and parts of the project in which a file is counted."""
    depth = 3 if path.parts[0] in ("host", "sim") else 2
    yield "/".join(path.parts[: min(depth, max(1, len(path.parts) - 1))])
    yield "all"
    if "tests" in path.parts:
        yield "all tests"
        return
    yield "all but tests"
    for package in PACKAGES:
        if path.suffix == ".py" and path.is_relative_to(package):
            yield f"all of {package}"


@dataclass
class Size:
    """Numbers of a folder."""

    files: int = 0
    lines: int = 0  # Lines of files whose suffix is one of `SOURCES`
    python_files: int = 0
    code: int = 0  # Lines of code in Python files
    docstrings: int = 0  # Lines of docstrings in Python files


def print_sizes() -> None:
    """Print files, lines, and lines of code per Python file, by folder and in all."""
    sizes: dict[str, Size] = defaultdict(Size)
    for path in tracked():
        source = (ROOT / path).read_text(errors="replace") if path.suffix in SOURCES else ""
        is_python = path.suffix == ".py"
        code, docstrings = code_and_docstrings(source) if is_python else (0, 0)
        for room in rooms_of(path):
            size = sizes[room]
            size.files += 1
            size.lines += source.count("\n")
            size.python_files += is_python
            size.code += code
            size.docstrings += docstrings
    print(f"{'folder':<32}{'files':>7}{'lines':>9}{'code':>9}{'docstrings':>12}{'code per .py':>14}")
    for room, size in sorted(sizes.items(), key=lambda item: (item[0].startswith("all"), item[0])):
        per_file = size.code / max(1, size.python_files)
        print(f"{room:<32}{size.files:>7}{size.lines:>9}{size.code:>9}{size.docstrings:>12}{per_file:>14.0f}")


def print_entered(arguments: list[str]) -> int:
    """Run a command of ``heli-host``, print the files of the project that it enters, and return its code."""
    entered: set[str] = set()

    def note(frame: FrameType, event: str, _: Any) -> None:
        if event == "call":
            entered.add(frame.f_code.co_filename)

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
