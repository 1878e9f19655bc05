"""Draw the rig with its three axes, for README and site: ``python docs/figures/rig.py [FILE.svg]``."""

from __future__ import annotations

import math
from collections.abc import Sequence

from overview import page, write

WIDTH, HEIGHT = 960, 400
STEEL, FRONT, BACK, WEIGHT, AXIS, INK = "#37526b", "#1b5e20", "#7a1f4b", "#8a4b00", "#0b4f8a", "#1c2733"
CENTRE_PX = (430.0, 335.0)
PX_PER_M = 370.0
PIVOT_M, ARM_M, TAIL_M, HALF_M = (0.0, 0.0, 0.45), 0.65, 0.45, 0.30
VIEW_RAD, TILT_RAD = math.radians(28.0), math.radians(24.0)

Point = tuple[float, float, float]


def seen(point_m: Point) -> tuple[float, float]:
    """Project a point (forward, left, up) onto the picture, in pixels."""
    x, y, z = point_m
    right = x * math.cos(VIEW_RAD) + y * math.sin(VIEW_RAD)
    depth = -x * math.sin(VIEW_RAD) + y * math.cos(VIEW_RAD)
    up = z * math.cos(TILT_RAD) + depth * math.sin(TILT_RAD)
    return CENTRE_PX[0] + PX_PER_M * right, CENTRE_PX[1] - PX_PER_M * up


def path(
    points_m: Sequence[Point], colour: str, width_px: float, more: str = "", fill: str = 'fill="none"'
) -> str:
    """Draw a line through points."""
    corners = " ".join(f"{x:.1f},{y:.1f}" for x, y in map(seen, points_m))
    return (
        f'<polyline points="{corners}" {fill} stroke="{colour}" stroke-width="{width_px}" '
        f'stroke-linecap="round" stroke-linejoin="round" {more}/>'
    )


def arc(centre_m: Point, first: Point, second: Point, start_deg: float, end_deg: float) -> str:
    """Draw a turn about a centre in the plane of two vectors, with an arrow in the positive direction."""
    angles_rad = [math.radians(start_deg + (end_deg - start_deg) * k / 24) for k in range(25)]
    points_m: list[Point] = [
        (
            centre_m[0] + math.cos(a) * first[0] + math.sin(a) * second[0],
            centre_m[1] + math.cos(a) * first[1] + math.sin(a) * second[1],
            centre_m[2] + math.cos(a) * first[2] + math.sin(a) * second[2],
        )
        for a in angles_rad
    ]
    return path(points_m, AXIS, 3, 'marker-end="url(#head)"')


def text(x: float, y: float, words: str, colour: str = INK, bold: bool = False) -> str:
    """Write a label, centred."""
    weight = ' font-weight="bold"' if bold else ""
    return f'<text x="{x:.0f}" y="{y:.0f}" font-size="17" fill="{colour}"{weight}>{words}</text>'


def rotor(hub_m: Point, colour: str) -> str:
    """Draw a propeller's disc, its motor and the direction of its thrust."""
    rim_m: list[Point] = [
        (hub_m[0] + 0.15 * math.cos(a), hub_m[1] + 0.15 * math.sin(a), hub_m[2] + 0.05)
        for a in (2 * math.pi * k / 36 for k in range(37))
    ]
    disc = path(rim_m, colour, 2, fill=f'fill="{colour}" fill-opacity="0.15"')
    motor = path([hub_m, (hub_m[0], hub_m[1], hub_m[2] + 0.05)], colour, 12)
    thrust = path(
        [(hub_m[0], hub_m[1], hub_m[2] + 0.07), (hub_m[0], hub_m[1], hub_m[2] + 0.24)],
        colour,
        3,
        'marker-end="url(#thrust)"',
    )
    return disc + motor + thrust


def drawing() -> str:
    """Return the picture as SVG."""
    z = PIVOT_M[2]
    end_m: Point = (ARM_M, 0.0, z)
    tail_m: Point = (-TAIL_M, 0.0, z)
    front_m, back_m = (ARM_M, -HALF_M, z), (ARM_M, HALF_M, z)
    shapes = [
        path(
            [(-0.16, -0.16, 0), (0.16, -0.16, 0), (0.16, 0.16, 0), (-0.16, 0.16, 0), (-0.16, -0.16, 0)],
            STEEL,
            2,
            fill='fill="#d5dde5"',
        ),
        path([(0, 0, 0), PIVOT_M], STEEL, 12),
        path([tail_m, end_m], STEEL, 8),
        path([(-TAIL_M - 0.04, 0, z), (-TAIL_M + 0.04, 0, z)], WEIGHT, 34),
        path([front_m, back_m], STEEL, 6),
        rotor(back_m, BACK),
        rotor(front_m, FRONT),
        arc((0, 0, 0.16), (0.22, 0, 0), (0, 0.22, 0), 150, 390),
        arc(PIVOT_M, (0.4, 0, 0), (0, 0, 0.4), -14, 22),
        arc(end_m, (0, -0.2, 0), (0, 0, 0.2), -24, 40),
    ]
    labels = [
        text(*_offset(seen((-0.16, -0.2, 0.16)), right_px=-52, down_px=12), "travel", AXIS, bold=True),
        text(*_offset(seen((0.4, 0, z + 0.2)), right_px=-44, down_px=-14), "elevation", AXIS, bold=True),
        text(*_offset(seen((ARM_M, -0.2, z)), right_px=-50, down_px=44), "pitch", AXIS, bold=True),
        text(*_offset(seen(tail_m), right_px=0, down_px=-30), "counterweight", WEIGHT),
        text(*_offset(seen((-0.2, 0, z)), right_px=6, down_px=30), "long arm", STEEL),
        text(*_offset(seen((ARM_M, 0.08, z)), right_px=56, down_px=6), "short arm", STEEL),
        text(*_offset(seen(front_m), right_px=40, down_px=52), "front rotor", FRONT),
        text(*_offset(seen(back_m), right_px=0, down_px=-92), "back rotor", BACK),
        text(*_offset(seen((0, 0, 0.3)), right_px=32, down_px=6), "post", STEEL),
        text(160, 385, "Blue arrows: positive directions", AXIS),
    ]
    heads = "".join(
        f'<marker id="{name}" viewBox="0 0 10 10" refX="6" refY="5" markerWidth="4.5" markerHeight="4.5" '
        f'orient="auto"><path d="M 0 0 L 10 5 L 0 10 z" fill="{colour}"/></marker>'
        for name, colour in (("head", AXIS), ("thrust", INK))
    )
    return page(WIDTH, HEIGHT, f"<defs>{heads}</defs>", *shapes, *labels)


def _offset(point: tuple[float, float], right_px: float, down_px: float) -> tuple[float, float]:
    return point[0] + right_px, point[1] + down_px


if __name__ == "__main__":
    write(drawing(), __file__)
