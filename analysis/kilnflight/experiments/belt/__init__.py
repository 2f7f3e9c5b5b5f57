"""The protocols of both belt papers, of the real recordings, and of valves that blow."""
