"""The reader's side: executed notebooks and what they saved as a site, read without a network.

executed notebooks, figures/, docs/ -> pages -> Sphinx -> site
"""

from kilnflight.project.site.build import build_site, main
from kilnflight.project.site.readme import END_MARK, MARK, results_block, update_readme
from kilnflight.project.site.rooms import draw_rooms, imports

__all__ = [
    "END_MARK",
    "MARK",
    "build_site",
    "draw_rooms",
    "imports",
    "main",
    "results_block",
    "update_readme",
]
