"""Write what link.toml and pins.toml declare: C++, Python, JavaScript and MATLAB tables, and pages of docs.

Run ``python firmware/generate.py`` after each change of link.toml or pins.toml. ``--check`` writes nothing
and fails if a generated file is stale. The program needs only the standard library, so that a firmware build
can run it before any package is installed.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from firmware.generator.cpp import generate_cpp
from firmware.generator.declared import DeclarationError, read
from firmware.generator.document import generate_doc, generate_faults, generate_parameters
from firmware.generator.javascript import generate_javascript
from firmware.generator.matlab import generate_matlab
from firmware.generator.python import generate_python
from firmware.generator.wiring import generate_header, read_pins, with_table

ROOT = Path(__file__).resolve().parents[1]
SOURCE = "firmware/link.toml"
PINS = "firmware/pins.toml"
HEADER = "firmware/due/wiring.hpp"
WIRING_PAGE = "docs/how-to/wiring.md"
WRITERS = {
    "firmware/core/link/declaration.hpp": generate_cpp,
    "host/heli_host/declaration.py": generate_python,
    "docs/reference/link.md": generate_doc,
    "docs/reference/faults.md": generate_faults,
    "docs/reference/parameters.md": generate_parameters,
    "docs/matlab/heli_declaration.m": generate_matlab,
    "sim/web/heli_web/page/declaration.js": generate_javascript,
}


def main() -> int:
    """Write or check the generated files.

    Returns the exit code: 0 if all is well, 1 for a stale file, 2 for an invalid declaration.
    """
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing; fail when a file is stale")
    parser.add_argument("--source", type=Path, metavar="FILE", help=f"the declaration, instead of {SOURCE}")
    parser.add_argument("--root", type=Path, metavar="DIR", default=ROOT, help="the tree to write into")
    arguments = parser.parse_args()
    root: Path = arguments.root
    source: Path = arguments.source or root / SOURCE
    try:
        declaration = read(source)
    except DeclarationError as error:
        print(f"{source.name}: {error}", file=sys.stderr)
        return 2
    texts = {name: write(declaration) for name, write in WRITERS.items()}
    if (root / PINS).exists():
        try:
            wiring = read_pins(root / PINS)
            texts[HEADER] = generate_header(wiring)
            # A copy of the firmware alone has no page.
            if (root / WIRING_PAGE).exists():
                page = (root / WIRING_PAGE).read_text(encoding="utf-8")
                texts[WIRING_PAGE] = with_table(page, wiring)
        except DeclarationError as error:
            print(f"pins.toml: {error}", file=sys.stderr)
            return 2
    stale = False
    for name, text in texts.items():
        path = root / name
        if path.exists() and path.read_text(encoding="utf-8") == text:
            continue
        stale = True
        if not arguments.check:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
        print(f"{name}: {'stale, run firmware/generate.py' if arguments.check else 'written'}")
    return 1 if stale and arguments.check else 0


if __name__ == "__main__":
    sys.exit(main())
