"""Checks what people read for words and sentences that readers stumble over.

    python -m tests.repo.prose               all findings; exits with 1 if there is one
    python -m tests.repo.prose --count       findings per file and rule, and the share of long sentences
    python -m tests.repo.prose --words       words per page of docs/, in sentences and in tables and headings
    python -m tests.repo.prose FILE...       findings of these files, exceptions included

The rules are in words.toml, the exceptions with their reasons in exceptions.toml.
"""

import argparse
import re
import sys
import tomllib
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

from tests.repo.prose.rules import Finding, Rules, is_long, unexplained, words_in
from tests.repo.prose.texts import is_document, pages, sentences_of, sources, texts_of

DISPLAYED = re.compile(r"\$\$.*?\$\$", re.DOTALL)
FORMULA = re.compile(r"\$[^$]+\$")
HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[2]
GLOSSARY = ROOT / "docs/reference/glossary.md"
WRITTEN_BY_PROGRAMS = ("docs/reference/link.md", "docs/reference/faults.md", "docs/reference/parameters.md")
# READMEs of folders, which the site leaves out.
NOT_PAGES = ("docs/figures/README.md", "docs/laws/README.md", "docs/matlab/README.md")


def allowances() -> Counter[tuple[str, str]]:
    """Findings that are allowed for now, counted by file and rule."""
    table = tomllib.loads((HERE / "exceptions.toml").read_text()).get("allow", [])
    allowed: Counter[tuple[str, str]] = Counter()
    for row in table:
        if not row.get("reason"):
            raise SystemExit(f"error: the exception for {row['file']} gives no reason; add one")
        allowed[row["file"], row["rule"]] += row["count"]
    return allowed


def findings(files: Sequence[Path], rules: Rules, root: Path = ROOT) -> Iterator[Finding]:
    """Yield what the rules find in these files."""
    for file in files:
        texts = list(texts_of(file, root))
        for text in texts:
            yield from rules.findings(text)
        if file.suffix == ".md" and file.is_relative_to(root / "docs") and file != GLOSSARY:
            yield from unexplained(texts, rules.abbreviations)


def long_share(files: Sequence[Path], rules: Rules, root: Path = ROOT) -> tuple[int, int]:
    """Count the documents' sentences above the bound, and all of them."""
    long = total = 0
    for file in (file for file in files if is_document(file, root)):
        for text in texts_of(file, root):
            if text.kind == "document":
                for sentence in sentences_of(text):
                    total += 1
                    long += is_long(sentence, rules.long_sentence_words)
    return long, total


def page_words(page: Path, root: Path = ROOT) -> tuple[int, int]:
    """Count words in sentences, and in headings and tables."""
    # Code in backticks and a formula in a sentence are one word; code blocks and displayed formulas are none.
    in_sentences = elsewhere = 0
    for text in texts_of(page, root):
        words = words_in(FORMULA.sub("x", DISPLAYED.sub("", text.content)))
        if text.is_prose:
            in_sentences += words
        else:
            elsewhere += words
    return in_sentences, elsewhere


def report_words(root: Path = ROOT) -> None:
    """Print the words of each page that no program writes, and the sums outside and inside of reference/."""
    reference, others = "docs/reference/", "docs/, without reference/"
    totals = {others: [0, 0], reference: [0, 0]}
    print("sentences  tables  page")
    for page in pages(root):
        name = page.relative_to(root).as_posix()
        if name in WRITTEN_BY_PROGRAMS or name in NOT_PAGES:
            continue
        in_sentences, elsewhere = page_words(page, root)
        print(f"{in_sentences:9}  {elsewhere:6}  {name}")
        total = totals[reference if name.startswith(reference) else others]
        total[0] += in_sentences
        total[1] += elsewhere
    for what, (in_sentences, elsewhere) in totals.items():
        print(f"{in_sentences:9}  {elsewhere:6}  all of {what}")


def report_counts(all_findings: Sequence[Finding]) -> None:
    """Print a row per file: how many findings of each rule."""
    by_file: dict[str, Counter[str]] = {}
    for finding in all_findings:
        by_file.setdefault(finding.file, Counter())[finding.rule] += 1
    for file, counts in sorted(by_file.items(), key=lambda row: -sum(row[1].values())):
        print(f"{sum(counts.values()):5}  {file}: " + ", ".join(f"{rule} {n}" for rule, n in counts.items()))
    print(f"{len(all_findings)} findings in {len(by_file)} files")


def check(all_findings: Sequence[Finding], allowed: Mapping[tuple[str, str], int]) -> bool:
    """Print findings beyond the exceptions, and exceptions beyond the findings; true if there are none."""
    counted = Counter((finding.file, finding.rule) for finding in all_findings)
    for finding in all_findings:
        if counted[finding.file, finding.rule] > allowed.get((finding.file, finding.rule), 0):
            print(finding)
    stale = {key: n for key, n in allowed.items() if counted[key] < n}
    for (file, rule), count in stale.items():
        print(f"exceptions.toml: {file} has {counted[file, rule]} of {count} '{rule}'; lower the count")
    return not stale and all(counted[key] <= allowed.get(key, 0) for key in counted)


def main(arguments: Sequence[str]) -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("files", nargs="*", type=Path)
    parser.add_argument("--count", action="store_true")
    parser.add_argument("--words", action="store_true")
    chosen = parser.parse_args(arguments)
    if chosen.words:
        report_words()
        return 0
    rules = Rules.read(HERE / "words.toml", GLOSSARY)
    files = [file.resolve() for file in chosen.files] or sources(ROOT)
    all_findings = list(findings(files, rules))
    if chosen.count:
        report_counts(all_findings)
    elif chosen.files:
        for finding in all_findings:
            print(finding)
        return bool(all_findings)
    passed = chosen.count or check(all_findings, allowances())
    long, total = long_share(files, rules)
    if chosen.count or long > rules.long_sentence_share * total:
        share = 100 * long / max(total, 1)
        print(
            f"{long} of {total} sentences of the documents, {share:.1f} %, "
            f"have more than {rules.long_sentence_words} words"
        )
    return not (passed and long <= rules.long_sentence_share * total)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
