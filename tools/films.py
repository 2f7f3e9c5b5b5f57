"""Eight kinds of film with known truth, for the gallery and for tests.

Spots are Gaussians summed over each pixel, with noise of a camera that grows with the
light. Positions are row, col in px, frames count from 0.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.special import ndtr

EDGE_PX = 12.0  # no particle starts nearer to the border
BASE = 100.0  # grey values without particles
NOISE = 2.0  # grey values


class Film(NamedTuple):
    """A film, where its particles are, and how it is run.

    Parameters
    ----------
    pictures
        (frames, rows, cols), 8 or 16 bits.
    truth
        Columns frame, particle, row, col: what is in view and not dark.
    shows
        What is seen, in a few words.
    options
        Of `kilnflight.run`.
    diffusion
        px^2 a frame; None: particles do not diffuse.
    """

    pictures: np.ndarray
    truth: pd.DataFrame
    shows: str
    options: dict[str, Any]
    diffusion: float | None = None


def starts(
    number: int, size: tuple[int, int], apart: float, rng: np.random.Generator
) -> np.ndarray:
    """Draw places (number, 2) that are ``apart`` px from each other at least."""
    places = np.empty((0, 2))
    while len(places) < number:
        place = rng.uniform(EDGE_PX, np.array(size) - EDGE_PX)
        if not len(places) or np.hypot(*(places - place).T).min() > apart:
            places = np.vstack([places, place])
    return places


def walked(
    start: np.ndarray,
    frames: int,
    diffusion: float,
    drift: tuple[float, float],
    rng: np.random.Generator,
) -> np.ndarray:
    """Return places (frames, n, 2) of particles that diffuse and drift."""
    steps = rng.normal(0.0, np.sqrt(2 * diffusion), (frames - 1, *start.shape)) + drift
    return np.concatenate([start[None], start + steps.cumsum(axis=0)])


def spot(picture: np.ndarray, place: np.ndarray, sigma: float, light: float) -> None:
    """Add a Gaussian spot, summed over each pixel; ``light`` is its height."""
    reach = int(np.ceil(5 * sigma)) + 1
    middle = np.rint(place).astype(int)
    lines = []
    spans = []
    for axis in (0, 1):
        first = max(middle[axis] - reach, 0)
        stop = min(middle[axis] + reach + 1, picture.shape[axis])
        if first >= stop:
            return
        edges = np.arange(first, stop + 1) - 0.5 - place[axis]
        lines.append(np.diff(ndtr(edges / sigma)) * sigma * np.sqrt(2 * np.pi))
        spans.append(slice(first, stop))
    picture[tuple(spans)] += light * np.outer(*lines)


def rod(picture: np.ndarray, place: np.ndarray, angle: float, light: float) -> None:
    """Add a rod of 20 x 3 px."""
    row, col = np.indices(picture.shape)
    down = row - place[0]
    right = col - place[1]
    along = np.abs(np.sin(angle) * down + np.cos(angle) * right)
    across = np.abs(np.cos(angle) * down - np.sin(angle) * right)
    picture += light * ndtr((10 - along) / 0.6) * ndtr((1.5 - across) / 0.6)


def exposed(light: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return pictures of 8 bits with noise."""
    noisy = light + rng.normal(0.0, NOISE, light.shape) * np.sqrt(light / BASE)
    return np.rint(noisy).clip(0, 255).astype(np.uint8)


def listed(places: np.ndarray, size: tuple[int, int], seen: Any = True) -> pd.DataFrame:
    """Return the truth of places (frames, n, 2) that are seen and in the picture."""
    frames, number = places.shape[:2]
    frame, particle = np.indices((frames, number))
    columns = {"frame": frame, "particle": particle}
    columns |= {"row": places[..., 0], "col": places[..., 1]}
    table = pd.DataFrame({name: each.ravel() for name, each in columns.items()})
    inside = table["row"].between(0, size[0] - 1) & table["col"].between(0, size[1] - 1)
    shown = np.broadcast_to(seen, (frames, number)).ravel()
    return table[inside & shown].reset_index(drop=True)


def spots(
    places: np.ndarray,
    size: tuple[int, int],
    sigma: float,
    light: Any,
    rng: np.random.Generator,
    ground: Any = BASE,
) -> np.ndarray:
    """Return a film of spots of some light, one value or (frames, n), on a ground."""
    frames, number = places.shape[:2]
    lights = np.broadcast_to(light, (frames, number))
    pictures = np.empty((frames, *size))
    pictures[:] = ground
    for picture, now, heights in zip(pictures, places, lights, strict=True):
        for place, height in zip(now, heights, strict=True):
            if height:
                spot(picture, place, sigma, height)
    return exposed(pictures, rng)


