"""Files and folders say what they are, names state what things are, and nothing depends on one machine."""

import ast
import re
import tomllib
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import heli_host
import pytest

from tests.repo import size

ROOT = Path(__file__).resolve().parents[2]
# Written so that this file does not hold what it looks for.
MACHINE_PATH = re.compile(
    r"(?<![\w.$}~>])/(?:" + "|".join(("work", "home", "root", "Users", "tmp")) + r")/\w"
)
TEXT_ENDS = {".py", ".md", ".toml", ".cpp", ".hpp", ".h", ".txt", ".sh", ".yml", ".yaml", ".json", ".ini", ""}
LARGEST_KIB = 300
TOP_LEVEL = {
    *("firmware", "host", "sim", "tests", "docs", ".ci", ".devcontainer"),
    *("README.md", "CHANGELOG.md", "CITATION.cff", "CONTRIBUTING.md", "LICENSE", "SECURITY.md"),
    *("Makefile", "CMakeLists.txt", "conftest.py", "platformio.ini", "pyproject.toml"),
    *(".clang-format", ".clang-tidy", ".gitignore"),
}


def tracked() -> list[Path]:
    return [ROOT / path for path in size.tracked()]


def folders() -> list[Path]:
    """Every folder with sources in it, but for those of the documents."""
    directories = {path.parent for path in tracked() if path.suffix in (".py", ".cpp", ".hpp", ".toml")}
    return sorted(folder for folder in directories - {ROOT} if ROOT / "docs" not in (folder, *folder.parents))


def purpose_of(folder: Path) -> str:
    """Purpose of a folder: its README or its package's docstring; or those of the nearest folder above."""
    # A top-level folder speaks only for itself and its own folders.
    above = [place for place in folder.parents if ROOT in place.parents and place.parent != ROOT]
    for place in (folder, *(above or folder.parents[:1])):
        for name in ("README.md", "__init__.py"):
            text = (place / name).read_text() if (place / name).exists() and place != ROOT else ""
            if name == "README.md" and text:
                return text
            if name == "__init__.py" and text:
                return ast.get_docstring(ast.parse(text)) or ""
    return ""


@pytest.mark.medium
def test_no_path_of_a_build_machine() -> None:
    places = []
    for path in tracked():
        if path.suffix not in TEXT_ENDS:
            continue
        for number, line in enumerate(path.read_text(errors="replace").splitlines(), 1):
            if MACHINE_PATH.search(line):
                places.append(f"{path.relative_to(ROOT)}:{number}: {line.strip()}")
    assert not places, "\n".join(places)


def skipped_by_mypy() -> list[str]:
    """Parts of libraries whose types mypy does not read."""
    overrides = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["mypy"]["overrides"]
    (skipped,) = (override["module"] for override in overrides if override.get("follow_imports") == "skip")
    return [name.removesuffix(".*") for name in skipped]


def imports(source: str, part: str) -> bool:
    """Whether a source imports a part of a library, or something of it."""
    library, _, last = part.rpartition(".")
    ways = [rf"(?:from|import) {re.escape(part)}\b"]
    ways += [rf"from {re.escape(library)} import [^\n]*\b{last}\b"] if library else []
    return part.partition(".")[0] in source and any(re.search(rf"^\s*{way}", source, re.M) for way in ways)


@pytest.mark.medium
def test_nothing_is_used_whose_types_mypy_does_not_read() -> None:
    sources = {path: path.read_text() for path in tracked() if path.suffix == ".py"}
    for part in skipped_by_mypy():
        users = [path.relative_to(ROOT) for path, text in sources.items() if imports(text, part)]
        assert not users, f"{part}: {users}"


@pytest.mark.medium
def test_the_top_level_has_no_results_of_a_command() -> None:
    assert {path.relative_to(ROOT).parts[0] for path in tracked()} <= TOP_LEVEL


@pytest.mark.medium
def test_no_large_file() -> None:
    large = [f"{path.relative_to(ROOT)}" for path in tracked() if path.stat().st_size > LARGEST_KIB * 1024]
    assert not large


@pytest.mark.medium
@pytest.mark.parametrize("folder", folders(), ids=lambda folder: str(folder.relative_to(ROOT)))
def test_a_folder_says_what_it_is_for(folder: Path) -> None:
    assert 1 <= len(purpose_of(folder).splitlines()) <= 60


DOCSTRING = re.compile(r'(?:\s|#[^\n]*\n)*r?"""(.*?)"""', re.DOTALL)
"""The docstring of a module, behind comments. To parse all files takes 1.5 s of CPU."""


