"""Settings of the site (Sphinx), which needs no network; `generate.py` writes its
pages.
"""

import gc
import re
from html import escape
from pathlib import Path
from typing import Any

from docutils import nodes
from ziamath import Latex

from kilnflight import __version__

# Few of millions of nodes are garbage; the search would take a quarter of the time.
gc.disable()

project = "kilnflight"
author = copyright = "The kilnflight founders"
release = __version__
html_title = f"kilnflight {release}"
extensions = [
    "myst_nb",
    "sphinx_copybutton",
    "sphinx_design",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
]
templates_path = [str(Path(__file__).parent / "_templates")]  # not below the pages
suppress_warnings = ["mystnb.unknown_mime_type"]
autodoc_typehints = "none"
autodoc_member_order = "bysource"
add_module_names = False
toc_object_entries = False
default_role = "py:obj"
napoleon_use_ivar = True
copybutton_selector = "div.highlight pre, .downloads pre"
html_theme = "furo"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = html_show_sourcelink = html_show_sphinx = False
html_show_search_summary = False  # it would fetch pages, which a site on disk may not
html_math_renderer = "drawn"
nb_execution_mode = "off"
nb_merge_streams = True
nb_code_prompt_show = nb_code_prompt_hide = "Code"
myst_enable_extensions = ["dollarmath", "amsmath", "colon_fence"]
myst_dmath_double_inline = True


def setup(app: Any) -> dict[str, bool]:
    """Draw formulas as SVG when the site is built, and keep bars in docstrings."""
    app.add_html_math_renderer("drawn", (inline, None), (block, None))
    app.connect("autodoc-process-docstring", bars)
    app.connect("autodoc-process-signature", short_paths)
    return {"parallel_read_safe": True, "parallel_write_safe": True}


def bars(*given: Any) -> None:
    """Escape the bars of absolute values in a docstring's lines, the last argument."""
    given[-1][:] = [line.replace("|", r"\|") for line in given[-1]]


def short_paths(*given: Any) -> tuple[str, str] | None:
    """Return a signature whose default paths begin at the package."""
    short = given[-2] and re.sub(
        r"\w*Path\('[^']*/(kilnflight/[^']*)'\)", r"Path('\1')", given[-2]
    )
    return (short, given[-1]) if short else None


def drawing(latex: str, inline: bool) -> str:
    """Return a formula as SVG in the colour of the text; its words are its LaTeX."""
    drawn = Latex(latex, size=17.0, color="currentColor", inline=inline)
    look = f'role="img" aria-label="{escape(latex)}"'
    look += f' style="vertical-align: {drawn.getyofst():.1f}px"'
    return str(drawn.svg()).replace("<svg ", f"<svg {look} ", 1)


def inline(writer: Any, node: nodes.math) -> None:
    """Write a formula in a line."""
    writer.body.append(
        f'<span class="math">{drawing(node.astext(), inline=True)}</span>'
    )
    raise nodes.SkipNode


def block(writer: Any, node: nodes.math_block) -> None:
    """Write a formula of its own."""
    formula = drawing(node.astext(), inline=False)
    writer.body.append(f'<div class="math" tabindex="0">{formula}</div>')
    raise nodes.SkipNode
