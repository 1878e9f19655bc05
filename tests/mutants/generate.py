"""Mutants of C++ sources, and a copy of the sources in which one file at a time has one.

Changes are found in the text and not in a syntax tree. The sources are formatted by clang-format, which this
relies on: a relation has spaces around it, the bracket of a template has none.
"""

import contextlib
import hashlib
import re
import shutil
from bisect import bisect_right
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Final, NamedTuple

_SKIPPED: Final = re.compile(
    r"""(?P<skip>
      //[^\n]* | /\*.*?\*/ | \s+
    | (?:(?<=\n)|\A)[ \t]*\#(?:[^\n\\]|\\.)*          # a preprocessor line, with its continuations
    )""",
    re.VERBOSE | re.DOTALL,
)
_TOKEN: Final = re.compile(
    r"""
      (?P<string>(?:u8|[uUL])?R"(?P<d>[^()\s\\]*)\(.*?\)(?P=d)"
        | (?:u8|[uUL])?"(?:[^"\\\n]|\\.)*" | '(?:[^'\\\n]|\\.)+')
    | (?P<number>(?:0[xX][0-9a-fA-F']+ | 0[bB][01']+ | (?:\d[\d']*)?\.?\d[\d']*\.?(?:[eE][+-]?\d+)?)[uUlLfF]*)
    | (?P<name>[A-Za-z_]\w*)
    | (?P<punctuation><<=|>>=|->\*|\.\.\.|::|->|\+\+|--|<<|>>|<=|>=|==|!=|&&|\|\||[-+*/%&|^]=|.)
    """,
    re.VERBOSE | re.DOTALL,
)
_OPENING: Final = {"(": ")", "[": "]", "{": "}"}


@dataclass(frozen=True)
class Token:
    """A token."""

    kind: str  # ``name``, ``number``, ``string`` or ``punctuation``
    text: str  # As it is written
    start: int  # Offsets in the text
    end: int  # Offsets in the text
    # Whether there is white space on both sides. In formatted sources that distinguishes a relation from
    # the brackets of a template, and a product from a pointer
    spaced: bool


def tokens_of(text: str) -> list[Token]:
    """All tokens of a file."""
    return list(_tokens(text))


def _tokens(text: str) -> Iterator[Token]:
    at = 0
    while at < len(text):
        skipped = _SKIPPED.match(text, at)
        if skipped is not None and skipped.end() > at:
            at = skipped.end()
            continue
        token = _TOKEN.match(text, at)
        assert token is not None and token.lastgroup is not None
        end = token.end()
        kind = next(k for k in ("string", "number", "name", "punctuation") if token[k] is not None)
        around = text[at - 1 : at] + text[end : end + 1]
        yield Token(kind, token[0], at, end, spaced=len(around) == 2 and around.isspace())
        at = end


def partners(tokens: list[Token]) -> dict[int, int]:
    """Index of the bracket that closes or opens what each bracket opens or closes."""
    partner: dict[int, int] = {}
    opened: list[int] = []
    for index, token in enumerate(tokens):
        if token.text in _OPENING and token.kind == "punctuation":
            opened.append(index)
        elif token.text in _OPENING.values() and token.kind == "punctuation" and opened:
            partner[index] = opened.pop()
            partner[partner[index]] = index
    return partner


class Lines:
    """Line and column of an offset."""

    def __init__(self, text: str) -> None:
        self._text = text
        self._starts = [0, *(match.end() for match in re.finditer("\n", text))]

    def at(self, offset: int) -> tuple[int, int]:
        """Line from 1 and column from 0."""
        line = bisect_right(self._starts, offset)
        return line, offset - self._starts[line - 1]

    def text(self, line: int) -> str:
        """A line without its end."""
        start = self._starts[line - 1]
        end = self._text.find("\n", start)
        return self._text[start : end if end >= 0 else None]


ROOT: Final = Path(__file__).resolve().parents[2]
FOLDERS: Final = ("firmware/core", "firmware/due")
GENERATED: Final = ("firmware/core/link/declaration.hpp",)
"""Written by firmware/generate.py from the declaration; a slip there is a slip of the generator."""

