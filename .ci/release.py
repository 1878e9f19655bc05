"""Check whether this tree can be released, and build what a release uploads. Nothing is published.

``make release`` runs all checks, and ``make release CHECKS="changelog citation"`` these only. Wheel and
source archive are in ``dist/`` afterwards. Every check runs, and the exit code is 1 if one of them fails.
The wheel fits systems like this one; cibuildwheel builds for older systems.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tarfile
import tempfile
import time
import tomllib
import zipfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LONGEST_FIRST_FLIGHT_S = 60.0
"""From the start of pip to the end of the first flight: the goal for people without a compiler."""

EXTENSIONS = (
    "heli_sim/_native",
    "heli_sim/due/_due_board",
    "due_emulator/_due",
    "heli_lab/fit/_kalman",
)
"""Compiled parts that fly: the native board, the emulated Due and the filter of the laboratory."""

SOURCES = ("pyproject.toml", "LICENSE", "CMakeLists.txt", "Makefile", ".ci/setup", "firmware/link.toml")
"""Files that every source archive must contain: they make everything else."""


@dataclass(frozen=True)
class Finding:
    """A check's result: empty ``problem`` if it is good, otherwise the problem and how to fix it."""

    what: str
    problem: str = ""
    fix: str = ""

    def __str__(self) -> str:
        """Return the lines that are printed."""
        return (
            f"  FAILED  {self.what}: {self.problem}; {self.fix}" if self.problem else f"  ok      {self.what}"
        )


def check_clean(root: Path) -> Iterator[Finding]:
    """Check that what is built is what is committed, and that this version has no tag yet."""
    status = _run(["git", "status", "--porcelain"], root)
    changed = [line[3:] for line in status.stdout.splitlines()]
    if status.returncode:
        yield Finding("sources are committed", "this is no Git checkout", "release from a clone")
        return
    yield Finding(
        "sources are committed",
        f"{len(changed)} files differ from the last commit, {changed[0]} first" if changed else "",
        "commit or remove them",
    )
    tag = f"v{version_of(root)}"
    known = _run(["git", "tag", "--list", tag], root).stdout.strip()
    yield Finding(
        "this version has no tag",
        f"the tag {tag} exists" if known else "",
        "raise the version in pyproject.toml",
    )


def version_of(root: Path) -> str:
    """Return the version that pyproject.toml declares."""
    return str(tomllib.loads((root / "pyproject.toml").read_text())["project"]["version"])


def check_changelog(root: Path) -> Iterator[Finding]:
    """Check that the newest section of the changelog is this version with its date, and holds every entry."""
    version = version_of(root)
    sections = re.split(r"^## ", (root / "CHANGELOG.md").read_text(), flags=re.M)[1:]
    dated = [section for section in sections if not section.startswith("Unreleased")]
    pending = [
        section
        for section in sections
        if section.startswith("Unreleased") and re.search(r"^- ", section, re.M)
    ]
    heading = dated[0].partition("\n")[0] if dated else ""
    date = re.fullmatch(rf"\[?{re.escape(version)}\]? - (\d{{4}}-\d\d-\d\d)", heading)
    yield Finding(
        "CHANGELOG.md has this version",
        "" if date else f"its newest release is {heading or 'none'}, not {version} with a date",
        f"give the section the heading '## {version} - YYYY-MM-DD'",
    )
    yield Finding(
        "CHANGELOG.md has no unreleased entries",
        f"entries under 'Unreleased': {len(re.findall(r'^- ', pending[0], re.M))}" if pending else "",
        "move them below the version's heading",
    )


def check_citation(root: Path) -> Iterator[Finding]:
    """Check that the citation is valid and has the version that is released."""
    text = (root / "CITATION.cff").read_text()
    stated = re.search(r"^version: *[\"']?([^\"'\n]+)", text, re.M)
    yield Finding(
        "CITATION.cff has this version",
        ""
        if stated and stated[1].strip() == version_of(root)
        else f"it has {stated[1] if stated else 'none'}",
        f"write 'version: {version_of(root)}'",
    )
    tool = _beside_python("cffconvert")
    validated = _run([str(tool), "--validate", "-i", "CITATION.cff"], root)
    yield Finding(
        "CITATION.cff is valid", _last_line(validated), "see the Citation File Format, version 1.2.0"
    )