def bead(rng: np.random.Generator) -> Film:
    """Make one bead that diffuses."""
    size = (96, 96)
    places = walked(np.array([[48.0, 48.0]]), 400, 0.2, (0.0, 0.0), rng)
    pictures = spots(places, size, 2.0, 80.0, rng)
    return Film(pictures, listed(places, size), "one bead diffuses", {}, 0.2)


def colloids(rng: np.random.Generator) -> Film:
    """Make sixty particles that diffuse and drift."""
    size = (256, 256)
    start = starts(60, size, 18.0, rng)
    places = walked(start, 80, 0.25, (0.1, 0.2), rng)
    pictures = spots(places, size, 1.8, 60.0, rng)
    return Film(pictures, listed(places, size), "colloids diffuse, and drift", {}, 0.25)


def molecules(rng: np.random.Generator) -> Film:
    """Make single molecules, smaller than a pixel, that vanish for good."""
    size = (160, 160)
    start = starts(50, size, 12.0, rng)
    places = walked(start, 60, 0.05, (0.0, 0.0), rng)
    lives = rng.exponential(40.0, len(start)) + 5
    seen = np.arange(60)[:, None] < lives
    pictures = spots(places, size, 0.8, np.where(seen, 40.0, 0.0), rng)
    truth = listed(places, size, seen)
    return Film(pictures, truth, "molecules smaller than a pixel vanish", {}, 0.05)


def rods(rng: np.random.Generator) -> Film:
    """Make rods that move and turn."""
    size = (200, 260)
    start = starts(14, size, 34.0, rng)
    places = walked(start, 30, 0.05, (0.0, 1.5), rng)
    angle = rng.uniform(0, np.pi, 14) + 0.1 * np.arange(30)[:, None]
    pictures = np.full((30, *size), BASE)
    for picture, now, angles in zip(pictures, places, angle, strict=True):
        for place, turned in zip(now, angles, strict=True):
            rod(picture, place, turned, 60.0)
    truth = listed(places, size)
    options = {"detector": "otsu"}
    return Film(exposed(pictures, rng), truth, "rods move and turn", options)


def flow(rng: np.random.Generator) -> Film:
    """Make a dense flow whose steps are longer than half the distance of neighbours."""
    size = (240, 240)
    start = starts(150, (240, 320), 12.0, rng) - (0, 80)
    places = walked(start, 12, 0.05, (0.0, 9.0), rng)
    pictures = spots(places, size, 1.3, 80.0, rng)
    return Film(pictures, listed(places, size), "a dense flow", {})


def bleaching(rng: np.random.Generator) -> Film:
    """Make particles that fade to a quarter of their light."""
    size = (200, 200)
    start = starts(40, size, 18.0, rng)
    places = walked(start, 60, 0.15, (0.0, 0.0), rng)
    light = 80.0 * np.exp(-np.arange(60) / 43.0)[:, None]
    pictures = spots(places, size, 1.8, light, rng)
    return Film(pictures, listed(places, size), "particles fade", {}, 0.15)


def dark(rng: np.random.Generator) -> Film:
    """Make dark particles on a bright, uneven ground."""
    size = (200, 200)
    start = starts(30, size, 20.0, rng)
    places = walked(start, 40, 0.1, (0.5, 1.0), rng)
    ground = 170.0 + 40.0 * np.cos(np.linspace(0, 3, size[0]))[:, None]
    pictures = spots(places, size, 2.0, -60.0, rng, ground)
    truth = listed(places, size)
    return Film(pictures, truth, "dark on bright, uneven ground", {"dark": True})


def shaking(rng: np.random.Generator) -> Film:
    """Make particles that move before a textured ground; camera and all shake."""
    size = (200, 200)
    start = starts(30, size, 20.0, rng)
    shake = rng.normal(0.0, 1.5, (40, 2))
    places = walked(start, 40, 0.05, (0.3, 1.2), rng) + shake[:, None]
    ground = gaussian_filter(rng.normal(0, 1, (240, 240)), 3.0)
    ground *= 8.0 / ground.std()
    grid = np.indices(size)
    pictures = np.stack(
        [
            BASE + map_coordinates(ground, grid + 20.0 - off[:, None, None], order=3)
            for off in shake
        ]
    )
    film = spots(places, size, 1.8, 60.0, rng, pictures)
    return Film(film, listed(places, size), "the camera shakes", {})


KINDS: dict[str, Callable[[np.random.Generator], Film]] = {
    "bead": bead,
    "colloids": colloids,
    "molecules": molecules,
    "rods": rods,
    "flow": flow,
    "bleaching": bleaching,
    "dark": dark,
    "shaking": shaking,
}


def made(kind: str, seed: int = 0) -> Film:
    """Return a film of a kind; the same seed gives the same film."""
    return KINDS[kind](np.random.default_rng([seed, [*KINDS].index(kind)]))