def first_words(path: Path) -> str:
    """Description of a source in its first lines."""
    text = path.read_text()
    if path.suffix == ".py":
        docstring = DOCSTRING.match(text)
        return (docstring[1] if docstring is not None else "") if text.strip() else "empty"
    return text.partition("\n")[0].removeprefix("//") if text.startswith("//") else ""


@pytest.mark.medium
@pytest.mark.slow
def test_a_source_file_says_first_what_it_is() -> None:
    sources = [
        path for path in tracked() if path.suffix in (".py", ".hpp", ".js") and "vendor" not in path.parts
    ]
    silent = [str(path.relative_to(ROOT)) for path in sources if len(first_words(path).strip()) < 5]
    # A test states its claim in its name, and a notebook its subject in its cells.
    allowed = ("tests/", "docs/course/", "docs/laws/")
    assert not [path for path in silent if not path.startswith(allowed)]


@pytest.mark.medium
def test_the_version_is_the_same_everywhere() -> None:
    version = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    assert heli_host.__version__ == version
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text()
    assert f"({version})" in (ROOT / "CHANGELOG.md").read_text()


@pytest.mark.medium
@pytest.mark.parametrize(
    "name", ["CHANGELOG.md", "CITATION.cff", "CONTRIBUTING.md", "LICENSE", "SECURITY.md"]
)
def test_the_readme_leads_to_what_a_community_expects(name: str) -> None:
    assert (ROOT / name).is_file()
    assert f"]({name})" in (ROOT / "README.md").read_text()


@pytest.mark.medium
def test_nothing_is_left_unfinished() -> None:
    marks = re.compile("|".join(("TO" + "DO", "FIX" + "ME", "X" * 3, "Not" + "ImplementedError")))
    unfinished = [
        f"{path.relative_to(ROOT)}:{number}"
        for path in tracked()
        if path.suffix in TEXT_ENDS
        for number, line in enumerate(path.read_text(errors="replace").splitlines(), 1)
        if marks.search(line)
    ]
    assert not unfinished


NO_NOUNS = frozenset({"one", "found", "own", "taken", "told", "asked", "said", "usual"})
"""Words that name nothing: the reader has to find out what was found."""
NO_NOUN = re.compile(rf"\b_*({'|'.join(sorted(NO_NOUNS))}|left)_*\b")
TEXT_OR_COMMENT = re.compile(
    r'''(\b[fF][rR]?|\b[rR][fF])?("""(?:\\.|[^\\])*?"""|"(?:\\.|[^"\\\n])*"|'(?:\\.|[^'\\\n])*')|#[^\n]*''',
    re.DOTALL,
)
"""A text, with its prefix as first group if names may be in it, or a comment."""


