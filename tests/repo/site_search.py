"""Questions of newcomers, and whether the site's own search finds the page that answers each.

    python -m tests.repo.site_search [FOLDER]      FOLDER: a built site, build/docs if none is given

A question is typed in its key words. It counts as found if one of the first three pages answers it. The
index and the order of results are those of Sphinx's searchtools.js: a page holds every word that the index
knows; titles count more than text; a heading that contains the whole query counts most.
"""

import json
import re
import sys
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sphinx.search.en import SearchEnglish

FIRST = 3
"""Results that a reader looks at."""
TITLE, PARTIAL_TITLE, TERM, PARTIAL_TERM = 15, 7, 5, 2
QUESTIONS = (
    ("machine look cost build", ("how-to/questions", "how-to/wiring", "explanation/architecture")),
    ("flown on real hardware", ("how-to/questions", "index", "how-to/wiring")),
    ("no hardware five minutes", ("how-to/questions", "tutorials/quick-start")),
    ("install without compiling the tests", ("how-to/questions", "tutorials/quick-start")),
    (
        "encoder 2000 counts per turn wrong way",
        ("how-to/questions", "how-to/troubleshooting", "how-to/extending"),
    ),
    ("supply 9 V motor turns backwards", ("how-to/questions", "how-to/troubleshooting")),
    ("elevation_motionless", ("how-to/troubleshooting", "reference/faults")),
    ("pull USB cable in flight laptop sleeps", ("how-to/questions", "how-to/troubleshooting")),
    ("see a flight live and stop it", ("how-to/questions", "how-to/dashboard")),
    (
        "log into pandas MATLAB spreadsheet",
        ("how-to/questions", "reference/file-formats", "tutorials/quick-start"),
    ),
    ("fly my own controller from Python on the board", ("how-to/questions", "how-to/controllers")),
    ("find the parameters of my rig how sure", ("how-to/questions", "how-to/identifying")),
    (
        "simulation does not match my flight",
        ("how-to/questions", "how-to/diagnosing", "how-to/troubleshooting"),
    ),
    ("verdict unexplained tool broken", ("how-to/questions", "how-to/diagnosing")),
    ("what does confidence 0.68 mean", ("how-to/questions", "reference/glossary")),
    (".mat file from Simulink with other signs and degrees", ("how-to/questions", "how-to/importing")),
    ("teach twenty students", ("how-to/questions", "tutorials/teaching")),
    ("add an effect, a verb, a telemetry channel, a controller", ("how-to/questions", "how-to/extending")),
    ("thousand simulations on our cluster", ("how-to/questions", "how-to/campaigns")),
    ("cite licence", ("how-to/questions", "index")),
    ("license", ("how-to/questions", "index")),
    ("cite", ("how-to/questions", "index")),
    ("photo", ("how-to/questions",)),
    ("windows", ("how-to/platforms",)),
)


@dataclass(frozen=True)
class Answer:
    """The first pages that a query finds, and whether one of them answers the question."""

    query: str
    pages: tuple[str, ...]
    is_found: bool


class Index:
    """The search index of a built site."""

    def __init__(self, site: Path) -> None:
        text = (site / "searchindex.js").read_text()
        self._index: dict[str, Any] = json.loads(text[text.index("(") + 1 : text.rindex(")")])
        self._english = SearchEnglish({})

    def pages(self, query: str) -> list[str]:
        """Names of the pages that a query finds, the best first."""
        scores: dict[int, float] = {}
        words = self._words(query)
        scores_of_words = [self._by_page(word) for word in words]
        for page in set[int]().union(*scores_of_words):
            scores_of_page = [
                scores_of_word[page] for scores_of_word in scores_of_words if page in scores_of_word
            ]
            # As Sphinx does: a page has all words, or all that are longer than two letters.
            if len(scores_of_page) in (len(words), sum(len(word) > 2 for word in words)):
                scores[page] = max(scores_of_page)
        lower = query.lower().strip()
        for title, places in self._index["alltitles"].items():
            if lower in title.lower() and len(lower) >= len(title) / 2:
                for page, _ in places:
                    scores[page] = max(scores.get(page, 0.0), round(TITLE * len(lower) / len(title)))
        titles: Sequence[str] = self._index["titles"]
        ordered = sorted(scores, key=lambda page: (-scores[page], titles[page].lower()))
        return [self._index["docnames"][page] for page in ordered]

    def _words(self, query: str) -> list[str]:
        words = [word.lower() for word in re.split(r"[^\w]+", query) if word]
        kept = [word for word in words if word not in self._english.stopwords and not word.isdigit()]
        return list(dict.fromkeys(self._english.stem(word) for word in kept))

    def _by_page(self, word: str) -> dict[int, int]:
        """Score of a word on each page that holds it."""
        scores: dict[int, int] = defaultdict(int)
        for table, whole, part in (("terms", TERM, PARTIAL_TERM), ("titleterms", TITLE, PARTIAL_TITLE)):
            entries: Mapping[str, int | list[int]] = self._index[table]
            if word in entries:
                matches = [(entries[word], whole)]
            else:
                matches = [(at, part) for term, at in entries.items() if len(word) > 2 and word in term]
            for at, score in matches:
                for page in [at] if isinstance(at, int) else at:
                    scores[page] = max(scores[page], score)
        return scores


def answers(site: Path) -> list[Answer]:
    """Search a built site for each of the questions."""
    index = Index(site)
    results = []
    for query, answering in QUESTIONS:
        pages = tuple(index.pages(query)[:FIRST])
        results.append(Answer(query, pages, bool(set(pages) & set(answering))))
    return results


def main(arguments: Sequence[str]) -> int:
    results = answers(Path(arguments[0] if arguments else "build/docs"))
    for answer in results:
        mark = "found  " if answer.is_found else "MISSED "
        print(f"{mark} {answer.query}: {', '.join(answer.pages) or 'nothing'}")
    print(f"{sum(answer.is_found for answer in results)} of {len(results)} found")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
