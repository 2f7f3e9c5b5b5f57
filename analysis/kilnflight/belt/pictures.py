"""Measure spots in pictures of particles on the belt (2016 paper, II.B, IV.B).

They are connected areas that differ from the background, with places in mm.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import cv2
import numpy as np
from pandas import DataFrame

from kilnflight.arrays import Array, Integers, Picture
from kilnflight.belt.camera import TRACKED, Area, Calibration, check_picture
from kilnflight.checks import InputError, NotNegative, Settings, Unlimited
from kilnflight.tables import BELT_SPOTS

MARGIN_MM = 10.0  # more than the longest particle's half, so that none is cut
TOUCHING_FROM = 1.5  # areas of a single particle: half-way between one and two
LEAST_PX = 12.0  # smaller spots are noise: a disc of 1.7 mm across; not printed
MOST_PARTS = 8  # a larger spot is left whole: these are not particles; choice


def average(pictures: Iterable[Picture]) -> Picture:
    """Return the mean of pictures (rows, cols), the background (section II.B).

    A particle that rests in all of them is part of the background and never found. One
    that rests in a share s of the pictures has s times its contrast c in the mean. By
    the threshold t of `Spots` it is found while it lies if (1 - s) c > t. Afterwards
    its place is found as a ghost, which never moves, if s c > t. For wood on a dark
    belt c is 140 and t is 40 grey values: no ghost below s = 0.29, not found above s =
    0.71, both in between.
    """
    total = np.zeros((), np.uint32)
    count = 0
    for picture in pictures:
        count += 1
        check_picture(picture, f"pictures: number {count}", total.shape or None)
        total = total + picture
    if not count:
        raise InputError(
            "pictures: none to take the background from; give at least one."
        )
    return np.rint(total / count).astype(np.uint8)


class Spots(Settings):
    """Connected areas that differ from the background, as centroids.

    Particles that touch are one spot at their common centroid. Spots that are larger
    than 1.5 times a single particle are marked and kept. With ``split`` such a spot
    becomes as many as single areas fit into it: its pixels are clustered by place
    (k-means). The parts keep the mark.

    Parameters
    ----------
    threshold
        Grey values of 255, above any noise of a camera; not printed.
    single_px
        Area of one particle in px, from `calibrated`; inf marks none.
    split
        Whether to split spots of several particles; neither paper did.

    Notes
    -----
    Section II.B names connected components and centroids, neither threshold nor sizes.
    Its footnote 1 names particles that touch, but no remedy that was used. The number
    is by size, so no neck between the particles is needed, as a watershed would. Two
    cylinders side by side are cut across, though.
    """

    threshold: NotNegative = 40.0
    single_px: Unlimited = np.inf
    split: bool = False

    def __call__(self, picture: Picture, background: Picture) -> Array:
        """Return row, col, area in px and whether several touch (1.0 or 0.0), (n, 4).

        Rows and columns are those of the centroids. ``background`` (rows, cols) is from
        `average`, of the shape of ``picture``.
        """
        check_picture(picture, "picture", background.shape)
        pixels, spot = self._pixels(picture, background)
        area = np.bincount(spot).astype(float)
        places = [np.bincount(spot, along) / area for along in pixels.T]
        several = area > TOUCHING_FROM * self.single_px
        found = np.column_stack([*places, area, several])
        kept = area >= LEAST_PX
        if not self.split:
            return found[kept]
        number = np.rint(area / self.single_px)
        shared = kept & several & (number > 1) & (number <= MOST_PARTS)
        parts = [
            _parts(pixels[spot == k].astype(float), int(number[k]))
            for k in np.flatnonzero(shared)
        ]
        return np.concatenate([found[kept & ~shared], *parts])

    def _pixels(
        self, picture: Picture, background: Picture
    ) -> tuple[Integers, Integers]:
        """Return row and col (p, 2) of pixels in spots, and the spot of each (p,)."""
        differs = cv2.absdiff(picture, background)
        _, mask = cv2.threshold(differs, self.threshold, 255, cv2.THRESH_BINARY)
        _, labels = cv2.connectedComponentsWithAlgorithm(
            mask, 8, cv2.CV_32S, cv2.CCL_GRANA
        )
        # Few pixels are of spots: counting these takes a seventh of the time of
        # OpenCV's statistics of all of them.
        found = cv2.findNonZero(mask)
        if found is None:
            found = np.zeros((0, 2), np.int32)
        row, col = found.reshape(-1, 2).T[::-1]
        return np.column_stack([row, col]), labels[row, col] - 1

    def calibrated(self, pictures: Iterable[Picture], background: Picture) -> Self:
        """Return these spots with the median area of all as that of one particle.

        ``pictures`` show mostly particles that do not touch; ``background`` is from
        `average`.

        Raises
        ------
        InputError
            If there is no spot in any of the pictures.
        """
        areas = [self(picture, background)[:, 2] for picture in pictures]
        if not sum(map(len, areas)):
            raise InputError(
                "pictures: no particle to calibrate with; take some of a loaded belt."
            )
        return replace(self, single_px=float(np.median(np.concatenate(areas))))


def _parts(pixels: Array, number: int) -> Array:
    """Return a spot's pixels (p, 2) as ``number`` spots, by k-means.

    Columns (number, 4) are those of `Spots`: row, col, area, and the mark, 1.
    """
    # Loading it takes a second, and only splits need it.
    from sklearn.cluster import KMeans

    away = pixels - pixels.mean(axis=0)
    along = away @ np.linalg.svd(away, full_matrices=False)[2][0]
    # Starting from equal parts along the spot makes the result reproducible.
    first = np.searchsorted(np.quantile(along, np.arange(1, number) / number), along)
    start = np.array([pixels[first == k].mean(axis=0) for k in range(number)])
    found = KMeans(number, init=start, n_init=1).fit(pixels)
    area = np.bincount(found.labels_, minlength=number)
    return np.column_stack([found.cluster_centers_, area, np.ones(number)])


@dataclass(frozen=True)
class MeasureSpots:
    """Measure the spots of a picture in millimetres on the belt.

    Spots with their centroid in ``area`` are kept. Pictures are cut to it and a margin,
    which shows a particle at its border whole.

    Parameters
    ----------
    background
        (rows, cols), from `average`.
    spots
        From `Spots.calibrated`.
    calibration
        From `kilnflight.belt.camera.calibrate_camera`.
    area
        Part of the belt in which spots are kept.
    """

    background: Picture
    spots: Spots
    calibration: Calibration
    area: Area = TRACKED

    @cached_property
    def _window(self) -> tuple[slice, slice]:
        margin = MARGIN_MM / self.calibration.mm_per_px
        return self.calibration.window(self.area, margin, self.background.shape)

    @cached_property
    def _empty(self) -> Picture:
        return np.ascontiguousarray(self.background[self._window])

    def __call__(self, picture: Picture, frame: int = 0) -> Array:
        """Return row, col, area (px), touching, x and y (mm) of each spot, (n, 6).

        These are the columns of `kilnflight.tables.BELT_SPOTS` after the first.
        ``frame`` is named in the error for a ``picture`` of another shape or type.
        """
        check_picture(picture, f"picture of frame {frame}", self.background.shape)
        found = self.spots(picture[self._window], self._empty)
        found[:, :2] += self._window[0].start, self._window[1].start
        places = self.calibration.millimetres(found[:, :2])
        return np.column_stack([found, places])[self.area.contains(places)]

    def table(self, pictures: Iterable[Picture]) -> DataFrame:
        """Return the spots of consecutive pictures, frames 0, 1, ...

        Returns
        -------
        DataFrame
            `kilnflight.tables.BELT_SPOTS`; no rows for an empty belt.
        """
        rows = [np.empty((0, len(BELT_SPOTS.names)))]
        for frame, picture in enumerate(pictures):
            rows.append(np.insert(self(picture, frame), 0, frame, axis=1))
        table = DataFrame(np.concatenate(rows), columns=BELT_SPOTS.names)
        return table.astype(BELT_SPOTS.dtypes)
