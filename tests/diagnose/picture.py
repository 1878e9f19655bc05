"""Draw the top of the page of a diagnosis for the documents: ``python -m tests.diagnose.picture FOLDER``.

FOLDER is that of ``heli-host diagnose --report``, with the flights of docs/how-to/diagnosing.md.
"""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from tests.page.browser import chromium

PICTURE: Final = Path(__file__).resolve().parents[2] / "docs" / "figures" / "diagnosis.png"
_SIZE: Final = (1000, 760)


def main(arguments: Sequence[str] | None = None) -> int:
    """Draw the picture in Chromium; `arguments` replace those of the command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.diagnose.picture", description=__doc__)
    parser.add_argument("folder", type=Path, help="folder of the report")
    parser.add_argument("--file", type=Path, default=PICTURE, help="picture to write")
    given = parser.parse_args(arguments)
    with chromium() as browser:
        page = browser.new_page(viewport={"width": _SIZE[0], "height": _SIZE[1]})
        page.goto((given.folder / "index.html").resolve().as_uri())
        page.screenshot(path=given.file)
    return 0


if __name__ == "__main__":
    sys.exit(main())
