"""Recordings on disk, in films and in memory; tables of detections and tracks."""
