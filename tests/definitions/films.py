"""Simulated films of particles, with the truth; they stay apart and inside the
picture.
"""

import numpy as np
import pandas as pd
from scipy.ndimage import gaussian_filter, shift

MARGIN = 14  # px without particles
# height 1 over distances in px: from the centre, along, across; s: size in px
SHAPES = {
    "spot": lambda far, along, across, s: np.exp(-(far**2) / (2 * s**2)),
    "disc": lambda far, along, across, s: edge(far, s),
    "ring": lambda far, along, across, s: np.exp(-((far - s) ** 2) / (2 * 0.9**2)),
    "rod": lambda far, along, across, s: (
        edge(abs(along), s[0] / 2) * edge(abs(across), s[1] / 2)
    ),
}


def edge(distance, radius):
    return 1 / (1 + np.exp((distance - radius) / 0.4))


def film(
    kind="spot",
    size=2.0,
    amplitude=60.0,
    frames=25,
    cells=(4, 5),
    pitch=24,
    drift=(0.0, 3.0),
    diffusion=0.0,
    noise=1.0,
    base=100.0,
    flicker=0.0,
    texture=0.0,
    shake=0.0,
    dtype=np.uint8,
):
    """Return pictures (frames, rows, cols) and the truth: frame, row, col, particle.

    One particle starts in each cell of a grid; all drift alike and come in again on the
    other side. ``size``: sigma of a spot, radius of a disc or ring, length and width of
    a rod. ``diffusion`` is in px^2 a frame, ``flicker`` a share of the light,
    ``texture`` the contrast of the ground, which moves by ``shake`` px; both are
    standard deviations.
    """
    rng, room = np.random.default_rng(7), np.array(cells) * pitch
    start = (np.indices(cells).reshape(2, -1).T + 0.5) * pitch
    start += rng.uniform(-3, 3, start.shape)
    walk = rng.normal(0, np.sqrt(2 * diffusion), (frames, *start.shape)).cumsum(axis=0)
    walk += np.arange(frames)[:, None, None] * np.array(drift)
    pictures = np.empty((frames, *room + 2 * MARGIN))
    ground = gaussian_filter(rng.normal(0, 1, pictures[0].shape), 3.0)
    ground *= texture / ground.std()
    angles, truth = rng.uniform(0, np.pi, len(start)), []
    for t, picture in enumerate(pictures):
        picture[:] = base + shift(ground, rng.normal(0, shake, 2), mode="reflect")
        for k, place in enumerate((start + walk[t]) % room + MARGIN):
            top, left = corner = place.astype(int) - MARGIN + 1
            y, x = np.indices((2 * MARGIN - 1,) * 2) + (corner - place)[:, None, None]
            sin, cos = np.sin(angles[k]), np.cos(angles[k])
            along, across = cos * x + sin * y, cos * y - sin * x
            part = picture[top : top + len(y), left : left + len(x)]
            part += amplitude * SHAPES[kind](np.hypot(x, y), along, across, size)
            truth.append((t, *place, k))
        picture *= 1 + flicker * rng.normal()
    pictures = np.rint(pictures + rng.normal(0, noise, pictures.shape))
    pictures = pictures.clip(0, np.iinfo(dtype).max).astype(dtype)
    return pictures, pd.DataFrame(truth, columns=["frame", "row", "col", "particle"])
