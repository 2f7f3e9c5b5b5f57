"""The protocol of chapter 5.1: methods on the labelled frames, and what was identified
by them.
"""
