"""Draw docs/figures/wiring.svg from firmware/pins.toml: ``python docs/figures/wiring.py [FILE [PINS]]``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import NamedTuple

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
sys.path.insert(0, str(ROOT))

from firmware.generator.wiring import CHIP_PINS, read_pins, rows  # noqa: E402 - found by the line above

PINS = ROOT / "firmware" / "pins.toml"

SIGNAL, POWER, SUPPLY, GROUND = "#1b4f8f", "#b04a00", "#a01515", "#333333"
BOARD_LEFT, BOARD_RIGHT = 58.0, 84.0
LEFT_EDGE, RIGHT_EDGE = 26.0, 108.0
RAIL = 141.0
# Sizes in points that give 10 pixels or more on a page of the site, which shows the drawing 864 pixels wide.
SMALL, NORMAL, LARGE = 12, 12.5, 14


class Pin(NamedTuple):
    """A pin: its name at the chip, and its name as printed on the Due."""

    chip: str
    due: str


def wires(path: Path) -> dict[str, Pin]:
    """Return the pins of a wiring by the names of their signals.

    Parameters
    ----------
    path : Path
        A wiring such as firmware/pins.toml.
    """
    return {name: Pin(CHIP_PINS[due], due) for name, due, _, _ in rows(read_pins(path))}


def wire(axes: Axes, points: list[tuple[float, float]], colour: str = SIGNAL) -> None:
    """A wire through points."""
    axes.plot(*zip(*points, strict=True), color=colour, linewidth=1.3, solid_capstyle="round")


def dot(axes: Axes, x: float, y: float, colour: str = SIGNAL) -> None:
    """A joint."""
    axes.add_patch(Circle((x, y), 0.45, color=colour, zorder=4))


def block(axes: Axes, x: float, y: float, width: float, height: float, title: str, note: str = "") -> None:
    """A box with a title above its middle and a note below it."""
    axes.add_patch(Rectangle((x, y), width, height, facecolor="#f4f4f4", edgecolor="black", linewidth=1.2))
    middle = x + width / 2
    axes.text(middle, y + height + 0.8, title, ha="center", va="bottom", fontsize=LARGE, fontweight="bold")
    if note:
        axes.text(middle, y - 0.8, note, ha="center", va="top", fontsize=SMALL)


def pull_up(axes: Axes, x: float, y: float, value: str) -> None:
    """A resistor from a wire up to 3.3 V."""
    dot(axes, x, y)
    wire(axes, [(x, y), (x, y + 4.0)], POWER)
    axes.add_patch(Rectangle((x - 0.6, y + 0.9), 1.2, 2.4, facecolor="white", edgecolor=POWER, zorder=3))
    axes.text(x + 1.1, y + 2.1, value, fontsize=SMALL, va="center", color=POWER)
    axes.text(x, y + 4.1, "3.3 V", fontsize=SMALL, ha="center", va="bottom", color=POWER)


def earth(axes: Axes, x: float, y: float) -> None:
    """The ground symbol, its top at y."""
    for width, below in ((2.0, 0.0), (1.3, 0.5), (0.6, 1.0)):
        wire(axes, [(x - width / 2, y - below), (x + width / 2, y - below)], GROUND)


def pull_down(axes: Axes, x: float, y: float, value: str) -> None:
    """A resistor from a wire down to ground."""
    dot(axes, x, y)
    wire(axes, [(x, y), (x, y - 3.6)], GROUND)
    axes.add_patch(Rectangle((x - 0.6, y - 3.2), 1.2, 2.4, facecolor="white", edgecolor=GROUND, zorder=3))
    axes.text(x + 1.1, y - 2.0, value, fontsize=SMALL, va="center", color=GROUND)
    earth(axes, x, y - 3.6)


def board_pin(axes: Axes, y: float, label: str, chip: str, *, is_left: bool) -> None:
    """A pin at the edge of the Due: the printed name outside, the chip's inside."""
    x, step = (BOARD_LEFT, 1.0) if is_left else (BOARD_RIGHT, -1.0)
    inward = "left" if is_left else "right"
    axes.add_patch(Rectangle((x - 0.7, y - 0.7), 1.4, 1.4, facecolor="black"))
    axes.text(
        x + 1.6 * step,
        y,
        f"{label}  {chip}" if is_left else f"{chip}  {label}",
        ha=inward,
        va="center",
        fontsize=NORMAL,
    )