_BINARY: Final[dict[str, tuple[str, ...]]] = {
    "<": ("<=", ">="), "<=": ("<", ">"), ">": (">=", "<="), ">=": (">", "<"), "==": ("!=",), "!=": ("==",),
    "+": ("-",), "-": ("+",), "*": ("/",), "/": ("*",), "%": ("*",),
    "&&": ("||",), "||": ("&&",), "&": ("|",), "|": ("&",), "^": ("&",), "<<": (">>",), ">>": ("<<",),
    "+=": ("-=",), "-=": ("+=",), "*=": ("/=",), "|=": ("&=",), "&=": ("|=",), "^=": ("|=",),
    "<<=": (">>=",), ">>=": ("<<=",),
}  # fmt: skip
_RELATIONS: Final = {"<", "<=", ">", ">=", "==", "!="}
_LOGICAL: Final = {"&&", "||"}
_NUMBER: Final = re.compile(
    r"(?P<digits>0[xX][0-9a-fA-F]+|0[bB][01]+|[\d.]+(?:[eE][+-]?\d+)?)(?P<suffix>[uUlLfF]*)"
)
_FLOAT: Final = re.compile(r"\d*\.\d*|\d+[eE]")
_EXPRESSION: Final = re.compile(
    r"^(?:\+\+|--|\*|\()|^[\w:]+(?:\(|\[|\.|->|\+\+|--|\s*[-+*/%&|^]?=[^=]|\s*(?:<<|>>)=)"
)
_NO_EXPRESSION: Final = {
    "return", "if", "for", "while", "do", "switch", "case", "default", "else", "using", "const",
    "constexpr",
    "auto", "static", "static_assert", "typedef", "struct", "class", "enum", "template", "namespace",
    "public", "private",
    "extern", "asm", "__asm__", "inline", "volatile", "goto", "friend", "explicit", "virtual", "operator",
}  # fmt: skip
_JUMPS: Final = {"return;", "break;", "continue;"}
_ENDS_RIGHT: Final = {",", ";", "?", ":", ")", "]", "}", "||"}
_ENDS_TERM: Final = {",", ";", "?", ":", ")", "]", "}", "="}
_ENDS_LEFT: Final = {",", ";", "?", ":", "(", "[", "{", "=", "return", "||"}


@dataclass(frozen=True)
class Mutant:
    """One small change of a source."""

    file: str  # Relative to the repository
    line: int  # First and last line of the statement that it changes
    last_line: int  # First and last line of the statement that it changes
    source_line: str  # The line of the change without white space around it
    occurrence: int  # How many equal lines come before it in the file
    column: int  # Column of the change
    # ``relation``, ``arithmetic``, ``logic``, ``operand``, ``condition``, ``constant`` or ``statement``
    kind: str
    before: str  # The text that is replaced, and its replacement
    after: str  # The text that is replaced, and its replacement
    start: int  # Offset of the change in the file

    @cached_property
    def identity(self) -> str:
        """The same as long as line, place and change are the same, wherever in the file the line is."""
        parts = (
            self.file,
            self.source_line,
            self.occurrence,
            self.column,
            self.kind,
            self.before,
            self.after,
        )
        return hashlib.sha256("\0".join(map(str, parts)).encode()).hexdigest()[:12]

    def apply(self, text: str) -> str:
        """The file with the change."""
        end = self.start + len(self.before)
        assert text[self.start : end] == self.before, f"{self.file} has changed since its mutants were listed"
        return text[: self.start] + self.after + text[end:]

    def __str__(self) -> str:
        before, after = (" ".join(part.split()) or "nothing" for part in (self.before, self.after))
        return f"{self.file}:{self.line}: {before} -> {after}    in: {self.source_line}"


def sources(root: Path = ROOT, only: str = "") -> list[str]:
    """Files that are mutated, whose path contains the given text."""
    paths = (path for folder in FOLDERS for path in sorted((root / folder).rglob("*.[ch]pp")))
    names = (path.relative_to(root).as_posix() for path in paths)
    return [name for name in names if only in name and name not in GENERATED]


def mutants_of(file: str, text: str) -> list[Mutant]:
    """Every mutant of a file, in the order of its text."""
    return _Source(file, text).mutants()


def sample(mutants: list[Mutant], seed: str, count: int | None) -> list[Mutant]:
    """So many mutants, by a seed: at most one of each place, because a number has five and a call has one."""
    # An edit elsewhere in the sources hardly changes which.

    def rank(mutant: Mutant) -> str:
        return hashlib.sha256(f"{seed} {mutant.identity}".encode()).hexdigest()

    first: dict[tuple[str, int, str], Mutant] = {}
    for mutant in sorted(mutants, key=rank):
        first.setdefault((mutant.file, mutant.start, mutant.kind), mutant)
    # By a hash of the place, not of its first mutant: the first of five is early.
    places = sorted(
        first.values(),
        key=lambda m: hashlib.sha256(
            f"{seed} {m.file} {m.source_line} {m.column} {m.occurrence} {m.kind}".encode()
        ).hexdigest(),
    )
    return places[:count]


