"""Cross-references in prose: notebooks, figures and tables of the thesis become links."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field

NOTEBOOKS = re.compile(r"\bnotebooks?\s(\d\d(?:(?:,\s|\sand\s|\sto\s)\d\d)*)")
NUMBERS = re.compile(r"\b(Fig|Table)s?\.?\s((?:A|\d)\.\d+(?:(?:,\s|\sand\s|\sto\s)(?:A|\d)\.\d+)*)")


@dataclass(frozen=True)
class Links:
    """Links of a text to the pages of the site."""

    notebooks: Mapping[str, str] = field(default_factory=dict)  # "13" -> "13_light"
    numbers: Mapping[tuple[str, str], str] = field(default_factory=dict)  # ("Fig", "5.18") -> name

    def __call__(self, text: str, above: str = "") -> str:
        """Return HTML (or Markdown) whose references are links; unknown ones stay words."""

        def notebook(found: re.Match[str]) -> str:
            return self._linked(found, r"\d\d", self._notebook, above)

        def number(found: re.Match[str]) -> str:
            def page(name: str) -> str:
                known = self.numbers.get((found[1], name))
                return f"works/{known}.html" if known else ""

            return self._linked(found, r"(?:A|\d)\.\d+", page, above)

        return NUMBERS.sub(number, NOTEBOOKS.sub(notebook, text))

    def _notebook(self, name: str) -> str:
        return f"{self.notebooks[name]}.html" if name in self.notebooks else ""

    @staticmethod
    def _linked(found: re.Match[str], each: str, page: object, above: str) -> str:
        """Return a reference with each of its numbers linked; a single one with its word."""
        assert callable(page)
        names = re.findall(each, found[1] if found.re is NOTEBOOKS else found[2])
        if len(names) == 1:
            target = page(names[0])
            return f'<a href="{above}{target}">{found[0]}</a>' if target else found[0]

        def link(name: re.Match[str]) -> str:
            target = page(name[0])
            return f'<a href="{above}{target}">{name[0]}</a>' if target else name[0]

        return re.sub(each, link, found[0])
