"""Where people read text of this project, and the text itself: documents, docstrings, help, messages."""

import ast
import inspect
import io
import itertools
import re
import subprocess
import tokenize
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from markdown_it import MarkdownIt
from markdown_it.token import Token

MARKDOWN = MarkdownIt("commonmark").enable("table")
CODE = "`x`"
"""Stands for code in backticks: one word of a sentence, and no word to look at."""
SOURCES = (
    "sim/due/due_emulator/*.py",
    "host/heli_host/*.py",
    "sim/heli_sim/*.py",
    "sim/heli_lab/*.py",
    "sim/heli_benchmark/*.py",
    "tests/*.py",
)
WITH_REMEDY = "fault_text("
"""Call of the function that writes a fault with its remedy."""
GENERATED = ("host/heli_host/declaration.py",)
FIELD = re.compile(r"^\w[\w ]*\n-{3,}\n", re.MULTILINE)
END = re.compile(
    r"(?<=[.!?])(?<!e\.g\.)(?<!i\.e\.)(?<!vs\.)(?<!cf\.)(?<!Eq\.)(?<!Fig\.)(?<!al\.)[\"')*_]*\s+(?=[\"'(*_`]*[A-Z0-9`])"
)


@dataclass(frozen=True)
class Text:
    """A paragraph, heading, cell, docstring part or message."""

    file: str  # Path from the repository's root
    line: int  # First line of the paragraph, counted from 1
    kind: str  # ``document``, ``docstring``, ``message``, ``help`` or ``test``
    # False for a heading, a cell of a table or a message: these have words, and no sentences to count
    is_prose: bool
    content: str  # Without markup; code is replaced by `CODE`
    has_remedy: bool = True  # False for the message of an error for the user that does not say what to do


def sources(root: Path) -> list[Path]:
    """Tracked files with text that people read."""
    listed = subprocess.run(
        [
            "git",
            "ls-files",
            "--cached",
            "--others",
            "--exclude-standard",
            "*.md",
            "docs/course/*.py",
            "firmware/link.toml",
            "Makefile",
            ".ci/*",
            *SOURCES,
        ],
        cwd=root,
        capture_output=True,
        text=True,
        check=True,
    ).stdout.splitlines()
    return [root / name for name in sorted(set(listed)) if name not in GENERATED and (root / name).is_file()]


def pages(root: Path) -> list[Path]:
    """Documents in docs/, without those that a build of the site writes."""
    return [path for path in sources(root) if path.suffix == ".md" and path.is_relative_to(root / "docs")]


def sentences_of(text: Text) -> list[str]:
    """Sentences of prose; none of a heading or a cell."""
    return [part for part in END.split(text.content) if part.strip()] if text.is_prose else []


def is_document(path: Path, root: Path) -> bool:
    """Whether texts of a file are a document's."""
    return path.suffix == ".md" or path.is_relative_to(root / "docs" / "course")


def texts_of(path: Path, root: Path) -> Iterator[Text]:
    """Yield what a person reads of a file, in its order."""
    name = path.relative_to(root).as_posix()
    source = path.read_text()
    if path.suffix == ".md":
        yield from _markdown(source, name, 1)
    elif path.name == "link.toml":
        yield from _meanings(source, name)
    elif name.startswith("docs/course/"):
        yield from _notebook(source, name)
    elif path.suffix != ".py":
        yield from _script(source, name)
    elif name.startswith("tests/"):
        yield from _tests(source, name)
    else:
        yield from _python(source, name, user_errors(root))


def _text_of(statement: ast.stmt) -> str:
    """Text of a statement that is a string; empty for any other."""
    value = statement.value if isinstance(statement, ast.Expr) else None
    text = value.value if isinstance(value, ast.Constant) else None
    return inspect.cleandoc(text) if isinstance(text, str) else ""


def _statements(node: ast.AST) -> Iterator[ast.AST]:
    """Yield a node, and all statements in it: a tenth of the nodes that `ast.walk` visits."""
    yield node
    for field in ("body", "orelse", "finalbody", "handlers", "cases"):
        for child in getattr(node, field, ()):
            yield from _statements(child)