class _Change(NamedTuple):
    """A replacement of the text between two offsets."""

    start: int
    end: int
    kind: str
    after: str


class _Source:
    def __init__(self, file: str, text: str) -> None:
        self._file, self._text = file, text
        self._tokens = tokens_of(text)
        self._partner = partners(self._tokens)
        self._lines = Lines(text)
        self._skipped = self._skipped_tokens()
        self._bodies = self._function_bodies()
        self._begin, self._end = self._statement_bounds()

    def mutants(self) -> list[Mutant]:
        changes = sorted({change for index in range(len(self._tokens)) for change in self._changes(index)})
        seen: Counter[str] = Counter()
        occurrence: dict[int, int] = {}
        for line in range(1, self._text.count("\n") + 2):
            stripped = self._lines.text(line).strip()
            occurrence[line] = seen[stripped]
            seen[stripped] += 1
        return [self._mutant(change, occurrence) for change in changes]

    def _mutant(self, change: _Change, occurrence: dict[int, int]) -> Mutant:
        line, column = self._lines.at(change.start)
        index = next(i for i, token in enumerate(self._tokens) if token.end > change.start)
        line_text = self._lines.text(line)
        return Mutant(
            file=self._file,
            line=line,
            last_line=max(line, self._lines.at(self._tokens[self._end[index]].start)[0]),
            source_line=line_text.strip(),
            occurrence=occurrence[line],
            column=column - (len(line_text) - len(line_text.lstrip())),
            kind=change.kind,
            before=self._text[change.start : change.end],
            after=change.after,
            start=change.start,
        )

    def _changes(self, index: int) -> Iterator[_Change]:
        """Yield the changes at a token."""
        if index in self._skipped:
            return
        token = self._tokens[index]
        here = token.start, token.end
        if token.kind == "number" and not self._is_array_bound(index):
            yield from (_Change(*here, "constant", other) for other in _other_numbers(token.text))
        elif token.text in ("true", "false"):
            yield _Change(*here, "constant", "false" if token.text == "true" else "true")
        elif token.text in _BINARY and (token.spaced or self._ends_line(token)) and index > 0:
            kind = "arithmetic"
            if token.text in _RELATIONS:
                kind = "relation"
            elif token.text in _LOGICAL:
                kind = "logic"
            yield from (_Change(*here, kind, other) for other in _BINARY[token.text])
            if token.text in _LOGICAL:
                yield from self._dropped_operands(index)
            elif token.text in ("+", "-", "|"):
                yield from self._dropped_term(index)
        elif token.text in ("++", "--"):
            yield _Change(*here, "arithmetic", "--" if token.text == "++" else "++")
        elif token.text in ("!", "-", "~") and not token.spaced and self._is_unary(index):
            yield _Change(*here, "logic" if token.text == "!" else "arithmetic", "")
        elif token.text in ("if", "while") and index in self._bodies:
            yield from self._conditions(index)
        if index in self._bodies and self._begin[index] == index:
            yield from self._deleted(index)

    def _conditions(self, index: int) -> Iterator[_Change]:
        opening = index + 1
        if self._tokens[opening].text != "(":  # if constexpr
            return
        closing = self._partner[opening]
        if any(t.text == ";" for t in self._tokens[opening:closing]):
            return
        start, end = self._tokens[opening].end, self._tokens[closing].start
        condition = self._text[start:end]
        declares = re.match(r"(?:const\s+)?[\w:]+[*&]*\s[*&]*\w+\s=[^=]", condition) is not None
        if not declares:
            if not _is_comparison(self._tokens[opening + 1 : closing]):
                yield _Change(start, end, "condition", f"!({condition})")
            yield _Change(start, end, "condition", "false")
            if self._tokens[index].text == "if":
                yield _Change(start, end, "condition", "true")

    def _dropped_operands(self, index: int) -> Iterator[_Change]:
        """Without the operand on the right of `&&` or `||`, then without that on the left."""
        token = self._tokens[index]
        right = index + 1
        while self._tokens[right].text not in _ENDS_RIGHT | {token.text}:
            right = self._partner.get(right, right) + 1
        yield _Change(token.start, self._tokens[right - 1].end, "operand", "")
        left = index - 1
        while left >= 0 and self._tokens[left].text not in _ENDS_LEFT | {token.text}:
            left = min(self._partner.get(left, left), left) - 1
        yield _Change(self._tokens[left + 1].start, self._tokens[index + 1].start, "operand", "")

    def _dropped_term(self, index: int) -> Iterator[_Change]:
        """Without the term on the right of a sum."""
        right = index + 1
        while not (
            self._tokens[right].text in _ENDS_TERM
            or (
                self._tokens[right].text in _BINARY
                and self._tokens[right].spaced
                and self._tokens[right].text not in ("*", "/", "%")
            )
        ):
            right = self._partner.get(right, right) + 1
        yield _Change(self._tokens[index].start, self._tokens[right - 1].end, "operand", "")

    def _deleted(self, index: int) -> Iterator[_Change]:
        start, end = self._tokens[index].start, self._tokens[self._end[index]].end
        statement = self._text[start:end]
        if not statement.endswith(";"):
            return
        if statement in _JUMPS or (
            self._tokens[index].text not in _NO_EXPRESSION and _EXPRESSION.match(statement)
        ):
            yield _Change(start, end, "statement", ";")

    def _is_unary(self, index: int) -> bool:
        before = self._tokens[index - 1]
        return (before.kind == "punctuation" and before.text not in (")", "]")) or before.text == "return"

    def _ends_line(self, token: Token) -> bool:
        """An operator at the end of a line has a space before it; the token knows only both sides."""
        return self._text[token.start - 1].isspace() and self._text[token.end : token.end + 1] in ("\n", " ")

    def _is_array_bound(self, index: int) -> bool:
        """Whether a number is the whole bound of an array that is declared: room to spare changes nothing."""
        if self._tokens[index - 1].text != "[" or self._tokens[index + 1].text != "]":
            return False
        return (
            self._tokens[index - 2].kind == "name"
            and self._tokens[index - 3].kind == "name"
            and self._tokens[index + 2].text in ("=", ";", "{")
        )

    def _skipped_tokens(self) -> set[int]:
        """Indices of tokens without mutants: static assertions, attributes, names and alignments."""
        skipped: set[int] = set()
        for index, token in enumerate(self._tokens):
            if token.text in ("static_assert", "alignas", "asm", "__asm__", "__attribute__"):
                opening = index + 1
                while self._tokens[opening].text != "(":
                    opening += 1
                skipped |= set(range(index, self._partner[opening] + 1))
            elif token.text == "[" and self._tokens[index + 1].text == "[":
                skipped |= set(range(index, self._partner[index] + 1))
            elif (
                token.text == "="
                and [t.text for t in self._tokens[index + 1 : index + 3]] == ["0", ";"]
                and self._tokens[index - 1].text in (")", "const", "override", "noexcept")
            ):
                # A function without a body; a number has a name and a type before it, not a bracket.
                skipped.add(index + 1)
        return skipped

    def _function_bodies(self) -> set[int]:
        """Indices of tokens that are within the body of a function."""
        inside: set[int] = set()
        depth: list[bool] = [False]
        for index, token in enumerate(self._tokens):
            if token.text == "{" and token.kind == "punctuation":
                depth.append(depth[-1] or self._opens_body(index))
            elif token.text == "}" and token.kind == "punctuation" and len(depth) > 1:
                depth.pop()
            elif depth[-1]:
                inside.add(index)
        return inside

    def _opens_body(self, index: int) -> bool:
        before = index - 1
        while before >= 0 and self._tokens[before].text not in (";", "}", "{"):
            if self._tokens[before].text in ("namespace", "class", "struct", "enum", "union", "="):
                return False
            before -= 1
        return any(token.text == ")" for token in self._tokens[before + 1 : index])

    def _statement_bounds(self) -> tuple[list[int], list[int]]:
        """First and last token of the statement around each token; what a header of a loop holds is one."""
        count = len(self._tokens)
        begin, end = [0] * count, [count - 1] * count
        first, depth = 0, 0
        for index, token in enumerate(self._tokens):
            begin[index] = first
            depth += {"(": 1, "[": 1, ")": -1, "]": -1}.get(token.text, 0)
            is_label = token.text == ":" and self._tokens[first].text in (
                "case",
                "default",
                "public",
                "private",
            )
            ends_statement = token.text in (";", "{", "}") or is_label
            is_header = token.text == ")" and self._heads(index) and depth == 0
            if (depth == 0 and (ends_statement or is_header or token.text == "else")) or token.text in (
                "{",
                "}",
            ):
                for k in range(first, index + 1):
                    end[k] = index
                first = index + 1
        return begin, end

    def _heads(self, closing: int) -> bool:
        opening = self._partner.get(closing)
        return (
            opening is not None
            and opening > 0
            and self._tokens[opening - 1].text in ("if", "for", "while", "switch")
        )