def encoder(axes: Axes, top: float, name: str, line_a: Pin, line_b: Pin) -> None:
    """An encoder and its two lines."""
    block(
        axes,
        4.0,
        top - 9.5,
        LEFT_EDGE - 4.0,
        12.0,
        f"encoder: {name}",
        "12-24 V and 0 V\nfrom its own supply",
    )
    for y, line, pin, at in ((top, "A", line_a, 34.0), (top - 7.0, "B", line_b, 44.0)):
        axes.text(LEFT_EDGE - 1.0, y, line, ha="right", va="center", fontsize=NORMAL)
        wire(axes, [(LEFT_EDGE, y), (BOARD_LEFT, y)])
        # The LED on the board loads this pin.
        pull_up(axes, at, y, "1 k" if pin.due == "D13" else "1-2.2 k")
        board_pin(axes, y, pin.due, pin.chip, is_left=True)
    axes.text(5.0, top - 3.5, "N type:\nopen collector", fontsize=SMALL, va="center")


def driver(axes: Axes, top: float, name: str, lines: list[tuple[str, Pin]], *, inverted: bool) -> float:
    """A driver module, its control lines, supply and motor; returns the height of its supply terminal."""
    block(axes, RIGHT_EDGE, top - 30.0, 19.0, 33.0, f"{name} driver: IBT-2")
    for row, (terminal, pin) in enumerate(lines):
        y = top - 5.5 * row
        axes.text(RIGHT_EDGE + 1.0, y, terminal, ha="left", va="center", fontsize=NORMAL)
        wire(axes, [(BOARD_RIGHT, y), (RIGHT_EDGE, y)])
        board_pin(axes, y, pin.due, pin.chip, is_left=False)
        if terminal.endswith("EN"):
            hold_off = pull_up if inverted else pull_down
            hold_off(axes, 92.0 if terminal == "R_EN" else 100.0, y, "4.7 k")
    y = top - 5.5 * len(lines)
    axes.text(RIGHT_EDGE + 1.0, y, "VCC", ha="left", va="center", fontsize=NORMAL)
    wire(axes, [(RIGHT_EDGE, y), (100.0, y)], POWER)
    axes.text(99.4, y, "3.3 V,\nnever 5 V", ha="right", va="center", fontsize=SMALL, color=POWER)
    axes.text(RIGHT_EDGE + 1.0, y - 3.0, "GND", ha="left", va="center", fontsize=NORMAL)
    wire(axes, [(RIGHT_EDGE, y - 3.0), (104.5, y - 3.0)], GROUND)
    earth(axes, 104.5, y - 3.0)
    axes.text(RIGHT_EDGE + 1.0, y - 6.0, "R_IS, L_IS: open", ha="left", va="center", fontsize=SMALL)
    axes.add_patch(Circle((135.0, top - 8.0), 3.6, facecolor="white", edgecolor="black"))
    axes.text(135.0, top - 8.0, "M", ha="center", va="center", fontsize=LARGE)
    axes.text(135.0, top - 3.6, name, ha="center", va="bottom", fontsize=SMALL)
    for y in (top - 6.0, top - 10.0):
        wire(axes, [(RIGHT_EDGE + 19.0, y), (132.0, y)])
    axes.text(RIGHT_EDGE + 18.2, top - 8.0, "M+ M-", ha="right", va="center", fontsize=SMALL)
    supply_y = top - 20.0
    axes.text(RIGHT_EDGE + 18.2, supply_y, "B+", ha="right", va="center", fontsize=NORMAL)
    axes.text(RIGHT_EDGE + 18.2, supply_y - 5.0, "B-", ha="right", va="center", fontsize=NORMAL)
    wire(axes, [(RIGHT_EDGE + 19.0, supply_y), (RAIL, supply_y)], SUPPLY)
    axes.add_patch(
        Rectangle((128.6, supply_y - 0.7), 4.0, 1.4, facecolor="white", edgecolor=SUPPLY, zorder=3)
    )
    axes.text(130.6, supply_y + 1.0, "fuse", ha="center", va="bottom", fontsize=SMALL, color=SUPPLY)
    wire(axes, [(RIGHT_EDGE + 19.0, supply_y - 5.0), (130.0, supply_y - 5.0)], GROUND)
    earth(axes, 130.0, supply_y - 5.0)
    return supply_y


