"""Print what pyproject.toml requires, one requirement a line: to build, to run, and for each extra named.

Installing these first, and the project itself without its dependencies and without an isolated build, makes a
second build after an edit of the C++ sources take seconds.
"""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path


def main() -> None:
    """Print them, one a line."""
    with Path("pyproject.toml").open("rb") as file:
        pyproject = tomllib.load(file)
    project = pyproject["project"]
    requirements = [*pyproject["build-system"]["requires"], *project["dependencies"]]
    for extra in sys.argv[1:]:
        requirements += project["optional-dependencies"][extra]
    # scikit-build-core adds these two to an isolated build where the system has none; ours is not isolated.
    requirements += ["cmake>=3.20", "ninja"]
    print("\n".join(requirements))


if __name__ == "__main__":
    main()
