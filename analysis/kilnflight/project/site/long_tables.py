"""A page for every long table, with all its rows, to sort and filter (site.js)."""

from __future__ import annotations

from pathlib import Path

import pandas as pd

from kilnflight.project import figures
from kilnflight.project.site.blocks import LONGEST_TABLE, Blocks, html_table

MOST_ROWS = 3000  # of a page; what is longer is a CSV to load


def write(folder: Path, blocks: Blocks) -> list[str]:
    """Write the pages of all tables longer than a page shows; return their names."""
    folder.mkdir(parents=True, exist_ok=True)
    names = []
    for name, entry in blocks.entries.items():
        table = pd.read_csv(blocks.folder / f"{name}.csv", keep_default_na=False, dtype=str)
        if len(table) <= LONGEST_TABLE:
            continue
        shown = table.head(MOST_ROWS)
        part = "" if len(shown) == len(table) else f" The first {MOST_ROWS} of {len(table)} rows."
        (folder / f"{name}.md").write_text(
            f"---\norphan: true\n---\n\n# {figures.title_of(entry.caption)}\n\n"
            f"{blocks.links(entry.caption, blocks.above)}{part}\n\n"
            f'```{{raw}} html\n<div id="{name}"><input class="filter" type="search" '
            'placeholder="filter rows" '
            f'aria-label="filter rows"/>\n{html_table(shown, name)}\n{blocks.downloads(entry)}</div>\n```\n'
        )
        names.append(name)
    return names