def draw(path: Path) -> Figure:
    """The whole diagram.

    Parameters
    ----------
    path : Path
        A wiring such as firmware/pins.toml.

    Returns
    -------
    Figure
    """
    pins, wiring = wires(path), read_pins(path)
    figure = Figure(figsize=(14.4, 12.0))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_xlim(0, 144)
    axes.set_ylim(0, 96)
    axes.axis("off")

    board = Rectangle(
        (BOARD_LEFT, 6.0),
        BOARD_RIGHT - BOARD_LEFT,
        84.0,
        facecolor="#e7f0f7",
        edgecolor="black",
        linewidth=1.5,
    )
    axes.add_patch(board)
    middle = (BOARD_LEFT + BOARD_RIGHT) / 2
    axes.text(middle, 91.0, "Arduino Due", ha="center", va="bottom", fontsize=LARGE, fontweight="bold")
    axes.text(76.5, 18.0, "programming\nport (USB)", ha="center", fontsize=NORMAL)
    axes.text(76.5, 11.4, f"{pins['Receive'].due}, {pins['Transmit'].due}: open", ha="center", fontsize=SMALL)
    wire(axes, [(78.5, 6.0), (78.5, 2.8)])
    axes.text(78.5, 2.2, "computer; the board's only supply", ha="center", va="top", fontsize=SMALL)

    encoder(axes, 84.0, "elevation", pins["ElevationA"], pins["ElevationB"])
    encoder(axes, 64.5, "pitch", pins["PitchA"], pins["PitchB"])
    encoder(axes, 45.0, "travel", pins["TravelA"], pins["TravelB"])

    stop = pins["HardwareStop"]
    y = 24.5
    board_pin(axes, y, stop.due, stop.chip, is_left=True)
    wire(axes, [(BOARD_LEFT, y), (LEFT_EDGE, y)])
    pull_up(axes, 44.0, y, "4.7 k")
    block(
        axes,
        4.0,
        y - 5.5,
        LEFT_EDGE - 4.0,
        8.5,
        "stop: normally closed" if wiring.stop_is_high else "stop: normally open",
        "opens when pressed;\nsecond contact: right"
        if wiring.stop_is_high
        else "second contact,\nwhich opens: right",
    )
    axes.text(LEFT_EDGE - 1.0, y, "to D29", ha="right", va="center", fontsize=SMALL)
    axes.text(LEFT_EDGE - 1.0, y - 3.4, "to ground", ha="right", va="center", fontsize=SMALL)
    wire(axes, [(LEFT_EDGE, y - 3.4), (34.0, y - 3.4)], GROUND)
    earth(axes, 34.0, y - 3.4)

    for y, label, chip in ((15.0, "D10", "PC29, PA28"), (9.5, "A6", "PA3")):
        board_pin(axes, y, label, chip, is_left=True)
        wire(axes, [(BOARD_LEFT - 4.5, y - 1.2), (BOARD_LEFT - 2.1, y + 1.2)], SUPPLY)
        wire(axes, [(BOARD_LEFT - 4.5, y + 1.2), (BOARD_LEFT - 2.1, y - 1.2)], SUPPLY)
        axes.text(
            BOARD_LEFT - 5.4,
            y,
            "leave open: clears a count",
            ha="right",
            va="center",
            fontsize=SMALL,
            color=SUPPLY,
        )

    front = [
        ("R_EN", pins["FrontForwardEnable"]),
        ("L_EN", pins["FrontReverseEnable"]),
        ("RPWM", pins["FrontForward"]),
        ("LPWM", pins["FrontReverse"]),
    ]
    back = [
        ("R_EN", pins["BackForwardEnable"]),
        ("L_EN", pins["BackReverseEnable"]),
        ("RPWM", pins["BackForward"]),
        ("LPWM", pins["BackReverse"]),
    ]
    upper = driver(axes, 84.0, "front", front, inverted=wiring.enable_inverted)
    lower = driver(axes, 44.0, "back", back, inverted=wiring.enable_inverted)
    wire(axes, [(RAIL, upper), (RAIL, 7.0), (133.0, 7.0)], SUPPLY)
    dot(axes, RAIL, lower, SUPPLY)
    # A normally closed contact.
    wire(axes, [(133.0, 6.0), (133.0, 7.0)], SUPPLY)
    wire(axes, [(126.0, 7.0), (133.6, 6.2)], SUPPLY)
    wire(axes, [(126.0, 7.0), (121.0, 7.0)], SUPPLY)
    axes.text(120.4, 7.0, "+12 V", ha="right", va="center", fontsize=LARGE, color=SUPPLY)
    axes.text(130.0, 8.0, "stop, second contact", ha="center", va="bottom", fontsize=SMALL, color=SUPPLY)
    axes.text(
        124.0,
        3.0,
        "one ground for supply, drivers,\nencoders and Due",
        ha="right",
        va="center",
        fontsize=SMALL,
    )
    earth(axes, 126.5, 3.6)
    return figure


def main() -> None:
    """Draw it into the file named, or into this folder."""
    target = Path(sys.argv[1]) if len(sys.argv) > 1 else HERE / "wiring.svg"
    pins = Path(sys.argv[2]) if len(sys.argv) > 2 else PINS
    # Text stays text, and the same pins make the same file.
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": "wiring", "font.family": "DejaVu Sans"}):
        draw(pins).savefig(
            target, metadata={"Date": None} if target.suffix == ".svg" else None, dpi=110, facecolor="white"
        )


if __name__ == "__main__":
    main()
