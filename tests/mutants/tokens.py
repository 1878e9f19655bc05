"""C++ source text as tokens with places; comments, strings and preprocessor lines are none."""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

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
    """A token.

    Parameters
    ----------
    kind : str
        ``name``, ``number``, ``string`` or ``punctuation``.
    text : str
        As it is written.
    start, end : int
        Offsets in the text.
    spaced : bool
        Whether there is white space on both sides. In formatted sources that distinguishes a relation from
        the brackets of a template, and a product from a pointer.
    """

    kind: str
    text: str
    start: int
    end: int
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
        yield Token(kind, token[0], at, end, len(around) == 2 and around.isspace())
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
