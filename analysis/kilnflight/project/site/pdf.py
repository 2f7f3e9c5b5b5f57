"""The few forms of a page in PDF: headings that are bookmarks, paragraphs, tables, pictures.

Letters are those of DejaVu, which matplotlib ships. The same flowables give the same bytes.
"""

from __future__ import annotations

import io
from collections.abc import Iterable, Sequence
from functools import cache
from html import escape
from pathlib import Path
from typing import Any

import matplotlib as mpl
import PIL.Image
from reportlab.lib import colors
from reportlab.lib.pagesizes import A4
from reportlab.lib.styles import ParagraphStyle
from reportlab.lib.units import mm
from reportlab.pdfbase import pdfmetrics
from reportlab.pdfbase.ttfonts import TTFont
from reportlab.platypus import CondPageBreak, Flowable, Image, Paragraph, SimpleDocTemplate, Table

MARGIN, PADDING = 20 * mm, 6
WIDTH = A4[0] - 2 * (MARGIN + PADDING)
ALONE = 35 * mm  # a heading with less than this below it goes to the next page
HIGHEST = 140 * mm  # of a picture
LARGER = 1.2  # a picture of a column of 88 mm, on a page with one column
GREY, RULE = colors.HexColor("#555555"), colors.HexColor("#bbbbbb")
FONTS = ("DejaVuSans", "DejaVuSans-Bold", "DejaVuSans-Oblique", "DejaVuSans-BoldOblique")
MONOSPACED = "DejaVuSansMono"
BODY = ParagraphStyle("body", fontName=FONTS[0], fontSize=9, leading=13, spaceAfter=6)
SMALL = ParagraphStyle("small", BODY, fontSize=7, leading=9, spaceAfter=0)
CODE = ParagraphStyle("code", SMALL, fontName=MONOSPACED, textColor=GREY, spaceAfter=10)
TITLE = ParagraphStyle("title", BODY, fontName=FONTS[1], fontSize=17, leading=22, spaceAfter=8)
HEADINGS = (
    ParagraphStyle("part", TITLE, fontSize=13, leading=17, spaceBefore=8),
    ParagraphStyle("section", TITLE, fontSize=10, leading=13, spaceBefore=6, spaceAfter=4),
)


@cache
def register_fonts() -> None:
    """Make DejaVu known to reportlab; paragraphs ask for it when they are made."""
    folder = Path(mpl.get_data_path()) / "fonts" / "ttf"
    for name in (*FONTS, MONOSPACED):
        pdfmetrics.registerFont(TTFont(name, folder / f"{name}.ttf"))
    pdfmetrics.registerFontFamily(FONTS[0], *FONTS)


class Heading(Paragraph):
    """A heading that is a bookmark, too."""

    def __init__(self, text: str, level: int = 0) -> None:
        super().__init__(escape(text), HEADINGS[level])
        self.words, self.level = text, level

    def draw(self) -> None:
        """Draw the heading and mark its place."""
        key = f"{self.canv.getPageNumber()}-{self.words}"
        self.canv.bookmarkPage(key)
        self.canv.addOutlineEntry(self.words, key, self.level)
        super().draw()


def begun(heading: Heading) -> list[Flowable]:
    """Return a heading that does not stand alone at the foot of a page."""
    return [CondPageBreak(ALONE), heading]


def table(
    columns: Iterable[str], rows: Iterable[Iterable[object]], widths_mm: Sequence[float]
) -> Flowable:
    """Return a table whose heading is repeated on every page."""
    cells = [[Paragraph(f"<b>{escape(name)}</b>", SMALL) for name in columns]]
    cells += [[Paragraph(escape(str(value)), SMALL) for value in row] for row in rows]
    whole = ((0, 0), (-1, -1))
    lines = [
        ("LINEBELOW", *whole, 0.4, RULE),
        ("VALIGN", *whole, "TOP"),
        ("LEFTPADDING", *whole, 0),
    ]
    widths = [width * mm for width in widths_mm]
    return Table(cells, widths, repeatRows=1, hAlign="LEFT", spaceAfter=8, style=lines)


def picture(path: Path) -> Flowable:
    """Return a PNG at about its own size in print."""
    with PIL.Image.open(path) as image:
        printed = image.width / image.info["dpi"][0] * 72
    shown = Image(path, hAlign="LEFT")
    shown._restrictSize(min(WIDTH, LARGER * printed), HIGHEST)
    return shown


def pages(story: list[Flowable], title: str, author: str, below: str) -> bytes:
    """Return a PDF of A4 pages, each with a line at its foot and its number."""

    def foot(canvas: Any, document: Any) -> None:
        canvas.setFont(FONTS[0], 7)
        canvas.setFillColor(GREY)
        canvas.drawString(MARGIN + PADDING, 12 * mm, below)
        canvas.drawRightString(A4[0] - MARGIN - PADDING, 12 * mm, str(document.page))

    made = io.BytesIO()
    sides = ("leftMargin", "rightMargin", "topMargin", "bottomMargin")
    document = SimpleDocTemplate(
        made,
        pagesize=A4,
        invariant=1,  # no dates
        title=title,
        author=author,
        lang="en",
        **dict.fromkeys(sides, MARGIN),
    )
    document.build(story, onFirstPage=foot, onLaterPages=foot)
    return made.getvalue()
