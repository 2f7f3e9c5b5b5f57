"""Whole detection of a full frame against the off-the-shelf assembly, rendering
excluded.

The assembly is numpy's median over 150 frames, OpenCV's SIFT on 8 bits and
scikit-learn's DBSCAN for both passes; it decides no cases. Checked here: with numpy's
median and scikit-learn's clusters in place of ours the table of detections is the same.
Keypoints are held against OpenCV's in `bench_detection_2d`, where both see 8 bits: its
SIFT takes no others.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np
import pandas as pd
from measure import Row, compare, seconds
from sklearn import cluster

from kilnflight import chain
from kilnflight.background import Median
from kilnflight.detection import DoG
from kilnflight.detection.combination import Combination, View, second_pass
from kilnflight.recording.buffer import FrameBuffer
from kilnflight.recording.frames import Attributes, Frame
from kilnflight.simulated.kiln.scenes import open_scene

THRESHOLD = (
    100.0  # grey values; found for most subsets (Table 5.6), and taken for campaigns
)
STEPS = (
    "background",
    "calibration, flame",
    "DoG",
    "clustering",
    "smoothing",
    "evidence, cases",
)
WANTED = range(1000, 1064)
AROUND = 75  # consecutive; each has a window of its own for the median
SCENE = "paper-shred-4.5-bar"
SHOWN = 1032  # the frame that the peer detects in


@dataclass
class Held:
    """Some frames of a recording, in memory."""

    attributes: Attributes
    length: int
    grays: dict[int, np.ndarray]
    frames: dict[int, Frame]

    def __len__(self) -> int:
        return self.length

    def gray(self, t: int) -> np.ndarray:
        return self.grays[t]

    def frame(self, t: int) -> Frame:
        return self.frames[t]


def held() -> Held:
    """Return a campaign with the clouds of the wanted frames and the pictures
    around.
    """
    twin = open_scene(SCENE)
    around = range(WANTED.start - AROUND, WANTED.stop + AROUND)
    frames = {t: twin.frame(t) for t in (0, WANTED.start - 1, *WANTED)}
    return Held(twin.attributes, len(twin), {t: twin.gray(t) for t in around}, frames)


def both_passes(xyz: np.ndarray) -> np.ndarray:
    """Cluster as scikit-learn does, wall first."""
    first = cluster.DBSCAN(eps=50.0, min_samples=10).fit_predict(xyz)
    rest = first != np.bincount(first[first >= 0]).argmax()
    labels = np.full(len(xyz), -1, dtype=np.intp)
    labels[rest] = cluster.DBSCAN(eps=15.0, min_samples=10).fit_predict(xyz[rest])
    return labels


def assembly(recording: Held, view: View) -> dict[str, Callable[[], object]]:
    """Return the calls of the peer, by the step of ours that does the like."""
    low = np.floor(recording.attributes.roi).min(0)
    high = np.ceil(recording.attributes.roi).max(0)
    (top, left), (bottom, right) = np.maximum(low, 0).astype(int), high.astype(int) + 1
    bytes_8 = np.rint(view.foreground[top:bottom, left:right] / 257).astype(np.uint8)
    sift = cv2.SIFT_create(contrastThreshold=3 * THRESHOLD / 65_535)
    return {
        "background": partial(np.median, window(recording), axis=0),
        "DoG": partial(sift.detect, bytes_8),
        "clustering": partial(both_passes, view.xyz),
    }


def window(recording: Held) -> np.ndarray:
    """Return the pictures of the median's window of frame `SHOWN`."""
    around = range(SHOWN - AROUND, SHOWN + AROUND + 1)
    return np.stack([recording.gray(t) for t in around if t != SHOWN])


def bytes_per_s() -> float:
    """Return how many bytes a copy of large arrays reads and writes in a second."""
    source = np.ones(2**25)
    target = np.zeros_like(source)
    return 2 * source.nbytes / seconds(lambda: np.copyto(target, source))


