"""Settings of a run; what is not given is estimated from the recording."""

from __future__ import annotations

from dataclasses import dataclass

from kilnflight.background import BackgroundModel, Median
from kilnflight.background.models import Surroundings
from kilnflight.checks import InputError, check_finite, check_number
from kilnflight.recording.frames import Recording
from kilnflight.tracking.tracker import Management

BACKGROUNDS: dict[str, BackgroundModel] = {"median": Median(), "none": Surroundings()}


@dataclass(frozen=True)
class Options:
    """Options of a run; None is estimated from the recording.

    Parameters
    ----------
    detector
        "dog" for round spots, "otsu" for areas of any form.
    background
        "median" of the frames around, or "none": each frame's own surroundings.
    threshold
        Grey values: of the difference of Gaussians, or of a pixel over the background
        for areas.
    dark
        Whether particles are darker than the background.
    small
        Whether pictures are searched at twice their size, for radii from 1.4 px.
    size
        Diameter of the particles in px; it replaces ``small``.
    roi
        First row, row after the last, first column, column after the last.
    frames
        First frame and frame after the last.
    max_step
        Longest step of a particle in px a frame.
    memory
        Frames in a row that a track may miss.
    post_processing
        Whether tracklets are joined and filtered as in the thesis (chapter 4.2). None:
        only with depth and a lance.
    in_air_mm
        Largest distance of flying particles from the kiln's axis.

    Raises
    ------
    InputError
        If a word is not known or a number is not above 0.
    """

    detector: str = "dog"
    background: str | None = None
    threshold: float | None = None
    dark: bool = False
    small: bool = False
    size: float | None = None
    roi: tuple[int, int, int, int] | None = None
    frames: tuple[int, int] | None = None
    max_step: float | None = None
    memory: int = Management.invisible
    post_processing: bool | None = None
    in_air_mm: float = 800.0  # sec. 5.1.4

    def __post_init__(self) -> None:
        check_number(self.memory, "memory", least=0, whole=True)
        for name in ("threshold", "size", "max_step", "in_air_mm"):
            value = getattr(self, name)
            if value is not None:
                check_number(value, name, above=0)
        for name, length in {"roi": 4, "frames": 2}.items():
            value = getattr(self, name)
            if value is not None:
                for number in check_finite(value, name, (length,)).tolist():
                    check_number(number, name, least=0, whole=True)
                object.__setattr__(self, name, tuple(value))
        for name, known in {
            "detector": ("dog", "otsu"),
            "background": BACKGROUNDS,
        }.items():
            if getattr(self, name) not in (None, *known):
                raise InputError(
                    f"{name}: {getattr(self, name)!r} is not {' or '.join(known)}."
                )

    def check(self, recording: Recording) -> None:
        """Raise an `InputError` if frames or region are not in the recording."""
        most = (len(recording), *recording.attributes.size)
        ends = (self.frames or (0, most[0])) + (self.roi or (0, most[1], 0, most[2]))
        if not all(
            a < b <= end for a, b, end in zip(ends[::2], ends[1::2], most, strict=True)
        ):
            raise InputError(
                f"frames and roi: {ends} end before they begin, or beyond {most}."
            )
