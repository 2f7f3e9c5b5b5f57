"""Settings of a run; what is not given is estimated from the recording."""

from collections.abc import Iterable
from dataclasses import dataclass

from kilnflight.background import BackgroundModel, Median
from kilnflight.background.models import Surroundings
from kilnflight.checks import InputError, check_finite, check_number
from kilnflight.recording.frames import Recording
from kilnflight.tracking.tracker import Management

DETECTORS = ("dog", "otsu")
BACKGROUNDS: dict[str, BackgroundModel] = {"median": Median(), "none": Surroundings()}


@dataclass(frozen=True)
class Options:
    """Options of a run; what is None is estimated from the recording.

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

    Examples
    --------
    >>> Options(dark=True, size=10.0).memory
    5
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
        for name, length in (("roi", 4), ("frames", 2)):
            value = getattr(self, name)
            if value is not None:
                for number in check_finite(value, name, (length,)).tolist():
                    check_number(number, name, least=0, whole=True)
                object.__setattr__(self, name, tuple(value))
        _check_word(self.detector, "detector", DETECTORS)
        if self.background is not None:
            _check_word(self.background, "background", BACKGROUNDS)

    def check(self, recording: Recording) -> None:
        """Raise an `InputError` if frames or region are not in the recording."""
        length = len(recording)
        rows, cols = recording.attributes.size
        frames = self.frames or (0, length)
        roi = self.roi or (0, rows, 0, cols)
        fits = (
            frames[0] < frames[1] <= length
            and roi[0] < roi[1] <= rows
            and roi[2] < roi[3] <= cols
        )
        if not fits:
            most = (length, rows, cols)
            raise InputError(
                f"frames and roi: {(*frames, *roi)} end before they begin, or beyond "
                f"{most}."
            )


def _check_word(word: str, name: str, known: Iterable[str]) -> None:
    """Raise an `InputError` unless a word is one of the known."""
    if word not in known:
        raise InputError(f"{name}: {word!r} is not {' or '.join(known)}.")
