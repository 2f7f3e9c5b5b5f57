"""Formulas as drawings, made when the site is built: a page loads no script and no font for them.

MathML alone would do, if every reader had a font with mathematics: without one, braces and roots
do not grow.
"""

from __future__ import annotations

from html import escape
from typing import Any

from docutils import nodes
from ziamath import Latex

SIZE = 17.0  # px of the letters; those around them have 16


def setup(app: Any) -> dict[str, bool]:
    """Tell Sphinx how formulas become HTML."""
    app.add_html_math_renderer("drawn", (inline, None), (block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def drawing(latex: str, inline: bool) -> str:
    """Return a formula as SVG in the colour of the text; its words are its LaTeX."""
    drawn = Latex(latex, size=SIZE, color="currentColor", inline=inline)
    look = f'role="img" aria-label="{escape(latex, quote=True)}" style="vertical-align: '
    return str(drawn.svg()).replace("<svg ", f'<svg {look}{drawn.getyofst():.1f}px" ', 1)


def inline(writer: Any, node: nodes.math) -> None:
    """Write a formula in a line."""
    writer.body.append(f'<span class="math">{drawing(node.astext(), inline=True)}</span>')
    raise nodes.SkipNode


def block(writer: Any, node: nodes.math_block) -> None:
    """Write a formula of its own, with its number at the right."""
    number = f"<span>({node['number']})</span>" if node.get("number") else ""
    formula = drawing(node.astext(), inline=False)
    writer.body.append(f'<div class="math" tabindex="0"><div>{formula}</div>{number}</div>')
    raise nodes.SkipNode
