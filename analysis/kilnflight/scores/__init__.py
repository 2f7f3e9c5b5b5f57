"""Scores of detections, tracks and flights against the truth.

==================  ==============  ===========================================  =============
call                equation        result                                       source
==================  ==============  ===========================================  =============
`score_detections`  3.1 to 3.4      detections that are particles, by a gate     sec.
3.3 `score_in_pixels`   3.1 to 3.3      the same, by the particles' labelled pixels
sec. 5.1.1 `count_in_air`      3.1 to 3.3      detections classified as in the air
sec. 5.1.4 `rates`             3.1 to 3.3      counts -> precision, recall, F1
sec. 3.3 `score_tracks`      5.1 to 5.7      alpha, beta, JSC, JSC_theta of tracks
sec. 5.2.2
==================  ==============  ===========================================  =============
"""

from kilnflight.scores.detections import (
    count_in_air,
    rates,
    score_detections,
    score_in_pixels,
)
from kilnflight.scores.tracks import score_tracks

__all__ = [
    "count_in_air",
    "rates",
    "score_detections",
    "score_in_pixels",
    "score_tracks",
]
