"""Background models for subtraction (thesis, section 2.2.1).

    stack of grey frames -> model(frames, indices) -> a foreground per requested frame

=================  =============  ========================================
model              equation       default, Table 5.4
=================  =============  ========================================
`TwoFrame`         2.5            3 frames before
`ThreeFrame`       2.6            3 frames before and after
`Mean`             section 2.2.1  25 frames before and 25 after
`Median`           section 2.2.1  75 frames before and 75 after
`Adaptive`         2.7, 2.8       25 frames before and 25 after, alpha 0.05
`RunningGaussian`  2.9, 2.10      10 frames, alpha 0.99, k 0.4
=================  =============  ========================================

The foreground is the difference of frame and background in grey values, a new float32
array that depends on no other requested frame. It stops at zero, as that of two
pictures of 16 bits does; ``absolute=True`` takes the absolute difference, whose bars
stand in Eqs 2.5, 2.6 and 2.10. `Mean`, `Median`, `Adaptive` and `RunningGaussian` also
have ``backgrounds(frames, indices)``, the images of Fig. 5.2.
"""

from collections.abc import Callable, Iterable, Iterator

from kilnflight.arrays import Single
from kilnflight.background.frames import Frames
from kilnflight.background.models import (
    Adaptive,
    Mean,
    Median,
    RunningGaussian,
    ThreeFrame,
    TwoFrame,
)

BackgroundModel = Callable[[Frames, Iterable[int]], Iterator[Single]]
MODELS: tuple[BackgroundModel, ...] = (
    TwoFrame(),
    ThreeFrame(),
    Mean(),
    Median(),
    Adaptive(),
    RunningGaussian(),
)
