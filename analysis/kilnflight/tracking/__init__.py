"""Tracking: predict, gate, associate, update; the one loop that makes tracks of detections."""

from kilnflight.tracking.tracker import track

__all__ = ["track"]
