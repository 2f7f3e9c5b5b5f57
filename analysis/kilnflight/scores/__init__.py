"""Scores of detections, tracks and flights against the truth.

==================  ===========  ============================================
call                equation     result
==================  ===========  ============================================
`score_detections`  3.1 to 3.4   detections that are particles, by a gate
`score_in_pixels`   sec. 5.1.1   the same, by the particles' labelled pixels
`rates`             3.1 to 3.3   counts -> precision, recall, F1
`score_tracks`      5.1 to 5.7   alpha, beta, JSC, JSC_theta, HOTA, MOTA of tracks
==================  ===========  ============================================
"""

from kilnflight.scores.detections import (
    rates,
    score_detections,
    score_in_pixels,
)
from kilnflight.scores.tracks import score_tracks
