"""The inputs of a recording of the twin: a few parameters and a seed."""

import ast
from dataclasses import dataclass, field, replace

from kilnflight.simulated.kiln.background import Interior
from kilnflight.simulated.kiln.geometry import Geometry
from kilnflight.simulated.kiln.lenses import LensCamera
from kilnflight.simulated.kiln.light import Optics
from kilnflight.tables import read_beside


@dataclass(frozen=True)
class Scene:
    """Everything that determines a recording of the twin.

    A campaign has a ``fraction`` and a ``count`` of particles, a labelled subset
    ``labelled``.

    Parameters
    ----------
    name
        Of the recording.
    frames
        Number of frames.
    seed
        Of all random numbers but the calibration's.
    frame_rate_hz
        Frames per second; 153.85 for PE granules (section 5.2.3).
    fraction, pressure_bar
        Of a campaign.
    count
        Particles that are fed.
    handful
        Mean number of particles in a handful; assumption.
    labelled
        By class of Table 5.1 the labels within the region of interest and outside it,
        in ten frames.
    calibration
        Seed of the depth camera's calibration: one for all recordings of a camera.
    geometry, optics, interior, depth
        Kiln and camera, light, regions of the picture, and the depth camera.
    """

    name: str
    frames: int
    seed: int
    frame_rate_hz: float = 330.0
    fraction: str = "mixed"
    pressure_bar: float = 4.5
    count: int = 0
    handful: float = 6.0
    labelled: tuple[tuple[int, tuple[int, int]], ...] = ()
    calibration: int = 0
    geometry: Geometry = field(default_factory=Geometry)
    optics: Optics = field(default_factory=Optics)
    interior: Interior = field(default_factory=Interior)
    depth: LensCamera = field(default_factory=LensCamera)

    @property
    def roi(self) -> tuple[tuple[float, float], ...]:
        """Vertices (row, col) of the region of interest in px."""
        rows = self.geometry.rows
        columns = self.geometry.columns
        return tuple((row * rows, col * columns) for row, col in self.interior.roi)


# inputs.csv has inputs that no work prints at other values (notebooks 10, 22, 24 and
# 32); from thin-flames on those of data/reference/choices.csv. Dark bodies are darker
# than the inlet plate; thin flames are long, and none is overexposed.
_OTHERS = read_beside(__file__, "inputs.csv", index_col="scenario")
VARIED = list(_OTHERS.index.unique())


def varied(scene: Scene, scenario: str) -> Scene:
    """Return a scene with the other inputs of one of `VARIED`."""
    for row in _OTHERS.loc[[scenario]].itertuples():
        changed = {row.input: ast.literal_eval(row.value)}
        part = replace(getattr(scene, row.part), **changed)
        scene = replace(scene, **{row.part: part})
    return scene
