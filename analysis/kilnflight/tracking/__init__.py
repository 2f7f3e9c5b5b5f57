"""Tracking: from detections to tracks.

In one loop over frames: predict, gate, associate, update.
"""

from kilnflight.tracking.tracker import track
