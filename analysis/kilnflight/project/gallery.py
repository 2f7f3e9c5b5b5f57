"""The page of figures/: every figure with caption, provenance and citation.

Made from the PNGs alone, which carry caption and provenance.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from PIL import Image

from kilnflight.project import paths as places

YEAR = 2026  # of the release, as in CITATION.cff


@dataclass(frozen=True)
class Entry:
    """A saved figure, as its PNG tells it."""

    identifier: str
    caption: str
    provenance: dict[str, Any]


def entries(folder: Path | None = None) -> list[Entry]:
    """Return the saved figures of a folder, by id."""
    found = []
    for path in sorted((folder or places.figures()).glob("*.png")):
        with Image.open(path) as image:
            text = image.info  # what stands before the pixels, which are not decoded
        if "Provenance" in text:
            record = json.loads(text["Provenance"])
            found.append(Entry(path.stem, text["Description"], record))
    return found


def concluded(folder: Path | None = None) -> dict[str, Path]:
    """Return where each notebook's verdicts are, by its stem (`figures.conclude`).

    What a notebook left that is no longer there does not count.
    """
    folder = folder or places.figures()
    stems = sorted(path.stem for path in (places.root() / "notebooks").glob("*.py"))
    paths = {stem: folder / f"claims-{stem.replace('_', '-')}.csv" for stem in stems}
    return {stem: path for stem, path in paths.items() if path.is_file()}


def gallery(folder: Path) -> str:
    """Return the text of figures/README.md: every figure with caption and citation."""
    found = entries(folder)
    scales = sorted({str(entry.provenance["parameters"].get("scale")) for entry in found})
    parts = [
        "# Figures and tables\n",
        f"Made at scale {' and '.join(scales)} (what the repository holds comes from `make full`); "
        "do not edit, and do not edit this page. Each figure has a PNG and a CSV here (the PDF is "
        "made by `make`, not tracked). Caption and provenance are also inside the PNG and the "
        "PDF.\n",
    ]
    parts += [_gallery_entry(entry) for entry in found]
    return "\n".join(parts)


def _gallery_entry(entry: Entry) -> str:
    made = entry.provenance
    commit = str(made["commit"])
    commit = f", commit {commit[:12]}{commit[40:]}" if commit else ""
    values = ", ".join(f"{name} = {value}" for name, value in made["parameters"].items())
    return f"""## {entry.identifier}

![{entry.identifier}]({entry.identifier}.png)

{entry.caption}

Data: [{entry.identifier}.csv]({entry.identifier}.csv). Made by notebooks/{made["notebook"]}.py,
kilnflight {made["version"]}{commit} ({values}).

<details><summary>Cite</summary>

```bibtex
@misc{{kilnflight-{entry.identifier},
  author = {{{{The kilnflight founders}}}},
  title  = {{{_latex(_title(entry.caption))}}},
  note   = {{kilnflight {made["version"]}, figure {entry.identifier}{commit}}},
  year   = {{{YEAR}}}
}}
```

```latex
\\begin{{figure}}
  \\centering
  \\includegraphics[width=\\columnwidth]{{{entry.identifier}.pdf}}
  \\caption{{{_latex(entry.caption)}~\\cite{{kilnflight-{entry.identifier}}}}}
  \\label{{fig:{entry.identifier}}}
\\end{{figure}}
```

</details>
"""


def _title(caption: str) -> str:
    abbreviations = "(?<!Fig)(?<!Figs)(?<!Eq)(?<!Eqs)(?<![Ss]ec)"
    return re.split(rf"{abbreviations}[.:;] ", caption, maxsplit=1)[0].rstrip(".")


def _latex(text: str) -> str:
    plain = text.replace("\\", r"\textbackslash ")
    escaped = re.sub(r"([%&_#${}])", r"\\\1", plain)
    return escaped.replace("~", r"\textasciitilde ").replace("^", r"\textasciicircum ")
