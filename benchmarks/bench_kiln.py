"""Whole detection of a full frame against the off-the-shelf assembly, rendering excluded.

The assembly is numpy's median over 150 frames, OpenCV's SIFT on 8 bits and scikit-learn's
DBSCAN for both passes; it decides no cases. Checked here: with numpy's median and
scikit-learn's clusters in place of ours the table of detections is the same. Keypoints are
held against OpenCV's in the tests, where both see 8 bits: its SIFT takes no others.
"""

from __future__ import annotations

import time
from dataclasses import dataclass

import cv2
import numpy as np
import pandas as pd
from measure import Row, compare
from sklearn import cluster

from kilnflight import kiln
from kilnflight.background import Median
from kilnflight.detection import DoG
from kilnflight.detection.combination import Combination, second_pass
from kilnflight.recording.frames import Attributes, Frame
from kilnflight.twin.scenes import open_scene

THRESHOLD = 283.0  # what notebook 21 finds for V1 and most subsets
STEPS = ("background", "calibration, flame", "DoG", "clustering", "smoothing", "evidence, cases")
WANTED = range(60, 124)  # consecutive, as in a campaign: the median's work is shared


@dataclass
class Held:
    """A recording in memory."""

    attributes: Attributes
    grays: list[np.ndarray]
    frames: dict[int, Frame]

    def __len__(self) -> int:
        return len(self.grays)

    def gray(self, t: int) -> np.ndarray:
        return self.grays[t]

    def frame(self, t: int) -> Frame:
        return self.frames[t]


def held() -> Held:
    """Return subset V1 with the clouds of the wanted frames and of the one before."""
    twin = open_scene("V1")
    grays = [twin.gray(t) for t in range(len(twin))]
    frames = {t: twin.frame(t) for t in (0, WANTED.start - 1, *WANTED)}
    return Held(twin.attributes, grays, frames)


def both_passes(xyz: np.ndarray) -> np.ndarray:
    """Cluster as scikit-learn does, wall first."""
    first = cluster.DBSCAN(eps=50.0, min_samples=10).fit_predict(xyz)
    rest = first != np.bincount(first[first >= 0]).argmax()
    labels = np.full(len(xyz), -1, dtype=np.intp)
    labels[rest] = cluster.DBSCAN(eps=15.0, min_samples=10).fit_predict(xyz[rest])
    return labels


def steps() -> pd.DataFrame:
    """Return the share of each step of our detection in the time of a frame, in percent."""
    recording, detector = held(), Combination(DoG(THRESHOLD))
    roi, spent = recording.attributes.roi, dict.fromkeys(STEPS, 0.0)
    cv2.setNumThreads(1)
    kiln.detect_frames(recording, WANTED[:2], detector)  # compiles
    start = time.perf_counter()
    for _ in Median()(kiln.FrameBuffer(recording), WANTED):
        pass
    spent["background"] = time.perf_counter() - start
    start = time.perf_counter()
    for _, view in kiln.views(recording, WANTED):
        clock = [start, time.perf_counter()]
        keypoints = detector.detector(view.foreground, roi)
        clock.append(time.perf_counter())
        labels = second_pass(view.xyz, detector.wall, detector.clusterer)
        clock.append(time.perf_counter())
        view.smooth(view.gray)  # that of the frame before is kept
        clock.append(time.perf_counter())
        detector.decide(view, keypoints, labels, roi)
        clock.append(time.perf_counter())
        for step, seconds in zip(STEPS[1:], np.diff(clock), strict=True):
            spent[step] += seconds
        start = time.perf_counter()
    spent["calibration, flame"] -= spent["background"]
    table = pd.DataFrame(spent.items(), columns=["step", "share_percent"])
    table["share_percent"] *= 100 / table["share_percent"].sum()
    return table.round(0)


def rows() -> list[Row]:
    """Return the comparison; ours is the mean of 64 consecutive frames."""
    recording = held()
    wanted = list(WANTED)
    roi = recording.attributes.roi
    detector = Combination(DoG(THRESHOLD))
    t, view = next(kiln.views(recording, [80]))  # with 75 frames before and after
    window = np.stack([recording.gray(k) for k in range(t - 75, t + 76) if k != t])
    plain = np.maximum(recording.gray(t) - np.median(window, axis=0), 0).astype(np.float32)
    ours = next(iter(Median()(kiln.FrameBuffer(recording), [t])))
    np.testing.assert_array_equal(ours, plain)
    keypoints, labels = DoG(THRESHOLD)(view.foreground), both_passes(view.xyz)
    pd.testing.assert_frame_equal(
        kiln.detect_frames(recording, [t], detector),
        detector.decide(view, keypoints, labels, roi, t),
    )
    bytes_8 = np.rint(view.foreground / 257).astype(np.uint8)
    sift = cv2.SIFT_create(contrastThreshold=3 * THRESHOLD / 65_535)
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)

    def assembly() -> None:
        np.median(window, axis=0)
        sift.detect(bytes_8)
        both_passes(view.xyz)

    what = ("combined detection, one frame", "frames", 1, "numpy, OpenCV and scikit-learn")
    row = compare(
        what,
        lambda: kiln.detect_frames(recording, wanted, detector),
        assembly,
        share=1 / len(wanted),
    )
    cv2.setNumThreads(threads)
    return [row]