def _is_comparison(condition: list[Token]) -> bool:
    """Whether a condition is one relation, whose negation is a mutant of its own already."""
    depth, operators = 0, []
    for token in condition:
        depth += {"(": 1, "[": 1, ")": -1, "]": -1}.get(token.text, 0)
        if depth == 0 and token.text in _RELATIONS | _LOGICAL and token.spaced:
            operators.append(token.text)
    return len(operators) == 1 and operators[0] in _RELATIONS


def _other_numbers(text: str) -> list[str]:
    """Zero, one more, twice, half and ten times a number, as far as these differ from it and each other."""
    match = _NUMBER.fullmatch(text.replace("'", ""))
    if match is None:
        return []
    digits, suffix = match["digits"], match["suffix"]
    if digits[:2].lower() not in ("0x", "0b") and (_FLOAT.match(digits) or suffix.lower() == "f"):
        value = float(digits)
        changed = [0.0, value + 1.0, 2.0 * value, 0.5 * value, 10.0 * value]
        others = [repr(number) + suffix for number in dict.fromkeys(changed) if number != value]
        return [other if "." in other or "e" in other else other + ".0" for other in others]
    is_octal = len(digits) > 1 and digits[0] == "0" and digits[1] not in "xXbB"
    integer = int(digits, 8 if is_octal else 0)
    text_of = hex if digits[:2].lower() == "0x" else str
    integers = dict.fromkeys([0, integer + 1, 2 * integer, (integer + 1) // 2, 10 * integer])
    # The suffix of an integer has no F.
    suffix = suffix.replace("f", "").replace("F", "")
    return [text_of(number) + suffix for number in integers if number != integer]


BUILD: Final = ROOT / "build" / "mutants"
_INCLUDE: Final = re.compile(r'^\s*#\s*include\s*["<]([^">]+)[">]', re.MULTILINE)


class BuildError(Exception):
    """The compiler or the linker refuses what it is given."""


class Tree:
    """A copy of ``firmware/core`` and ``firmware/due``."""

    def __init__(self, folder: Path, others: tuple[str, ...] = ()) -> None:
        self.folder = folder
        self._others = others
        shutil.rmtree(folder, ignore_errors=True)
        for part in ("core", "due"):
            shutil.copytree(ROOT / "firmware" / part, folder / "firmware" / part)

    @contextlib.contextmanager
    def holding(self, mutant: Mutant) -> Iterator[None]:
        """The tree with a mutant in it, until the end of the block."""
        path = self.folder / mutant.file
        text = path.read_text(encoding="utf-8")
        path.write_text(mutant.apply(text), encoding="utf-8")
        try:
            yield
        finally:
            path.write_text(text, encoding="utf-8")

    def path(self, source: str) -> Path:
        """Where a source is that is compiled: copied ones in the tree, others in the repository."""
        copied = self.folder / source
        return copied if copied.exists() else ROOT / source

    def dependents(self, file: str) -> list[str]:
        """Sources that have to be compiled again when a file changes."""
        return [
            source for source in self.includes if source.endswith(".cpp") and file in self._closure(source)
        ]

    @cached_property
    def includes(self) -> dict[str, set[str]]:
        """Which files of the repository each source includes itself."""
        folders = ("firmware/core", "firmware/due", *self._others)
        paths = [path for folder in folders for path in sorted((ROOT / folder).rglob("*.[ch]pp"))]
        names = {path.relative_to(ROOT).as_posix() for path in paths}
        includes: dict[str, set[str]] = {}
        for name in names:
            places = [Path(name).parent.as_posix(), *folders]
            included = _INCLUDE.findall((ROOT / name).read_text(encoding="utf-8"))
            includes[name] = {p for part in included for p in (f"{at}/{part}" for at in places) if p in names}
        return includes

    def _closure(self, source: str) -> set[str]:
        seen, waiting = {source}, [source]
        while waiting:
            new = self.includes[waiting.pop()] - seen
            seen |= new
            waiting += new
        return seen


def digest(*folders: str) -> str:
    """Digest of the sources, tests and tables of folders or files."""
    content = hashlib.sha256()
    for folder in folders:
        place = ROOT / folder
        paths = [place] if place.is_file() else sorted(path for path in place.rglob("*") if path.is_file())
        for path in paths:
            if path.suffix != ".pyc":
                content.update(path.relative_to(ROOT).as_posix().encode())
                content.update(path.read_bytes())
    return content.hexdigest()[:16]