def build(root: Path, folder: Path) -> Iterator[Finding]:
    """Build the source archive, and the wheel from that archive, into a folder."""
    shutil.rmtree(folder, ignore_errors=True)
    compiled = _run([sys.executable, "-m", "heli_web.compiler"], root)
    yield Finding("the boards are compiled to WebAssembly", _last_line(compiled), "run: make web")
    words = [sys.executable, "-m", "build", "--outdir", str(folder), str(root)]
    module = {"HELI_BOARD_WASM": str(root / "build/web/board.wasm")}
    built = _run(words, root, {**os.environ, **module})
    yield Finding("source archive and wheel are built", _last_line(built), "run: .venv/bin/python -m build")


def check_archives(folder: Path, version: str) -> Iterator[Finding]:
    """Check the names, contents and descriptions of what was built."""
    wheels, archives = sorted(folder.glob("*.whl")), sorted(folder.glob("*.tar.gz"))
    named = [path.name for path in (*wheels, *archives)]
    wrong = [name for name in named if not name.startswith(f"heli_host-{version}")]
    yield Finding(
        "one wheel and one source archive of this version",
        ""
        if len(wheels) == len(archives) == 1 and not wrong
        else f"{folder} has {', '.join(named) or 'nothing'}",
        f"empty {folder} and build again",
    )
    for wheel in wheels:
        yield check_wheel(wheel)
    for archive in archives:
        yield check_source_archive(archive)
    if named:
        checked = _run(
            [sys.executable, "-m", "twine", "check", "--strict", *map(str, (*wheels, *archives))], folder
        )
        yield Finding(
            "a package index can show the description", _last_line(checked), "run: twine check --strict"
        )


def check_wheel(wheel: Path) -> Finding:
    """Check that a wheel contains what flies, for both boards, and nothing of the tests."""
    with zipfile.ZipFile(wheel) as file:
        names = file.namelist()
    missing = [name for name in EXTENSIONS if not any(path.startswith(name + ".") for path in names)]
    for file_type, content in (
        (".elf", "the Due's firmware (*.elf)"),
        (".wasm", "both boards for the browser"),
    ):
        missing += [] if any(name.endswith(file_type) for name in names) else [content]
    tests = [name for name in names if re.search(r"(^|/)(tests?/|test_|conftest|heli_test_)", name)]
    problem = f"missing: {', '.join(missing)}" if missing else f"it contains {tests[0]}" if tests else ""
    return Finding(
        "the wheel has both boards and no tests",
        problem,
        "run: make setup, make web; build again",
    )


def check_source_archive(archive: Path) -> Finding:
    """Check that the source archive has sources and licence, and nothing that was built or flown."""
    with tarfile.open(archive) as file:
        names = [name.partition("/")[2] for name in file.getnames()]
    missing = [name for name in SOURCES if name not in names]
    built = [name for name in names if re.search(r"^(build|dist|flights|\.venv)/|\.(mcap|so|o|elf)$", name)]
    problem = f"missing: {', '.join(missing)}" if missing else f"it contains {built[0]}" if built else ""
    return Finding(
        "the source archive has sources only", problem, "see [tool.scikit-build] in pyproject.toml"
    )


def fly_from(command: Sequence[str], folder: Path, environment: dict[str, str]) -> Finding:
    """Fly an installed ``heli-host``, and write a page, without a program on its path, so without a compiler.

    Parameters
    ----------
    command : sequence of str
        How ``heli-host`` is started, by absolute path.
    folder : Path
        Where log and caches are written.
    environment : dict of str to str
        Variables in addition to the search path, which is an empty folder.
    """
    nowhere = folder / "no-programs"
    nowhere.mkdir()
    clean = {
        "PATH": str(nowhere),
        "HOME": str(folder),
        "XDG_CACHE_HOME": str(folder / "cache"),
        **environment,
    }
    log = folder / "hover.mcap"
    page = ["web", "hover", "--rig", "makki2024", "--output", str(folder / "heli-lab.html")]
    for words in (page, ["fly", "hover", "--sil", "--speed", "max", "--log", str(log)], ["info", str(log)]):
        flown = _run([*command, *words], folder, clean)
        if flown.returncode:
            return Finding(
                "the wheel flies without a compiler", _last_line(flown), f"run: heli-host {' '.join(words)}"
            )
    flew = "completed" in flown.stdout
    return Finding(
        "the wheel flies without a compiler", "" if flew else "the flight did not complete", "see its log"
    )


