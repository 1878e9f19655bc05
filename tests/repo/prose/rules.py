"""The rules: words, openings, length of sentences and paragraphs, numbers, abbreviations."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from tests.repo.prose.texts import CODE, Text, sentences_of

NUMBER = re.compile(r"(?<![\w.,/^-])[-+−]?\d[\d,]*(?:\.\d+)?(?![\w-]|\.\d)")
UNCERTAIN = re.compile(r"(\d)(?:\s\w+)? ± \d[\d.,]*")
OPENING = re.compile(
    r"(?:Of (?!course)"
    r"|Not (?!only|yet|all|every|available)\w+ .*\b(?:are|is)\b"
    r"|What (?!is|are|does|do|happens)\w+ [^?]*$)"
)


@dataclass(frozen=True)
class Finding:
    """A place that readers stumble over."""

    file: str
    line: int
    rule: str
    message: str

    def __str__(self) -> str:
        return f"{self.file}:{self.line}: {self.rule}: {self.message}"


def words_in(sentence: str) -> int:
    """Words of a sentence: what has a letter or a digit; code counts as one."""
    return sum(bool(re.search(r"\w", word)) for word in sentence.split())


def is_long(sentence: str, words: int) -> bool:
    """Whether a sentence has more than so many words."""
    return words_in(sentence) > words


def numbers_in(sentence: str) -> int:
    """Numbers of a sentence; one with its uncertainty is one."""
    return len(NUMBER.findall(UNCERTAIN.sub(r"\1", sentence.replace(CODE, ""))))


def _shortened(text: str) -> str:
    return text if len(text) < 70 else text[:66] + " ..."


@dataclass(frozen=True)
class Rules:
    """What is looked for; `read` takes it from words.toml and the glossary."""

    words: tuple[tuple[re.Pattern[str], str, frozenset[str]], ...]
    abbreviations: dict[str, str]
    sentence_words: int
    long_sentence_words: int
    long_sentence_share: float
    paragraph_words: int
    numbers: int

    @classmethod
    def read(cls, path: Path, glossary: Path) -> Rules:
        """Read the vocabulary and the limits, and the abbreviations of the glossary."""
        table = tomllib.loads(path.read_text())
        kinds = ["document", "docstring", "message", "help", "test"]
        words = tuple(
            (
                re.compile(rf"\b(?:{row['not']})\b", re.IGNORECASE),
                row["write"],
                frozenset(row.get("only", kinds)),
            )
            for row in table["words"]
        )
        return cls(words, abbreviations(glossary.read_text()), **table["limits"])

    def findings(self, text: Text) -> Iterator[Finding]:
        """Yield all findings of one paragraph, heading, cell or message."""
        yield from self._words(text)
        if not text.has_remedy:
            message = f"say what is wrong; and what to do: {_shortened(text.content)}"
            yield Finding(text.file, text.line, "remedy", message)
        sentences = sentences_of(text)
        for sentence in sentences:
            yield from self._sentence(text, sentence)
        length = sum(map(words_in, sentences))
        if text.kind == "document" and length > self.paragraph_words:
            yield Finding(text.file, text.line, "paragraph", f"{length} words; split it, or make it a list")

    def _words(self, text: Text) -> Iterator[Finding]:
        for pattern, write, kinds in self.words:
            if text.kind in kinds:
                for match in pattern.finditer(text.content):
                    yield Finding(text.file, text.line, "word", f"'{match[0]}'; write: {write}")

    def _sentence(self, text: Text, sentence: str) -> Iterator[Finding]:
        short = _shortened(sentence)
        if is_long(sentence, self.sentence_words):
            yield Finding(text.file, text.line, "sentence", f"{words_in(sentence)} words: {short}")
        if OPENING.match(sentence) and text.kind in ("document", "docstring", "test"):
            yield Finding(text.file, text.line, "opening", f"begin with subject and verb: {short}")
        if text.kind == "document" and numbers_in(sentence) > self.numbers:
            yield Finding(text.file, text.line, "numbers", f"{numbers_in(sentence)} numbers: {short}")


def abbreviations(glossary: str) -> dict[str, str]:
    """Return the meaning of each abbreviation in the glossary's table of them."""
    table = glossary.partition("\n## Abbreviations\n")[2].partition("\n## ")[0]
    meanings: dict[str, str] = {}
    for short_forms, long_forms in re.findall(r"^\| ([A-Z][\w, ]+) \| (.+) \|$", table, re.MULTILINE):
        meanings.update(zip(short_forms.split(", "), long_forms.split(", "), strict=True))
    return meanings


def unexplained(texts: list[Text], meanings: dict[str, str]) -> Iterator[Finding]:
    """Yield the abbreviations that a page uses before it has expanded them."""
    for short, meaning in meanings.items():
        for position, text in enumerate(texts):
            if re.search(rf"\b{short}s?\b", text.content):
                so_far = " ".join(earlier.content for earlier in texts[: position + 2]).lower()
                if meaning.lower() not in so_far:
                    yield Finding(text.file, text.line, "abbreviation", f"{short} is not expanded: {meaning}")
                break