def touched(view: View, keypoints: np.ndarray, labels: np.ndarray) -> dict[str, int]:
    """Return the bytes that each step has to read and to write, each once.

    Pictures are read whole, but for the evidence: it needs their pixels near clusters
    and keypoints, which are no more than the points in clusters.
    """
    points = view.xyz.nbytes + view.pixels.nbytes
    clustered = np.count_nonzero(labels >= 0)
    return {
        "background": view.gray.nbytes + view.foreground.nbytes,
        "calibration, flame": 2 * points,
        "DoG": view.foreground.nbytes + keypoints.nbytes,
        "clustering": view.xyz.nbytes + labels.nbytes,
        "smoothing": view.gray.nbytes + view.foreground.nbytes,
        "evidence, cases": 2 * 4 * clustered + keypoints.nbytes,
    }


def steps() -> pd.DataFrame:
    """Return time and limit of each step in ms, and its share in percent.

    The limit is the time in which memory gives what a step reads, and takes what it
    writes. Shares are those of a frame, ours and the peer's.
    """
    recording = held()
    detector = Combination(DoG(THRESHOLD))
    roi = recording.attributes.roi
    spent = dict.fromkeys(STEPS, 0.0)
    cv2.setNumThreads(1)
    chain.detect_frames(recording, WANTED, detector)  # compiles, and fills memory
    start = time.perf_counter()
    for _ in Median()(FrameBuffer(recording), WANTED):
        pass
    spent["background"] = time.perf_counter() - start
    start = time.perf_counter()
    for _, view in chain.views(recording, WANTED):
        clock = [start, time.perf_counter()]
        keypoints = detector.detector(view.foreground, roi)
        clock.append(time.perf_counter())
        labels = second_pass(view.xyz, detector.wall, detector.clusterer)
        clock.append(time.perf_counter())
        view.smooth(view.gray)  # that of the frame before is kept
        clock.append(time.perf_counter())
        detector.decide(view, keypoints, labels, roi)
        clock.append(time.perf_counter())
        for step, passed in zip(STEPS[1:], np.diff(clock), strict=True):
            spent[step] += passed
        start = time.perf_counter()
    spent["calibration, flame"] -= spent["background"]
    _, view = next(chain.views(recording, [SHOWN]))
    peer = {step: seconds(call) for step, call in assembly(recording, view).items()}
    table = pd.DataFrame({"ours_percent": spent, "peer_percent": peer}, index=STEPS)
    table = 100 * table / table.sum()
    table.insert(0, "ours_ms", 1000 * pd.Series(spent) / len(WANTED))
    most = touched(view, keypoints, labels)
    table.insert(1, "limit_ms", 1000 * pd.Series(most) / bytes_per_s())
    return table.round(1).rename_axis("step").reset_index()


def rows() -> list[Row]:
    """Return the comparison; ours is the mean of 64 consecutive frames, the peer has
    one.
    """
    recording = held()
    detector = Combination(DoG(THRESHOLD))
    _, view = next(chain.views(recording, [SHOWN]))
    plain = recording.gray(SHOWN) - np.median(window(recording), axis=0)
    ours = next(iter(Median()(FrameBuffer(recording), [SHOWN])))
    np.testing.assert_array_equal(ours, np.maximum(plain, 0).astype(np.float32))
    keypoints = DoG(THRESHOLD)(view.foreground)
    labels = both_passes(view.xyz)
    pd.testing.assert_frame_equal(
        chain.detect_frames(recording, [SHOWN], detector),
        detector.decide(view, keypoints, labels, recording.attributes.roi, SHOWN),
    )
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    calls = assembly(recording, view).values()
    row = compare(
        (
            "combined detection, one frame",
            "frames",
            1,
            "numpy, OpenCV and scikit-learn",
        ),
        lambda: chain.detect_frames(recording, WANTED, detector),
        lambda: [call() for call in calls],
        share=1 / len(WANTED),
    )
    cv2.setNumThreads(threads)
    return [row]
