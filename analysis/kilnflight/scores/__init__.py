"""Scores of detections, tracks and flights against the truth.

==================  ==============  ==========================================  =============
call                equation        what it answers                             source
==================  ==============  ==========================================  =============
`score_detections`  3.1 to 3.4      which detections are particles, by gate     sec. 3.3
`score_in_pixels`   3.1 to 3.3      likewise, by the particles' labelled        sec. 5.1.1
                                    pixels
`count_in_air`      3.1 to 3.3      which detections were classified as in the  sec. 5.1.4
                                    air
`rates`             3.1 to 3.3      counts -> precision, recall, F1             sec. 3.3
`score_tracks`      5.1 to 5.7      how alike two sets of tracks are: alpha,    sec. 5.2.2
                                    beta, JSC, JSC_theta
==================  ==============  ==========================================  =============
"""

from kilnflight.scores.detections import count_in_air, rates, score_detections, score_in_pixels
from kilnflight.scores.tracks import score_tracks

__all__ = ["count_in_air", "rates", "score_detections", "score_in_pixels", "score_tracks"]
