"""What the grey values of an area say: how many peaks, and whether anything moved (chapter 3.1).

The thesis counts local grey-value peaks on the frame, and looks for peaks or troughs on the
frame and on the absolute difference to the frame before, without saying what counts as one.
Here both pictures are smoothed a little and a peak must stand out from the noise, which is
measured on the frame itself; so nothing depends on the exposure.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import numpy.typing as npt

from kilnflight.checks import InputError
from kilnflight.detection.peaks import find_peaks, have_peaks

Float32 = npt.NDArray[np.float32]
SMOOTHING_PX = 1.0  # standard deviation of the Gaussian; smaller than any visible particle
SAMPLES = 140_000  # pixels that measure the noise, to 0.3 % of it
LEAST_NOISE = 0.5  # grey values; rounding to whole ones leaves so much


@dataclass(frozen=True)
class Evidence:
    """The two pictures and what stands out in them."""

    gray: Float32  # (rows, cols), smoothed
    change: Float32  # (rows, cols), absolute difference to the frame before, smoothed
    threshold: float  # grey values by which a peak stands out in `gray`
    change_threshold: float  # and in `change`
    share: float  # of the highest peak, for the second

    @classmethod
    def of(
        cls,
        gray: npt.NDArray[np.generic],
        previous: npt.NDArray[np.generic],
        prominence: float,
        share: float,
    ) -> Evidence:
        """Return the evidence of a frame.

        Parameters
        ----------
        gray, previous
            (rows, cols) of the frame and of the one before.
        prominence
            By how many times the noise a peak must stand out.
        share
            By which share of the highest peak of an area a second one must stand out.

        Notes
        -----
        Noise is the median absolute deviation of the smoothed difference of the two frames,
        times 1.4826; that of one frame is smaller by the square root of 2. The difference is
        smoothed before its absolute value is taken, so that noise averages out.
        """
        if gray.shape != previous.shape:
            raise InputError(
                f"frame of {gray.shape} after one of {previous.shape}: all frames of a "
                "recording have one size."
            )
        now, before = _smoothed(gray), _smoothed(previous)
        flat = slice(None, None, max(now.size // SAMPLES, 1) | 1)  # odd: no column twice
        some = now.reshape(-1)[flat] - before.reshape(-1)[flat]
        spread = float(np.median(np.abs(some - np.median(some))))
        noise = max(1.4826 * spread, LEAST_NOISE)
        needed = prominence * noise
        moved = np.asarray(cv2.absdiff(now, before), dtype=np.float32)
        return cls(now, moved, needed / np.sqrt(2.0), needed, share)

    def peaks(self, area: npt.NDArray[np.integer]) -> npt.NDArray[np.float64]:
        """Return the peaks (k, 3) of the frame in an area (4,), highest first."""
        _, found = find_peaks(self.gray, area[None], self.threshold)
        return found[found[:, 2] >= self.share * found[:, 2].max(initial=0.0)]

    def moved(self, areas: npt.NDArray[np.integer]) -> npt.NDArray[np.bool_]:
        """Return in which areas (n, 4) something has changed; nothing else can be `real`."""
        return have_peaks(self.change, areas, self.change_threshold)

    def real(self, area: npt.NDArray[np.integer]) -> bool:
        """Return whether something stands out in the frame and has changed there."""
        if not self.moved(area[None]).any():
            return False
        inside = _cut(self.gray, area)
        whole = np.array([[0, inside.shape[0], 0, inside.shape[1]]])
        return any(len(find_peaks(sign * inside, whole, self.threshold)[1]) for sign in (1, -1))


def _smoothed(image: npt.NDArray[np.generic]) -> Float32:
    """Return a frame blurred by a Gaussian of `SMOOTHING_PX`, cut at four of it."""
    taps = cv2.getGaussianKernel(2 * round(4 * SMOOTHING_PX) + 1, SMOOTHING_PX, cv2.CV_32F)
    blurred = cv2.sepFilter2D(image.astype(np.float32), cv2.CV_32F, taps, taps)
    return np.asarray(blurred, dtype=np.float32)


def _cut(image: Float32, area: npt.NDArray[np.integer]) -> Float32:
    top, bottom, left, right = (int(edge) for edge in np.maximum(area, 0))
    return image[top:bottom, left:right]
