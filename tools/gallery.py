"""Gallery of films: ``python tools/gallery.py FOLDER [KIND ...]``, by ``make``.

Each is simulated, run as its command says, and scored against the truth. In the folder
are then gallery.csv and a picture of each. It is made anew when the package changed.
"""

import contextlib
import io
import sys
import tempfile
import warnings
from collections.abc import Sequence
from pathlib import Path

import pandas as pd
from films import KINDS, Film, made
from PIL import Image
from schedule import sources_hash

import kilnflight
from kilnflight.film.pictures import png
from kilnflight.scores import score_detections
from kilnflight.store.cache import write_whole

GATE_PX = 3.0  # farthest distance of a hit
COMMAND = "kilnflight run {}.tif --to results"


def command(name: str, film: Film) -> str:
    """Return the command that runs a film."""
    words = [COMMAND.format(name)]
    for option, value in film.options.items():
        words.append(f"--{option}")
        if value is not True:
            words.append(f"{value}")
    return " ".join(words)


def with_tracks(truth: pd.DataFrame, tracks: pd.DataFrame) -> pd.DataFrame:
    """Return the truth with ``track``: that of the detection at each place.

    It is -1 for a detection in no track, and -2 where nothing is detected.
    """
    owned = truth.assign(track=-2)
    for frame, here in truth.groupby("frame"):
        found = tracks[tracks["frame"] == frame]
        places = (here[["row", "col"]].to_numpy(), found[["row", "col"]].to_numpy())
        pairs = score_detections(*places, GATE_PX).pairs
        rows = here.index[pairs[:, 0]]
        owned.loc[rows, "track"] = found["particle"].to_numpy()[pairs[:, 1]]
    return owned


def scored(film: Film, tracks: pd.DataFrame) -> dict[str, float]:
    """Return recall, precision, share of the true links, and diffusion.

    A link is a step of a particle from one frame to the next.
    """
    owned = with_tracks(film.truth, tracks).sort_values(["particle", "frame"])
    hits = (owned["track"] > -2).sum()
    before = owned.shift()
    steps = (owned["particle"] == before["particle"]) & (owned.diff()["frame"] == 1)
    linked = steps & (owned["track"] >= 0) & (owned["track"] == before["track"])
    row = {
        "recall": hits / len(owned),
        "precision": hits / max(len(tracks), 1),
        "links": linked.sum() / max(steps.sum(), 1),
    }
    if film.diffusion is not None:
        followed = tracks[tracks["particle"] >= 0]
        displacements = kilnflight.square_displacements(followed)
        row["true_diffusion"] = film.diffusion
        row["diffusion"] = kilnflight.fit_spreading(displacements).diffusion
    return row


def light(picture: bytes) -> bytes:
    """Return a picture as a page of eight shows it: 800 px wide, of 128 colours."""
    with Image.open(io.BytesIO(picture)) as image:
        small = image.convert("RGB")
    small.thumbnail((800, 800))
    written = io.BytesIO()
    small.quantize(128, dither=Image.Dither.NONE).save(written, "PNG", optimize=True)
    return written.getvalue()


def run(name: str, folder: Path) -> dict[str, object]:
    """Run one film, draw its tracks into the folder and return its row."""
    film = made(name)
    with (
        tempfile.TemporaryDirectory() as place,
        contextlib.redirect_stdout(io.StringIO()),
        warnings.catch_warnings(),
    ):
        warnings.simplefilter("ignore")  # the page shows what the summary says
        tables = kilnflight.run(film.pictures, f"{place}/results", **film.options)
    tracks = tables["tracks"]
    picture = kilnflight.plot_tracks(film.pictures, tracks)
    write_whole(folder / f"{name}.png", light(png(picture)))
    told = tables["summary"]
    said = told.loc[told["what"] == "warning", "value"]
    return {
        "film": name,
        "shows": film.shows,
        "frames": len(film.pictures),
        "particles": film.truth["particle"].nunique(),
        "command": command(name, film),
        **scored(film, tracks),
        "warnings": " ".join(said),
    }


def main(folder: Path, kinds: Sequence[str]) -> None:
    """Make the gallery in a folder unless it is there, made by the same package."""
    stamp = sources_hash()
    kept = folder / "stamp"
    if kept.is_file() and kept.read_text() == stamp:
        return
    folder.mkdir(parents=True, exist_ok=True)
    rows = []
    for number, name in enumerate(kinds):
        print(f"gallery: film {number + 1} of {len(kinds)}, {name}", flush=True)
        rows.append(run(name, folder))
    text = pd.DataFrame(rows).round(4).to_csv(index=False)
    write_whole(folder / "gallery.csv", text.encode())
    write_whole(kept, stamp.encode())


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:] or [*KINDS])
