"""Simulated recordings as sources of `kilnflight.chain`."""

from dataclasses import dataclass
from functools import lru_cache

from kilnflight.simulated.kiln.scene import Twin
from kilnflight.simulated.kiln.scenes import open_scene


@dataclass(frozen=True)
class TwinSource:
    """A simulated recording by name and seed, opened by each process for itself."""

    name: str
    seed: int = 0

    def recording(self) -> Twin:
        """Return the recording with its truth; the last two stay in memory."""
        return _scene(self.name, self.seed)


_scene = lru_cache(maxsize=2)(open_scene)  # a scene takes a second
