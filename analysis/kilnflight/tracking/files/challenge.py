"""XML of the particle tracking challenge, which Icy, TrackMate and others read and write.

::

    <root>
      <TrackContestISBI2012 snr="4" density="low" scenario="VESICLE">
        <particle>
          <detection t="0" x="12.5" y="40.0" z="0"/>
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from xml.parsers import expat
from xml.sax.saxutils import quoteattr

import pandas as pd

from kilnflight.checks import InputError
from kilnflight.tracking.files.rows import Row, in_tracks, make_tracks, number, whole, write_lines

CONTEST = "TrackContestISBI2012"


def read_challenge(path: str | Path) -> pd.DataFrame:
    """Return the tracks of a file of the challenge, with ``plane`` (z).

    Particles have no names in this format: they are numbered as they come, from 0. An element
    without detections keeps its number and has no rows.

    Raises
    ------
    InputError
        If the file cannot be read, is no such file, or a detection lacks a number; the message
        names the line.
    """
    content = _Content(Path(path))
    parser = expat.ParserCreate()
    parser.StartElementHandler = lambda name, fields: content.start(
        name, fields, parser.CurrentLineNumber
    )
    parser.EndElementHandler = content.end
    parser.StartDoctypeDeclHandler = content.refuse  # an entity could be of any size
    try:
        with content.path.open("rb") as file:
            parser.ParseFile(file)
    except InputError:
        raise
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error}).") from error
    except (expat.ExpatError, LookupError, ValueError) as error:  # the latter two: its encoding
        raise InputError(f"{path}: is no whole XML file ({error}).") from error
    if not content.found:
        raise InputError(f"{path}: has no element {CONTEST}; it is no file of the challenge.")
    return make_tracks(content.rows, planes=True)


class _Content:
    """What the parser has come across so far."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.rows: list[Row] = []
        self.open: list[str] = []
        self.particle = -1
        self.found = False

    def start(self, name: str, fields: dict[str, str], line: int) -> None:
        inside = self.open[-1] if self.open else ""
        self.open.append(name)
        self.found |= name == CONTEST
        if name == "particle" and inside == CONTEST:
            self.particle += 1
        elif name == "detection" and inside == "particle" and self.found:
            self.rows.append(self._row(fields, f"{self.path}, line {line}"))
        elif name in ("particle", "detection"):
            raise InputError(f"{self.path}, line {line}: {name} inside of {inside or 'nothing'}.")

    def end(self, name: str) -> None:
        self.open.pop()

    def refuse(self, *_: object) -> None:
        raise InputError(f"{self.path}: has a document type; files of the challenge have none.")

    def _row(self, fields: dict[str, str], where: str) -> Row:
        missing = [name for name in "txyz" if name not in fields]
        if missing:
            raise InputError(f"{where}: detection without {', '.join(missing)}.")
        x, y, z = (number(fields[name], f"{where}, {name}") for name in "xyz")
        return whole(fields["t"], f"{where}, t"), self.particle, y, x, z


def write_challenge(
    tracks: pd.DataFrame, path: str | Path, snr: str = "", density: str = "", scenario: str = ""
) -> None:
    """Write tracks as a file of the challenge; without ``plane``, z is 0.

    Parameters
    ----------
    tracks
        ``frame, particle, row, col`` and perhaps ``plane``.
    path
        The file.
    snr, density, scenario
        How the challenge names the data; any text.
    """
    table = in_tracks(tracks, "write_challenge: tracks")
    names = {"snr": snr, "density": density, "scenario": scenario}
    about = " ".join(f"{name}={quoteattr(text)}" for name, text in names.items())
    write_lines(Path(path), _lines(table.assign(plane=table.get("plane", 0.0)), about))


def _lines(table: pd.DataFrame, about: str) -> Iterator[str]:
    yield '<?xml version="1.0" encoding="UTF-8" standalone="no"?>\n<root>\n'
    yield f"<{CONTEST} {about}>\n"
    for _, of_one in table.groupby("particle"):
        yield "<particle>\n"
        columns = [of_one[name].tolist() for name in ("frame", "col", "row", "plane")]
        for t, x, y, z in zip(*columns, strict=True):
            yield f'<detection t="{t}" x="{x!r}" y="{y!r}" z="{z!r}"/>\n'
        yield "</particle>\n"
    yield f"</{CONTEST}>\n</root>\n"
