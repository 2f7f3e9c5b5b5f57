"""Recordings: frames of a plenoptic camera or a film, on disk and imported; tables of
tracks.
"""
