"""Settings of a run; what is not given is estimated from the recording."""

from typing import Literal

from kilnflight.background import BackgroundModel, Median
from kilnflight.background.models import Surroundings
from kilnflight.checks import CountFrom0, InputError, Positive, Settings
from kilnflight.recording.frames import Recording
from kilnflight.tracking.tracker import Management

Background = Literal["median", "none"]
BACKGROUNDS: dict[str, BackgroundModel] = {
    "median": Median(),
    "none": Surroundings(),
}


class Options(Settings):
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
    size
        Diameter of the particles in px.
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

    detector: Literal["dog", "otsu"] = "dog"
    background: Background | None = None
    threshold: Positive | None = None
    dark: bool = False
    size: Positive | None = None
    roi: tuple[CountFrom0, CountFrom0, CountFrom0, CountFrom0] | None = None
    frames: tuple[CountFrom0, CountFrom0] | None = None
    max_step: Positive | None = None
    memory: CountFrom0 = Management.invisible
    post_processing: bool | None = None
    in_air_mm: Positive = 800.0  # sec. 5.1.4

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
            raise InputError(
                f"frames and roi: {(*frames, *roi)} end before they begin, or beyond "
                f"{(length, rows, cols)}."
            )