def _tests(source: str, name: str) -> Iterator[Text]:
    """Names of tests, all docstrings, and all comments that are sentences."""
    for node in _statements(ast.parse(source)):
        if not isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        line = 1 if isinstance(node, ast.Module) else node.lineno
        if not isinstance(node, ast.Module) and node.name.startswith("test_"):
            yield Text(name, line, "test", is_prose=False, content=node.name.replace("_", " "))
        yield from _docstring(ast.get_docstring(node) or "", name, line, "test")
        # A text below an assignment describes a constant or a field.
        for before, text in itertools.pairwise(node.body):
            if isinstance(before, ast.Assign | ast.AnnAssign):
                yield from _docstring(_text_of(text), name, text.lineno, "test")
    comment: list[str] = []
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            comment.append(token.string.lstrip("#: "))
        elif token.type not in (tokenize.NL, tokenize.NEWLINE) and comment:
            yield Text(name, token.start[0], "test", is_prose=True, content=_without_code(" ".join(comment)))
            comment = []


def _script(source: str, name: str) -> Iterator[Text]:
    """Comments of a shell script, and the help of a Makefile's targets."""
    comment: list[str] = []
    for number, line in enumerate([*source.splitlines(), ""], start=1):
        if line.startswith("#") and not line.startswith("#!"):
            # A line that is indented after its # shows a command.
            if not line.startswith("#  "):
                comment.append(line.lstrip("# "))
            continue
        if comment:
            yield Text(name, number - 1, "help", is_prose=True, content=_without_code(" ".join(comment)))
            comment = []
        if target := re.match(r"\w+:.*?## (.*)", line):
            yield Text(name, number, "help", is_prose=True, content=target[1])


def _plain(inline: Token) -> str:
    """Text of a paragraph without its markup."""
    parts = []
    for child in inline.children or []:
        if child.type == "text":
            parts.append(child.content)
        elif child.type == "code_inline":
            parts.append(CODE)
        elif child.type in ("softbreak", "hardbreak"):
            parts.append(" ")
    return "".join(parts)


def _markdown(source: str, name: str, first_line: int) -> Iterator[Text]:
    front = re.match(r"---\n.*?\n---\n", source, re.DOTALL)
    if front:
        source = "\n" * front[0].count("\n") + source[front.end() :]
    tokens = MARKDOWN.parse(source)
    for before, token in itertools.pairwise(tokens):
        if token.type != "inline" or token.map is None:
            continue
        yield Text(
            name,
            first_line + token.map[0],
            "document",
            is_prose=before.type == "paragraph_open",
            content=_plain(token),
        )


def _notebook(source: str, name: str) -> Iterator[Text]:
    """Cells of Markdown in a notebook of Jupytext's percent format."""
    for match in re.finditer(r"^# %% \[markdown\].*\n((?:#.*\n|\n)*)", source, re.MULTILINE):
        line = source[: match.start(1)].count("\n") + 1
        cell = re.sub(r"^# ?", "", match[1], flags=re.MULTILINE)
        yield from _markdown(cell, name, line)


def _meanings(source: str, name: str) -> Iterator[Text]:
    """Explanations in the declaration of the link, which become tables."""

    def walk(node: object) -> Iterator[str]:
        if isinstance(node, dict):
            for key, value in node.items():
                if isinstance(value, str) and key in ("meaning", "doc", "help", "what"):
                    yield value
                else:
                    yield from walk(value)
        elif isinstance(node, list):
            for value in node:
                yield from walk(value)

    for meaning in walk(tomllib.loads(source)):
        at = source.find(meaning[:40])
        yield Text(name, source[: max(at, 0)].count("\n") + 1, "message", is_prose=False, content=meaning)


def _is_public(name: str) -> bool:
    return not name.startswith("_")


@cache
def user_errors(root: Path) -> frozenset[str]:
    """Names of the errors whose arguments are what is wrong and what to do: the tree below `HeliError`."""
    # A class that writes its message itself, and takes no remedy, is left out with all below it.
    bases: dict[str, list[str]] = {}
    fixed = set()
    for pattern in ("host/heli_host/**/*.py", "sim/heli_*/**/*.py"):
        for path in root.glob(pattern):
            source = path.read_text()
            for node in ast.walk(ast.parse(source)) if re.search(r"^class \w+\(", source, re.M) else ():
                if isinstance(node, ast.ClassDef):
                    bases[node.name] = [ast.unparse(base).rpartition(".")[2] for base in node.bases]
                    if _takes_no_remedy(node):
                        fixed.add(node.name)
    tree = {"HeliError"}
    while more := {name for name, of in bases.items() if tree & set(of)} - tree - fixed:
        tree |= more
    return frozenset(tree)


