"""Draw the block diagram of README and the site: ``python docs/figures/overview.py [FILE.svg]``."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

WIDTH, HEIGHT = 960, 330
BLUE, GREEN, ORANGE, INK = "#0b4f8a", "#1b5e20", "#8a4b00", "#1c2733"


def box(
    x: float, y: float, width: float, height: float, colour: str, title: str, *lines: str
) -> Iterator[str]:
    """Draw a box with a title and lines below it."""
    yield (
        f'<rect x="{x}" y="{y}" width="{width}" height="{height}" rx="8" fill="#ffffff" '
        f'stroke="{colour}" stroke-width="2"/>'
    )
    middle = x + width / 2
    top = y + height / 2 - 9 * len(lines) + 5
    yield f'<text x="{middle}" y="{top}" font-size="16" font-weight="bold" fill="{colour}">{title}</text>'
    for number, line in enumerate(lines, 1):
        yield f'<text x="{middle}" y="{top + 20 * number}" font-size="13" fill="{INK}">{line}</text>'


def arrow(x: float, y: float, to_x: float, to_y: float, both: bool = True) -> str:
    """Draw an arrow, with heads at both ends if `both` is true."""
    start = ' marker-start="url(#head)"' if both else ""
    return (
        f'<line x1="{x}" y1="{y}" x2="{to_x}" y2="{to_y}" stroke="{INK}" stroke-width="1.6"'
        f'{start} marker-end="url(#head)"/>'
    )


def label(x: float, y: float, *lines: str) -> Iterator[str]:
    """Write small lines, centred."""
    for number, line in enumerate(lines):
        yield f'<text x="{x}" y="{y + 16 * number}" font-size="12" fill="{INK}">{line}</text>'


def parts() -> Iterator[str]:
    """Everything in the picture.

    Places are pixels from the top left corner: of a box, its corner, then width and height; of an arrow,
    its two ends; of a label, its middle.
    """
    yield from box(20, 25, 230, 120, BLUE, "host", "heli-host, Python, dashboard", "plans, logs, stop")
    yield from box(20, 185, 230, 120, BLUE, "laboratory", "describe, tune, identify,", "diagnose, monitor")
    yield arrow(135, 145, 135, 185)
    yield from label(178, 169, "logs, rigs")
    yield arrow(252, 85, 388, 85)
    yield from label(320, 50, "link: USB, serial, TCP", "every millisecond")
    yield from box(390, 25, 230, 280, GREEN, "")
    yield f'<text x="505" y="52" font-size="16" font-weight="bold" fill="{GREEN}">board</text>'
    yield from label(505, 72, "the same flight code on each")
    yield from box(410, 88, 190, 58, GREEN, "Arduino Due", "hardware")
    yield from box(410, 162, 190, 58, GREEN, "emulated Due", "the same firmware file")
    yield from box(410, 236, 190, 58, GREEN, "native", "compiled for this computer")
    yield from box(740, 88, 200, 58, ORANGE, "rig", "motors and encoders")
    yield from box(
        740,
        162,
        200,
        132,
        ORANGE,
        "simulated rig",
        "equations from a rig file,",
        "plus effects: lag, friction,",
        "cables, play",
    )
    yield arrow(602, 117, 738, 117)
    yield from label(682, 103, "voltages, angles")
    yield arrow(602, 191, 738, 210)
    yield arrow(602, 265, 738, 246)


def drawing() -> str:
    """Return the picture as SVG."""
    head = (
        '<defs><marker id="head" viewBox="0 0 10 10" refX="9" refY="5" markerWidth="7" markerHeight="7" '
        f'orient="auto-start-reverse"><path d="M 0 1 L 10 5 L 0 9 z" fill="{INK}"/></marker></defs>'
    )
    return page(WIDTH, HEIGHT, head, *parts())


def page(width: int, height: int, definitions: str, *shapes: str) -> str:
    """Return an SVG file with shapes on a light background."""
    opening = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" '
        f'height="{height}" font-family="Helvetica, Arial, sans-serif" text-anchor="middle">'
    )
    # Viewers with a dark page would show dark lines on it.
    background = f'<rect width="{width}" height="{height}" rx="10" fill="#f4f6f8"/>'
    return "\n".join((opening, definitions, background, *shapes, "</svg>")) + "\n"


def write(text: str, program: str) -> None:
    """Write a drawing into the file that the command line names, or next to its program."""
    target = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(program).with_suffix(".svg")
    target.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    write(drawing(), __file__)