def install_and_fly(wheels: Sequence[Path]) -> Iterator[Finding]:
    """Install a wheel into a separate environment, and fly there."""
    start_s = time.monotonic()
    if not wheels:
        yield Finding("the wheel installs", "there is no wheel", "see the failed build above")
        return
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        made = _run([sys.executable, "-m", "venv", str(folder / "venv")], folder)
        python = folder / "venv" / "bin" / "python"
        installed = (
            made
            if made.returncode
            else _run([str(python), "-m", "pip", "install", "--quiet", *map(str, wheels)], folder)
        )
        if installed.returncode:
            yield Finding("the wheel installs", _last_line(installed), "run: pip install dist/*.whl")
            return
        yield fly_from([str(python.parent / "heli-host")], folder, {})
    took_s = time.monotonic() - start_s
    yield Finding(
        f"first flight {took_s:.0f} s after the installation begins",
        "" if took_s <= LONGEST_FIRST_FLIGHT_S else f"{LONGEST_FIRST_FLIGHT_S:.0f} s are promised",
        "run it on an idle machine; see what pip compiles: pip install --verbose",
    )


def check_documents(root: Path) -> Iterator[Finding]:
    """Build the site; a warning or a broken link is a problem."""
    yield Finding("the site builds", _last_line(_run([".ci/site"], root)), "run: make docs")


def checks(root: Path) -> dict[str, Callable[[], Iterator[Finding]]]:
    """Return every check of a release by name, the cheap ones first."""
    folder = root / "dist"
    return {
        "commit": lambda: check_clean(root),
        "changelog": lambda: check_changelog(root),
        "citation": lambda: check_citation(root),
        "build": lambda: build(root, folder),
        "archives": lambda: check_archives(folder, version_of(root)),
        "installation": lambda: install_and_fly(sorted(folder.glob("*.whl"))),
        "site": lambda: check_documents(root),
    }


def main(names: Sequence[str]) -> None:
    """Run the named checks, or all without a name, and print a line for each."""
    known = checks(ROOT)
    if unknown := [name for name in names if name not in known]:
        raise SystemExit(f"error: unknown check {', '.join(unknown)}; choose from {', '.join(known)}")
    failed = 0
    for name, check in known.items():
        for finding in check() if not names or name in names else ():
            print(finding, flush=True)
            failed += bool(finding.problem)
    built = "; wheel and source archive are in dist/" if not names or "build" in names else ""
    print(f"nothing was published{built}")
    if failed:
        print(
            f"error: {failed} check{'s' if failed > 1 else ''} failed; fix them, then: make release",
            file=sys.stderr,
        )
        raise SystemExit(1)


def _beside_python(program: str) -> Path:
    return Path(sys.executable).parent / program


def _run(
    command: Sequence[str], folder: Path, environment: dict[str, str] | None = None
) -> subprocess.CompletedProcess[str]:
    """Run a program; one that is missing ends like one that fails."""
    try:
        return subprocess.run(
            list(command), cwd=folder, env=environment or dict(os.environ), capture_output=True, text=True,
            stdin=subprocess.DEVNULL, check=False,
        )  # fmt: skip
    except OSError as error:
        return subprocess.CompletedProcess(list(command), 127, "", f"{command[0]}: {error.strerror}")


def _last_line(finished: subprocess.CompletedProcess[str]) -> str:
    """Return the end of a failed program's output, and nothing of one that succeeded."""
    if not finished.returncode:
        return ""
    lines = (finished.stderr or finished.stdout).strip().splitlines()
    return lines[-1].strip() if lines else f"exit code {finished.returncode}"


if __name__ == "__main__":
    main(sys.argv[1:])
