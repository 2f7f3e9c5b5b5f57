"""Particles as extrema of differences of Gaussians: the keypoints of SIFT (section 2.2.3).

The thesis uses position and scale of a keypoint only, so the orientation and the
descriptor (Eqs 2.29 ff.) are not computed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt
from scipy.ndimage import find_objects, label

from kilnflight.checks import InputError, check_at_least, check_count, check_positive
from kilnflight.detection import extrema, scale_space
from kilnflight.detection.foreground import check_foreground

Array = npt.NDArray[np.float64]
Polygon = Sequence[tuple[float, float]]

TILE = 12  # largest side, in blocks, of the boxes that are blurred at a time
WALK = extrema.FITS  # px around a sample at which a fit that moves may look
SMALLEST_SIDE = 3  # an extremum has a neighbour on each side


@dataclass(frozen=True)
class DoG:
    """SIFT keypoints: blobs brighter than their surroundings, with position and size.

    Parameters
    ----------
    threshold
        Smallest difference of Gaussians at the interpolated maximum, in grey values
        (Eq. 2.27; "local maximum of DoG" of Tables 5.6 and 5.7).
    layers
        Scales per octave at which maxima are looked for; k of Eq. 2.23 is 2^(1/layers).
    sigma
        Blur of the first scale of an octave, in px of the octave.
    edge
        Largest ratio of the curvatures across a blob, r of Eq. 2.28.
    camera_blur
        Blur that the image is taken to have, in px.
    double
        Whether a first octave of the image at twice its size comes before the others;
        it finds blobs with a radius from about 1.4 px instead of 2.8 px.
    dark
        Whether minima (blobs darker than their surroundings) are particles, too.

    Notes
    -----
    The difference is taken as the narrow minus the wide Gaussian, the negative of
    Eq. 2.23, so that a bright blob is the "local maximum" by which the thesis calls its
    parameter. The text looks for minima, too; in |frame - background|, where every
    particle is bright, they are gaps between particles, hence ``dark=False``.

    The threshold applies to the difference itself: it is neither divided by the number
    of layers (as OpenCV does) nor scaled by the grey values' range. A sample below half
    of it is not followed, as in OpenCV.

    The thesis starts from the original image; Lowe doubles it first (``double=True``).

    The radius is the one of the uniform disc that answers most strongly at the
    keypoint's scale s, that is, the zero of the difference of Gaussians:
    s k sqrt(2 ln(k^2) / (k^2 - 1)), 1.58 s. For a Gaussian blob it is the square root
    of 2 times its standard deviation. The thesis does not say how it draws its circles.

    References
    ----------
    Thesis, Eqs 2.21-2.28; Lowe 2004 ([66] of the thesis), sections 3 and 4, for 3
    layers, 1.6 px, camera blur 0.5 px and r = 10.
    """

    threshold: float = 500.0  # grey values; empirical value of section 5.1.2
    layers: int = 3
    sigma: float = 1.6  # px
    edge: float = 10.0
    camera_blur: float = 0.5  # px
    double: bool = False
    dark: bool = False

    def __post_init__(self) -> None:
        """Refuse parameters with which the equations have no meaning."""
        check_at_least(self.threshold, 0, "DoG threshold")
        check_count(self.layers, "DoG layers")
        check_positive(self.sigma, "DoG sigma")
        check_at_least(self.edge, 1, "DoG edge, a ratio of curvatures,")
        blur = self.camera_blur * (2 if self.double else 1)
        if not 0 <= blur <= self.sigma:
            raise InputError(
                f"DoG camera_blur: the image would have a blur of {blur} px, the first scale "
                f"{self.sigma} px; take a camera_blur from 0 to that."
            )

    def __call__(self, foreground: npt.NDArray[np.generic], within: Polygon | None = None) -> Array:
        """Return the particles in a foreground.

        Parameters
        ----------
        foreground
            (rows, cols) grey values: unsigned or signed integers (16 bits; 8 bits are
            taken as the grey values they hold) or floats, computed in float32.
        within
            Corners (row, col) of a polygon. All particles in it are found; most of those
            outside are not looked for, which saves time.

        Returns
        -------
        ndarray
            (n, 3) row, col, radius in px, by octave, row and column. None in a foreground
            of one grey value. A saturated plateau is one blob with the size of the plateau.

        Raises
        ------
        InputError
            If the foreground is not 2D, not of numbers or not finite.

        Examples
        --------
        What a camera of 8 bits would have left of a blob of 120 grey values:

        >>> at = np.arange(64.0)
        >>> slope = np.exp(-((at - 30) ** 2) / 32)
        >>> faint = 120 * np.outer(slope, slope)
        >>> len(DoG(10)(faint)), len(DoG(10)(np.rint(faint / 257) * 257))
        (1, 0)
        """
        return self.graded(foreground, within)[:, :3]

    def graded(self, foreground: npt.NDArray[np.generic], within: Polygon | None = None) -> Array:
        """Return the particles (n, 4) with the largest threshold at which each is found.

        So the particles at any higher threshold are the rows whose last value is not below
        it, to the bit: one look at a foreground answers for a whole sweep.

        Parameters
        ----------
        foreground, within
            As of a call.
        """
        image = check_foreground(foreground, "DoG").astype(np.float32, copy=False)
        found, spacing = [np.empty((0, 4))], 1.0
        if image.size and self.double:
            blur = 2 * self.camera_blur
            found.append(self._octave(scale_space.doubled(image), blur, 0.5, within))
            image = scale_space.smooth_doubled(image, math.sqrt(4 * self.sigma**2 - blur**2))
        elif image.size:
            image = scale_space.smooth(image, math.sqrt(self.sigma**2 - self.camera_blur**2))
        while min(image.shape) >= SMALLEST_SIDE:
            found.append(self._octave(image, self.sigma, spacing, within))
            image = scale_space.smooth(image, self.sigma * math.sqrt(3.0), step=2)
            spacing *= 2
        return np.concatenate(found)

    def _octave(
        self, image: scale_space.Image, blur: float, spacing: float, within: Polygon | None
    ) -> Array:
        """Return row, col, radius in px and highest threshold of the keypoints of an octave.

        Parameters
        ----------
        image
            Image from which the Gaussians of the octave are made.
        blur
            Its own blur, in its px.
        spacing
            Its px in px of the foreground.
        within
            As of a call.
        """
        sigmas = self.sigma * 2.0 ** (np.arange(self.layers + 3) / self.layers)
        taps = tuple(scale_space.gaussian_taps(s) for s in np.sqrt(sigmas**2 - blur**2))
        signs = (1.0, -1.0) if self.dark else (1.0,)
        live = scale_space.reachable(image, taps, self.threshold / 2, signs)
        if within is not None:
            live &= _near(within, live.shape, scale_space.BLOCK * spacing)
        found = [np.empty((0, 7))]
        for start in _boxes(live, image.shape):
            box, inside, visit = _around(start, image.shape)
            stack = scale_space.differences(image, box, taps)
            points = extrema.keypoints(stack, inside, visit, self.threshold, self.edge, signs)
            points[:, 1:3] += box[0], box[2]
            found.append(points)
        points = np.concatenate(found)
        # Two maxima may lead to one sample, at which the fit is the same; the higher counts.
        points = points[np.argsort(-points[:, 6], kind="stable")]
        points = points[np.unique(points[:, [1, 2, 0]], axis=0, return_index=True)[1]]
        scale = self.sigma * 2.0 ** ((points[:, 0] + points[:, 3]) / self.layers)
        place = points[:, 1:3] + points[:, 4:6]
        radius = scale * disc_radius(self.layers)
        return np.column_stack([place * spacing, radius * spacing, points[:, 6]])


def disc_radius(layers: int) -> float:
    """Return the radius of the disc that answers most at scale 1: the kernel's zero.

    Examples
    --------
    >>> round(disc_radius(3), 2)
    1.58
    """
    k = 2.0 ** (1.0 / layers)
    return k * math.sqrt(2.0 * math.log(k**2) / (k**2 - 1.0))


def _boxes(live: npt.NDArray[np.bool_], shape: tuple[int, ...]) -> list[scale_space.Box]:
    """Return boxes around connected live blocks, cut to tiles, without the image's border."""
    boxes = []
    for rows, cols in find_objects(label(live)[0]):
        for i in range(rows.start, rows.stop, TILE):
            for j in range(cols.start, cols.stop, TILE):
                below, right = min(i + TILE, rows.stop), min(j + TILE, cols.stop)
                if live[i:below, j:right].any():
                    box = [corner * scale_space.BLOCK for corner in (i, below, j, right)]
                    start, end = max(box[0], 1), max(box[2], 1)
                    boxes.append((start, min(box[1], shape[0] - 1), end, min(box[3], shape[1] - 1)))
    return boxes


def _near(polygon: Polygon, shape: tuple[int, ...], side: float) -> npt.NDArray[np.bool_]:
    """Return the blocks of ``side`` px from which a particle in a polygon can be found.

    The polygon is drawn on the blocks with its border; what a fit may move by, and what is
    rounded, is less than the two blocks that are added on every side.
    """
    corners = np.floor(np.asarray(polygon, dtype=np.float64)[:, ::-1] / side).astype(np.int32)
    drawn = cv2.fillPoly(np.zeros(shape, dtype=np.uint8), [corners], 1)
    return np.asarray(cv2.dilate(drawn, np.ones((5, 5), dtype=np.uint8)) > 0)


def _around(
    start: scale_space.Box, shape: tuple[int, ...]
) -> tuple[scale_space.Box, scale_space.Box, scale_space.Box]:
    """Return the box that is blurred for a start, and start and visitable box within it."""
    top, bottom, left, right = start
    box = (
        max(top - WALK, 0),
        min(bottom + WALK, shape[0]),
        max(left - WALK, 0),
        min(right + WALK, shape[1]),
    )
    inside = (top - box[0], bottom - box[0], left - box[2], right - box[2])
    return box, inside, (1, box[1] - box[0] - 1, 1, box[3] - box[2] - 1)
