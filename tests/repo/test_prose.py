"""The check of words and sentences sees what it is there for, and accepts good sentences."""

from pathlib import Path

import pytest

from tests.repo.prose.__main__ import GLOSSARY, HERE, check, findings
from tests.repo.prose.rules import Rules, abbreviations

RULES = Rules.read(HERE / "words.toml", GLOSSARY)
BAD = {
    "word": "The program tells the user what happened.",
    "sentence": " ".join(["The board reads the encoder and"] * 7) + " stops.",
    "paragraph": " ".join(["The board reads the encoder."] * 20),
    "opening": "Of these flights the program keeps two.",
    "numbers": "The errors are 3 degrees, 4 degrees and 5 degrees.",
    "abbreviation": "An LQR holds the arm.",
}
GOOD = {
    "code": "Run `tell 1 2 3 4` in a folder.",
    "uncertain": "The lag is 0.080 s ± 0.006 s, and the delay is 0.017 s.",
    "expanded": "An LQR (linear-quadratic regulator) holds the arm.",
    "names": "The BTS7960 driver works with Python 3.11 on a 3-DOF rig.",
    "question": "What happens when the cable is pulled?",
    "fence": "```console\n$ heli-host tell 1 2 3 4\n```",
    "cell": "| a | b |\n|---|---|\n| 1, 2, 3 and 4 counts | x |",
}


def rules_broken(tmp_path: Path, name: str, content: str) -> list[str]:
    page = tmp_path / name
    page.parent.mkdir(parents=True, exist_ok=True)
    page.write_text(content)
    return [finding.rule for finding in findings([page], RULES, tmp_path)]


@pytest.mark.parametrize("rule", BAD)
def test_a_bad_sentence_breaks_its_rule_and_no_other(rule: str, tmp_path: Path) -> None:
    assert rules_broken(tmp_path, "docs/page.md", BAD[rule] + "\n") == [rule]


@pytest.mark.parametrize("what", GOOD)
def test_a_good_sentence_breaks_no_rule(what: str, tmp_path: Path) -> None:
    assert not rules_broken(tmp_path, "docs/page.md", GOOD[what] + "\n")


@pytest.mark.parametrize(
    "source",
    [
        '"""The program tells it."""\n',
        'def fly() -> None:\n    """Fly.\n\n    The program tells it.\n    """\n',
        'def fly(x):\n    raise ValueError(f"the file {x} tells nothing")\n',
        'X = option(help="Tell it.")\n',
        'LIMIT_s = 1.0\n"""The program tells it [s]."""\n',
    ],
    ids=["module", "function", "message", "help", "threshold"],
)
def test_text_inside_of_python_is_read(source: str, tmp_path: Path) -> None:
    assert rules_broken(tmp_path, "host/heli_host/module.py", source) == ["word"]


@pytest.mark.parametrize("line", ["# It tells.\nfly:\n", "fly: ## tell where it flies\n\t@tell\n"])
def test_help_and_comments_of_a_script_are_read(line: str, tmp_path: Path) -> None:
    assert rules_broken(tmp_path, "Makefile", line) == ["word"]


def test_an_exception_covers_its_count_and_must_shrink_with_it(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("It tells. It tells.\n")
    seen = list(findings([page], RULES, tmp_path))
    assert [check(seen, {("page.md", "word"): count}) for count in (1, 2, 3)] == [False, True, False]


ERRORS = """
class HeliError(Exception):
    def __init__(self, cause, remedy=""): ...


class PlanError(HeliError): ...


class Refused(HeliError):
    def __init__(self, command): ...
"""


@pytest.mark.parametrize(
    ("raised", "rules"),
    [
        ('raise PlanError("no plan is given")', ["remedy"]),
        ('raise PlanError("no plan is given", "")', ["remedy"]),
        ("raise PlanError(reason)", ["remedy"]),
        ('raise typer.BadParameter("--speed is 0")', ["remedy"]),
        ('x = PlanError("no plan is given")', ["remedy"]),
        ('raise PlanError("no plan is given", "give at least one")', []),
        ('raise PlanError("no plan is given", remedy=hint)', []),
        ("raise PlanError(*problem(rate_Hz))", []),
        ('raise PlanError(f"stopped: {fault_text(code)}")', []),
        ('raise typer.BadParameter("--speed is 0; give a number above 0")', []),
        ("raise Refused(command)", []),
        ('raise ValueError("negative width")', []),
    ],
)
def test_an_error_for_the_user_says_what_to_do(raised: str, rules: list[str], tmp_path: Path) -> None:
    (tmp_path / "host/heli_host").mkdir(parents=True)
    (tmp_path / "host/heli_host/errors.py").write_text(ERRORS)
    assert rules_broken(tmp_path, "host/heli_host/module.py", raised + "\n") == rules


def test_abbreviations_are_those_of_the_glossary() -> None:
    row = "| AIC, BIC | A criterion, B criterion |\n"
    table = f"# Words\n\n## Abbreviations\n\n| abbreviation | means |\n|---|---|\n{row}"
    assert abbreviations(table + "\n## Flying\n\n| SIL | no |\n") == {
        "AIC": "A criterion",
        "BIC": "B criterion",
    }
    assert len(RULES.abbreviations) > 20
