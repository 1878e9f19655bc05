"""Equations as MathML, made at build time: browsers draw it without a script, so that pages work offline."""

from __future__ import annotations

import re
from typing import Any

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml

# TeX reads two digits behind a fraction as its parts; the converter takes them for one number.
BARE_FRACTION = re.compile(r"(\\[td]?frac)(\d)(\d)")


def mathml(tex: str, is_block: bool) -> str:
    """Convert an equation."""
    return tex2mathml(BARE_FRACTION.sub(r"\1{\2}{\3}", tex), as_block=is_block)


def inline(writer: Any, node: nodes.math) -> None:
    """Write an equation within a line."""
    writer.body.append(mathml(node.astext(), is_block=False))
    raise nodes.SkipNode


def block(writer: Any, node: nodes.math_block) -> None:
    """Write an equation of its own line."""
    writer.body.append(f'<div class="math">{mathml(node.astext(), is_block=True)}</div>')
    raise nodes.SkipNode


def setup(app: Any) -> dict[str, bool]:
    """Register the renderer with Sphinx as `mathml`."""
    app.add_html_math_renderer("mathml", inline_renderers=(inline, None), block_renderers=(block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
