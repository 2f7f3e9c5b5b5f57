"""Evaluate both belt papers, the real recordings, and valves that blow."""
