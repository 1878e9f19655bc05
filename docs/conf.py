"""The site: `make docs` builds docs/ into build/docs. Neither the build nor the reader fetches anything."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from importlib.metadata import version as version_of
from pathlib import Path
from typing import Any, ClassVar

from docutils import nodes
from docutils.parsers.rst import Directive

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE / "_extensions"))

project = "heli-lab"
author = "the heli-lab authors"
copyright = author
release = version_of(tomllib.loads((HERE.parent / "pyproject.toml").read_text())["project"]["name"])
version = release

FLY_NOW = "Fly it now"


def repository_links() -> dict[str, Any]:
    """Options of the theme that link to the repository that the site was built from; none for a local one."""
    command = ["git", "-C", str(HERE), "remote", "get-url", "origin"]
    origin = subprocess.run(command, capture_output=True, text=True, check=False).stdout.strip()
    address = re.sub(r"^git@([^:]+):", r"https://\1/", origin).removesuffix(".git")
    if not address.startswith("https://"):
        return {}
    links: dict[str, Any] = {
        "footer_icons": [{"name": "Repository", "url": address, "html": "Repository", "class": ""}]
    }
    # The theme knows these hosts, and warns of others.
    if re.match(r"https://(github|gitlab|bitbucket)\.", address):
        links |= {"source_repository": address, "source_branch": "main", "source_directory": "docs/"}
    return links


has_api: bool = not tags.has("without_api")  # type: ignore[name-defined]  # noqa: F821 - Sphinx puts it here
extensions = ["myst_parser", "mathml", "verbs", *(["sphinx.ext.autodoc", "numpydoc"] if has_api else [])]
source_suffix = {".md": "markdown"}
root_doc = "index"
# READMEs of folders are for readers of the repository; the course's is a page.
exclude_patterns = ["_extensions", "_static", "figures/README.md", "laws/README.md", "matlab/README.md"]
suppress_warnings: list[str] = []

# Two hyphens are an option, not a dash.
smartquotes = False
myst_enable_extensions = ["dollarmath", "deflist", "colon_fence"]
myst_heading_anchors = 4
myst_links_external_new_tab = False

default_role = "py:obj"
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_typehints_format = "short"
autodoc_preserve_defaults = True
numpydoc_show_class_members = False
numpydoc_xref_param_type = False
add_module_names = False
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 90

html_theme = "furo"
html_title = f"heli-lab {release}"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_math_renderer = "mathml"
html_copy_source = False
html_show_sourcelink = False
html_show_sphinx = False
html_theme_options = {"navigation_with_keys": True, **repository_links()}
pygments_style = "a11y-high-contrast-light"
pygments_dark_style = "a11y-high-contrast-dark"
autosummary_generate = False


class NoReference(Directive):
    """Takes the place of `automodule`: `sphinx-build -t without_api` takes a quarter of the time."""

    required_arguments = 1
    option_spec: ClassVar = {"members": str, "imported-members": str, "exclude-members": str}
    has_content = True

    def run(self) -> list[nodes.Node]:
        """Leave the reference out."""
        return []


def link_page(app: Any, doctree: nodes.document, _: str) -> None:
    """Link from the first page to the page that flies, if the site holds it; otherwise to the guide."""
    for link in doctree.findall(nodes.reference):
        if app.config.html_extra_path and link.astext() == FLY_NOW:
            link["refuri"] = Path(app.config.html_extra_path[0]).name


def setup(app: Any) -> None:
    """Leave the API reference out where that was asked for."""
    app.connect("doctree-resolved", link_page)
    if not has_api:
        app.add_directive("automodule", NoReference)
