"""The site: its contents reach every page, it builds without a warning, and its search answers questions."""

import os.path
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.repo.prose.texts import pages
from tests.repo.site_search import answers
from tests.running.long import LONG

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
FOLDERS = {"tutorials", "how-to", "reference", "explanation", "validation"}
# For readers of the repository: what a folder is for.
NOT_PAGES = {"figures/README.md", "laws/README.md", "matlab/README.md"}
TOCTREE = re.compile(r"^```\{toctree\}\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def children(page: Path) -> list[Path]:
    """Pages that the trees of contents of a page name."""
    lines = [line for body in TOCTREE.findall(page.read_text()) for line in body.splitlines()]
    # A title may stand before the page: Install <how-to/platforms>. A build writes pages that match a star.
    named = [line for line in lines if line and not line.startswith(":") and "*" not in line]
    names = [re.sub(r".*<(.*)>$", r"\1", line) for line in named]
    return [Path(os.path.normpath(page.parent / f"{name}.md")) for name in names]


def reached(page: Path) -> set[Path]:
    below = children(page)
    return {page, *below}.union(*map(reached, below))


def test_the_tree_of_contents_reaches_every_page() -> None:
    named = {path for path in pages(ROOT) if str(path.relative_to(DOCS)) not in NOT_PAGES}
    assert reached(DOCS / "index.md") == named


def test_every_page_is_in_one_of_the_five_folders() -> None:
    names = {str(path.relative_to(DOCS)) for path in pages(ROOT)} - NOT_PAGES
    outside = {page for page in names if page.partition("/")[0] not in FOLDERS}
    assert outside == {"index.md", "course/README.md"}


def linked(page: Path) -> set[Path]:
    """Pages that a page links to, in its text or in its tree of contents."""
    links = re.findall(r"\]\(([^)#\s]+\.md)", page.read_text())
    return {Path(os.path.normpath(page.parent / link)) for link in links}.union(children(page))


def test_every_page_is_within_two_links_of_the_readme() -> None:
    near = linked(ROOT / "README.md")
    near = near.union(*(linked(page) for page in near if page.is_relative_to(DOCS)))
    assert {path for path in pages(ROOT) if str(path.relative_to(DOCS)) not in NOT_PAGES} <= near


@pytest.mark.parametrize("name", ["overview", "rig"])
def test_a_drawing_is_that_of_its_program(tmp_path: Path, name: str) -> None:
    drawn = tmp_path / f"{name}.svg"
    program = DOCS / "figures" / f"{name}.py"
    subprocess.run([sys.executable, str(program), str(drawn)], check=True)
    assert drawn.read_text() == program.with_suffix(".svg").read_text()


@pytest.mark.documents
def test_the_site_builds_without_a_warning_and_its_search_finds_answers(tmp_path: Path) -> None:
    # The reference of the Python API is most of the work.
    less = [] if LONG else ["--tag", "without_api"]
    site, flies = tmp_path / "site", tmp_path / "heli-lab.html"
    flies.write_text("<title>heli-lab</title>")
    options = ["--quiet", "--fail-on-warning", "--keep-going", *less, f"-Dhtml_extra_path={flies}"]
    command = [sys.executable, "-m", "sphinx", *options, "--builder", "html", str(DOCS), str(site)]
    built = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert built.returncode == 0, built.stderr
    assert 'href="heli-lab.html">' in (site / "index.html").read_text()
    assert (site / "heli-lab.html").read_text() == flies.read_text()
    missed = [answer for answer in answers(site) if not answer.is_found]
    assert not missed, "the search does not find the answers"
    assert "<math" in (site / "reference/effects.html").read_text()
    assert 'class="gp">$ ' in (site / "how-to/flying.html").read_text()
    assert 'href="verbs/diagnose.html"' in (site / "reference/command-line.html").read_text()
    assert "--validate" in (site / "reference/verbs/diagnose.html").read_text()


@pytest.mark.documents
def test_a_broken_link_fails_the_site(tmp_path: Path) -> None:
    docs = tmp_path / "docs"
    (docs / "_extensions").mkdir(parents=True)
    for path in (DOCS / "conf.py", *(DOCS / "_extensions").glob("*.py")):
        (docs / path.relative_to(DOCS)).write_text(path.read_text())
    (docs / "_static").mkdir()
    (tmp_path / "pyproject.toml").write_text((ROOT / "pyproject.toml").read_text())
    (docs / "index.md").write_text("# Site\n\n[gone](gone.md)\n")
    options = ["--quiet", "--fail-on-warning", "--keep-going", "--builder", "html"]
    command = [sys.executable, "-m", "sphinx", *options, str(docs), str(tmp_path / "site")]
    built = subprocess.run(command, capture_output=True, text=True, check=False)
    assert built.returncode != 0
    assert "gone" in built.stderr