def names_of(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Yield line and name of each variable, argument, field, function and class of a file."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.lineno, node.id
        elif isinstance(node, ast.arg):
            yield node.lineno, node.arg
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield node.lineno, node.name
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node.lineno, node.attr
        elif isinstance(node, ast.ExceptHandler) and node.name:
            yield node.lineno, node.name


def meaningless(source: str) -> list[tuple[int, str]]:
    """Line and name of each name that states nothing; `left` is a side if the file also has a `right`."""
    # To parse all files takes 3 s of CPU; in most, these words are only in texts and comments.
    code = TEXT_OR_COMMENT.sub(lambda text: text[0] if text[1] else "", source)
    if not NO_NOUN.search(code):
        return []
    names = list(names_of(ast.parse(source)))
    sides = {"left", "right"}.issubset(name for _, name in names)
    words = NO_NOUNS if sides else NO_NOUNS | {"left"}
    return [(line, name) for line, name in names if name.strip("_") in words]


@pytest.mark.slow
def test_no_name_in_python_is_a_word_without_meaning() -> None:
    files = [path for path in tracked() if path.suffix == ".py"]
    assert len(files) > 500
    places = [
        f"{path.relative_to(ROOT)}:{line}: {name}"
        for path in files
        for line, name in meaningless(path.read_text(encoding="utf-8"))
    ]
    assert not places, "name the thing, such as `entry` for `found`:\n" + "\n".join(places)


def test_a_word_without_meaning_is_noticed_as_variable_argument_field_and_function() -> None:
    source = """
class A:
    found: int = 0

    def told(self, own):
        self._said = [one for one in own]
"""
    assert meaningless(source) == [(5, "told"), (3, "found"), (5, "own"), (6, "_said"), (6, "one")]
    assert meaningless("left = 3\n") == [(1, "left")]
    assert meaningless("left, right = 3, 4\n") == []


PACKAGES = {
    "due_emulator": "sim/due",
    "heli_host": "host",
    "heli_sim": "sim",
    "heli_lab": "sim",
    "heli_benchmark": "sim",
}
INTERFACES = {
    "ENTRY_POINT_GROUP": "each file that looks up plug-ins states its group",
    "SPEC": "each file of effects states what it is",
    "SPECS": "the same, for several effects in a file",
    "main": "each module that can be run with python -m has one",
    "diagnose": "a work of campaigns and the function that it runs have the name of the analysis",
    "identify": "the same",
}
"""Names that every implementation of an interface has, and why."""


def public_names_of(path: Path) -> Iterator[str]:
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield node.name
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            yield from (target.id for target in targets if isinstance(target, ast.Name))


def ambiguous(folder: Path) -> dict[str, set[str]]:
    """Public names that more than one module defines; modules of verbs are named as their commands."""
    where = defaultdict(set)
    for path in folder.rglob("*.py"):
        if "tests" in path.relative_to(folder).parts:
            continue
        if "verbs" not in path.parts:
            for name in public_names_of(path):
                if not name.startswith("_"):
                    where[name].add(str(path.relative_to(folder)))
    return {name: places for name, places in where.items() if len(places) > 1 and name not in INTERFACES}


@pytest.mark.medium
@pytest.mark.parametrize("package", PACKAGES)
def test_a_public_name_is_defined_in_one_module_of_a_package(package: str) -> None:
    assert ambiguous(ROOT / PACKAGES[package] / package) == {}


def test_the_same_name_in_two_modules_is_noticed(tmp_path: Path) -> None:
    (tmp_path / "a.py").write_text("class Law: ...\n_LIMIT = 1\n")
    (tmp_path / "b.py").write_text("Law: int = 2\n_LIMIT = 2\n")
    assert ambiguous(tmp_path) == {"Law": {"a.py", "b.py"}}


STATE_OF_A_MODULE = re.compile(
    r"^\w+(?::[^=\n]+)? = (?:\{\}|\[\]|(?:dict|list|set|OrderedDict)\(\)|defaultdict\()", re.MULTILINE
)
"""A name of a module for a collection that is empty at first, to be filled by functions."""
STATEFUL = {
    "sim/heli_lab/apps/campaign/worker.py": "a worker of Dask has no object that lives between its jobs"
}


def test_no_module_has_a_state_of_its_own() -> None:
    """A cache in a module keeps compiled models until Python ends; `heli-host` then printed their leaks."""
    stateful = [
        str(path.relative_to(ROOT))
        for package, folder in PACKAGES.items()
        for path in (ROOT / folder / package).rglob("*.py")
        if STATE_OF_A_MODULE.search(path.read_text(encoding="utf-8"))
    ]
    assert stateful == list(STATEFUL)


ROOMS = ("host/heli_host/ui/cli", "sim/heli_sim/verbs", "sim/heli_lab/verbs")
SAFE = {"printable"}


def raw_prints(source: str) -> Iterator[int]:
    """Yield the lines that print something else than a constant or what `SAFE` returned."""
    for node in ast.walk(ast.parse(source)):
        if (
            isinstance(node, ast.Call)
            and isinstance(node.func, ast.Name)
            and node.func.id == "print"
            and not all(map(_is_safe, node.args))
        ):
            yield node.lineno
        # As a callback, it prints whatever it is given.
        if isinstance(node, ast.Call | ast.keyword):
            given = [node.value] if isinstance(node, ast.keyword) else node.args
            if any(isinstance(argument, ast.Name) and argument.id == "print" for argument in given):
                yield node.lineno if isinstance(node, ast.Call) else node.value.lineno


def _is_safe(value: ast.expr) -> bool:
    if isinstance(value, ast.JoinedStr):
        return all(map(_is_safe, value.values))
    if isinstance(value, ast.FormattedValue):
        return _is_safe(value.value)
    if isinstance(value, ast.Call):
        return isinstance(value.func, ast.Name) and value.func.id in SAFE
    return isinstance(value, ast.Constant)


@pytest.mark.parametrize("room", ROOMS)
def test_no_verb_prints_a_name_raw(room: str) -> None:
    files = [file for file in (ROOT / room).rglob("*.py") if file.name != "say.py"]
    assert len(files) > 2
    prints = [f"{file.relative_to(ROOT)}:{line}" for file in files for line in raw_prints(file.read_text())]
    assert not prints, f"print these with heli_host.ui.cli.say: {', '.join(prints)}"


@pytest.mark.parametrize(
    "line",
    [
        "print(path)",
        'print(f"{path}")',
        'print("a", path)',
        'print(f"{printable(cause)} {path}")',
        "listen(print)",
        "listen(answer=print)",
        "listen(partial(print, flush=True))",
        "print(*lines)",
    ],
)
def test_a_raw_print_is_seen(line: str) -> None:
    assert list(raw_prints(line)) == [1]
