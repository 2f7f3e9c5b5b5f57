"""Simulated recordings as sources of `kilnflight.chain`."""

from dataclasses import dataclass
from functools import lru_cache

from kilnflight.simulated.kiln.scene import Twin
from kilnflight.simulated.kiln.scenes import cached_scene


@dataclass(frozen=True)
class TwinSource:
    """A simulated recording by name and seed, opened by each process for itself."""

    name: str
    seed: int = 0

    def recording(self) -> Twin:
        """Return the recording with its truth; the last two stay in memory."""
        return _scene(self.name, self.seed)


@lru_cache(maxsize=2)  # the flights of a scene take seconds
def _scene(name: str, seed: int) -> Twin:
    return cached_scene(name, seed)