def _takes_no_remedy(kind: ast.ClassDef) -> bool:
    starts = [node for node in kind.body if isinstance(node, ast.FunctionDef) and node.name == "__init__"]
    return any("remedy" not in {arg.arg for arg in start.args.args} for start in starts)


def _error_text(call: ast.Call, errors: frozenset[str], name: str) -> Iterator[Text]:
    """Message of an error for the user, and whether it says what to do."""
    kind = ast.unparse(call.func).rpartition(".")[2]
    if kind not in errors | {"BadParameter"}:
        return
    strings = list(_strings(call))
    if kind == "BadParameter" and not strings:
        return
    cause, *others = [*call.args, *(keyword.value for keyword in call.keywords)] or [ast.Constant("")]
    if isinstance(cause, ast.Starred) or (others and kind != "BadParameter"):
        has_remedy = not (others and isinstance(others[0], ast.Constant) and not others[0].value)
    else:
        has_remedy = any(";" in text for text in strings) or WITH_REMEDY in ast.unparse(cause)
    for text in strings or [CODE]:
        yield Text(name, call.lineno, "message", is_prose=False, content=text, has_remedy=has_remedy)
        has_remedy = True


def _python(source: str, name: str, errors: frozenset[str]) -> Iterator[Text]:
    tree = ast.parse(source)
    is_verb = "/verbs/" in name
    documented = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef):
            for line, constant_doc in _attribute_docstrings(node):
                yield from _docstring(constant_doc, name, line, "docstring")
        if isinstance(node, documented):
            public = isinstance(node, ast.Module) or _is_public(node.name)
            doc = ast.get_docstring(node) if public else None
            if doc:
                line = 1 if isinstance(node, ast.Module) else node.lineno
                yield from _docstring(doc, name, line, "help" if is_verb else "docstring")
        elif isinstance(node, ast.Call) and (texts := list(_error_text(node, errors, name))):
            yield from texts
        elif isinstance(node, ast.Raise) and isinstance(node.exc, ast.Call):
            if list(_error_text(node.exc, errors, name)):
                continue
            for text in _strings(node.exc):
                yield Text(name, node.lineno, "message", is_prose=False, content=text)
        elif isinstance(node, ast.keyword) and node.arg == "help":
            for text in _strings(node.value):
                yield Text(name, node.value.lineno, "help", is_prose=False, content=text)


def _attribute_docstrings(node: ast.Module | ast.ClassDef) -> Iterator[tuple[int, str]]:
    """Strings below the public constants of a module, such as thresholds, and attributes of a class."""
    for named, docstring in itertools.pairwise(node.body):
        target = named.targets[0] if isinstance(named, ast.Assign) else getattr(named, "target", None)
        if not (isinstance(target, ast.Name) and _is_public(target.id)):
            continue
        if isinstance(docstring, ast.Expr) and isinstance(docstring.value, ast.Constant):
            yield docstring.lineno, inspect.cleandoc(str(docstring.value.value))


def _docstring(doc: str, name: str, line: int, kind: str) -> Iterator[Text]:
    headers = list(FIELD.finditer(doc))
    prose = doc[: headers[0].start()] if headers else doc
    entries = doc[headers[0].start() :] if headers else ""
    for paragraph in re.split(r"\n\s*\n", prose):
        if (
            paragraph.strip()
            and not re.match(r"\s*(?:>>>|\.\. |    |\||- )", paragraph)
            and "::" not in paragraph
        ):
            yield Text(name, line, kind, is_prose=True, content=_without_code(paragraph))
    # Entries of arguments: their texts are indented, their heads are names and types.
    for text in re.findall(r"(?:^[ ]{4,}\S.*\n?)+", entries, re.MULTILINE):
        if ">>>" not in text:
            yield Text(name, line, kind, is_prose=True, content=_without_code(text))


def _without_code(text: str) -> str:
    text = re.sub(r"``.+?``|`[^`]+`(?:_)?", CODE, text, flags=re.DOTALL)
    return re.sub(r"\s+", " ", text).strip()


def _strings(node: ast.AST) -> Iterator[str]:
    """Text of a message: its constants, with a placeholder for what is filled in."""
    if isinstance(node, ast.JoinedStr):
        yield _without_code(
            "".join(str(part.value) if isinstance(part, ast.Constant) else CODE for part in node.values)
        )
    elif isinstance(node, ast.Constant):
        if isinstance(node.value, str) and " " in node.value:
            yield _without_code(node.value)
    else:
        for child in ast.iter_child_nodes(node):
            yield from _strings(child)
