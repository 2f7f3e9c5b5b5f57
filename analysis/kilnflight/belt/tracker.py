"""Track many particles on the belt (2016 paper, section II.B).

predict, gate, associate with extra rows and columns, update, score, start, stop

Loop, filter, gate and assignment are those of the kiln's tracker. The belt adds its
costs, the likelihoods that tracks begin and end, and the score that separates particles
from dirt. Lengths are in mm, times in s. All likelihoods are taken as -ln, so the
likeliest association is the cheapest.
"""

from collections.abc import Iterable, Iterator
from typing import NamedTuple

import numpy as np
from pandas import DataFrame
from scipy.special import ndtr

from kilnflight.arrays import Array, Flags, Index, Integers, Named, Pair, Words
from kilnflight.association import Pairs, assign
from kilnflight.belt.camera import TRACKED, Area
from kilnflight.belt.models import BELT_VELOCITY_MM_S
from kilnflight.checks import InputError, Positive, Settings, check_number
from kilnflight.tables import BELT_ENDS, BELT_STATES, MEASURED
from kilnflight.tracking.filter import ConstantVelocity, Detected, Gate, Motion
from kilnflight.tracking.tracker import ExtraColumns, Step, Tracks, follow

BELT_FRAME_S = 0.005  # 200 frames/s, section IV.B
MISSED = 0.1  # share of particles in view without a spot of their own; assumption
FALSE_VALID = 1e-4  # a: share of dirt tracks that become valid; assumption
FALSE_LOST = 1e-6  # b: share of particles given up; six misses in a row; assumption
# Score of a valid track, and fall of the score of a lost one.
VALID_FROM = float(np.log((1 - FALSE_LOST) / FALSE_VALID))
LOST_BY = float(np.log((1 - FALSE_VALID) / FALSE_LOST))
LEFT = "left at the end"
BACK = "left at the start"
SIDEWAYS = "left sideways"
LOST = "lost"
RUNNING = "recording ends"
SCORES = (
    ("score", np.float64),
    ("best", np.float64),  # highest score so far
    ("valid", np.bool_),  # the score has ever reached the upper threshold
    ("outside", np.float64),  # probability that the prediction lies outside the area
)
_GATE = Gate()  # "beyond a certain Mahalanobis distance": 4, as in the kiln


def constant_velocity(
    spread_mm: float = 0.127,
    acceleration_mm_s2: float = 5000.0,
    belt_mm_s: float = BELT_VELOCITY_MM_S,
) -> Motion:
    """Return the motion model of section II.B: constant velocity, in mm and s.

    Parameters
    ----------
    spread_mm
        Standard deviation of a measurement in mm. The default is a choice: that of
        rounding to whole pixels of 0.44 mm, 0.44 / sqrt(12). See the notes.
    acceleration_mm_s2
        Standard deviation of the mean acceleration in 5 ms, mm/s^2. The default is a
        choice between two needs. With 2000, 0.2 g, a belt's drag, 86 % of the particles
        that land on the belt stay in one track, with 5000 98 %, with 8000 99 % (the
        authors' tracks at 200 Hz, 0.1 mm of noise); but with more noise the last
        velocity, and so the prediction, is less certain.
    belt_mm_s
        Velocity of the belt in mm/s.

    Notes
    -----
    No number is printed. A particle enters with 0 to the belt's 1500 mm/s: mean 750,
    standard deviation 433. White noise changes its velocity by ``acceleration_mm_s2``
    times 5 ms in 5 ms.

    ``spread_mm`` was set before places were compared with the truth, and is not fitted
    to it. Centroids are not rounded to pixels and scatter less. But parallax shifts the
    place of a sphere by up to 0.5 mm at the start of the belt, and changes slowly from
    there on. So errors of successive frames are not independent, as the filter assumes.
    """
    share = belt_mm_s / BELT_VELOCITY_MM_S
    return ConstantVelocity(
        velocity=(750.0 * share, 0.0),
        velocity_sd=433.0 * share,
        acceleration_noise=float(acceleration_mm_s2 * np.sqrt(BELT_FRAME_S)),
        measurement_sd=spread_mm,
    )


class Appearance(Settings):
    """Likelihoods by place on the belt that a track begins or is not observed.

    Parameters
    ----------
    area
        Tracked part of the belt; the default ends where the prediction phase of 2016
        begins.
    arrivals
        New particles per frame: the order of 4000 in 15 s at 200 frames/s.
    entry_mm
        Length along the belt in which they are first seen: 1500 mm/s for 5 ms.
    entry_blur_mm
        Softness of its end: the radius of a sphere.
    clutter
        Other measurements per frame, anywhere: dirt, or particles found again;
        assumption.

    Notes
    -----
    Fig. 2 shows both curves without a scale. By its text, particles appear mostly at
    the beginning of the observed region, and likely disappear behind its end. Here both
    follow from counting. A new particle lies within the distance that the belt moves in
    a frame. A track is missed with the probability that its prediction lies outside.
    Beyond the sides is outside, too.
    """

    area: Area = TRACKED
    arrivals: Positive = 1.0
    entry_mm: Positive = 7.5
    entry_blur_mm: Positive = 2.5
    clutter: Positive = 0.1

    @property
    def clutter_density(self) -> float:
        """Expected measurements per frame and mm^2 that are of no new particle."""
        return self.clutter / self.area.square_mm

    def new(self, places: Array) -> Array:
        """Return the expected number of new tracks per frame and mm^2, (m,).

        ``places`` (m, 2) are x and y in mm. Its -ln is the cost of Fig. 3's extra rows.
        """
        density = self.arrivals / (self.entry_mm * self.area.width_mm)
        end = self.area.start_mm + self.entry_mm
        entry_share: Array = ndtr((end - places[:, 0]) / self.entry_blur_mm)
        return self.clutter_density + density * entry_share

    def unobserved_likelihood(self, places: Array, residual: Array) -> Pair:
        """Return the probability of no observation, and that of being outside, (n,).

        A track is observed if it lies in the area and is not missed there. Otherwise it
        is outside the area, or missed with probability `MISSED`. The first probability
        is the likelihood of Fig. 3's extra columns. It is at least 1e-12, so that its
        logarithm is finite.

        Parameters
        ----------
        places
            Predicted x and y of n tracks, (n, 2) in mm.
        residual
            S (n, 2, 2) in mm^2, covariance of a measurement; x and y are taken as
            independent.
        """
        spread = np.sqrt(np.diagonal(residual, axis1=1, axis2=2))
        corners = self.area.corners[[0, 2]]
        below, above = (ndtr((corner - places) / spread) for corner in corners)
        inside: Array = (above - below).prod(axis=1)
        return np.maximum(1e-12, 1.0 - (1.0 - MISSED) * inside), 1.0 - inside


class Likelihoods(NamedTuple):
    """Likelihoods of p gated pairs of n tracks and m measurements (Fig. 3)."""

    costs: Array  # (p,), -ln of (1 - MISSED) N(z; prediction, S) per mm^2
    unobserved: Array  # (n,), probability that a track is not observed
    new: Array  # (m,), likelihood per mm^2 that a measurement starts a track
    outside: Array  # (n,), probability that the prediction lies outside the area

    def taken(self, pairs: tuple[Index, Index]) -> Flags:
        """Return which pairs (p,) the likeliest association takes.

        ``pairs`` are their tracks and measurements, (p,) each.

        Notes
        -----
        In Fig. 3 each measurement has an extra row of its own, each track an extra
        column. So a measurement without a track costs -ln ``new`` (m,), and a track
        without a measurement -ln ``unobserved`` (n,). A measurement that is paired
        saves its -ln ``new``. Subtracting it from the ``costs`` of the measurement's
        pairs, that is adding ln ``new``, gives the same optimum without the extra rows.
        """
        costs = self.costs + np.log(self.new)[pairs[1]]
        return assign(*pairs, costs, -np.log(self.unobserved))


class Followed(NamedTuple):
    """Tracks of a recording: a row per track and frame, and a row per track."""

    states: DataFrame  # kilnflight.tables.BELT_STATES
    ends: DataFrame  # kilnflight.tables.BELT_ENDS, and reason: LEFT, ..., RUNNING


class BeltTracker(Settings):
    """Track particles by global nearest neighbour with entries, exits and scores.

    A track's score is the log likelihood ratio of a particle against dirt (Blackman and
    Popoli, ch. 6). It starts with that of a new particle at this place. Each
    measurement adds ln((1 - `MISSED`) N / clutter density), each miss ln(unobserved). A
    track is valid from the score `VALID_FROM` = ln((1 - b) / a) on. It is lost when the
    score falls below its best by more than `LOST_BY` = ln((1 - a) / b). Here a is
    `FALSE_VALID` and b is `FALSE_LOST`.

    Parameters
    ----------
    motion
        Motion of particles in mm and s.
    appearance
        Tracked area, and where tracks begin and end.
    frame_s
        Time in s between two frames.

    Notes
    -----
    The paper names the score and its purpose, no thresholds. A missed track that is
    outside with a probability above one half has left; that is no loss.

    Examples
    --------
    A particle moves by 6 mm in a frame of 5 ms:

    >>> frame = np.arange(60)
    >>> measured = DataFrame({"frame": frame, "x": 390 + 6.0 * frame, "y": 90.0})
    >>> states, ends = BeltTracker()(measured)
    >>> ends
       particle  frame  valid           reason
    0         0     50      1  left at the end
    >>> states["velocity_x_mm_s"].iloc[40].round()
    np.float64(1200.0)
    """

    motion: Motion = constant_velocity()
    appearance: Appearance = Appearance()
    frame_s: Positive = BELT_FRAME_S

    def __call__(self, measured: DataFrame, frames: int = 0) -> Followed:
        """Return the states of all tracks in all frames, and how each ended.

        Parameters
        ----------
        measured
            Columns frame, x, y (mm), as `kilnflight.tables.BELT_SPOTS`; those outside
            the area are ignored.
        frames
            Number of frames of the camera, as for `steps`: tracks may end after the
            last measurement.

        Returns
        -------
        Followed
            ``states``: `kilnflight.tables.BELT_STATES`, a row per track and frame.
            ``ends``: `kilnflight.tables.BELT_ENDS` and ``reason``, a row per track.

        Raises
        ------
        InputError
            If a column is missing or not numeric, or one frame has two measurements at
            the same place: they would be two tracks of one particle.
        """
        steps = [step for step in self.steps(measured, frames) if len(step.tracks)]
        if not steps:
            return Followed(BELT_STATES.empty(), BELT_ENDS.empty().assign(reason=""))
        every = [step.tracks for step in steps]
        number = [step.detected.frame for step in steps]
        frame = np.repeat(number, [len(tracks) for tracks in every])
        tracks = np.concatenate(every)
        known = {
            "frame": frame,
            "particle": tracks["particle"],
            "row": tracks["row"],
            "valid": tracks["valid"].astype(int),
            "score": tracks["score"],
        }
        states = DataFrame(known | state_columns(tracks))
        last = states.groupby("particle").tail(1).sort_values("particle").index
        ends = states.loc[last, BELT_ENDS.names]
        ends["reason"] = self.reasons(tracks[last])
        return Followed(states, ends.reset_index(drop=True))

    def steps(self, measured: DataFrame, frames: int = 0) -> Iterator[Step]:
        """Yield the `Step` of each frame from the first measurement on.

        Frames without measurements have one, too.

        Parameters
        ----------
        measured
            Columns frame, x, y (mm). Those outside the area start no track, but count
            for the first and last frame.
        frames
            Number of frames of the camera. Steps end with frame ``frames - 1`` or with
            the last measurement, whichever is later; so 0 means the last measurement.
        """
        check_number(frames, "BeltTracker: frames", least=0, whole=True)
        table = MEASURED.check(measured, once=True)
        twice = table.index[table.duplicated()]
        if len(twice):
            raise InputError(
                f"measured: row {twice[0]} is at the place of another one of its "
                "frame. They would be two tracks of one particle; keep one of them "
                "(pandas: drop_duplicates)."
            )
        frame_of = table["frame"].to_numpy()
        places = table[["x", "y"]].to_numpy()
        if not len(frame_of):
            return
        # Time stamps in place of frame numbers would take years of frames.
        check_number(
            np.ptp(frame_of), "measured: frames from first to last", most=10_000_000
        )
        order = np.argsort(frame_of, kind="stable")
        numbers = np.arange(frame_of.min(), max(frame_of.max() + 1, frames))
        rows_by_frame = np.split(order, np.searchsorted(frame_of[order], numbers[1:]))
        yield from self.follow(
            self.detections(frame, places[rows], rows)
            for frame, rows in zip(numbers.tolist(), rows_by_frame, strict=True)
        )

    def follow(self, frames: Iterable[Detected]) -> Iterator[Step]:
        """Yield the `Step` of each frame, given as `detections` by ascending number."""
        return follow(frames, self.motion, _GATE, self.associate, self.keeps, SCORES)

    def detections(
        self, number: int, places: Array, rows: Integers, frames: int = 1
    ) -> Detected:
        """Return the measurements of one frame for `follow`.

        Parameters
        ----------
        number
            Number of the frame.
        places
            (m, 2) x and y in mm; those outside the area are ignored.
        rows
            (m,) rows of the measurements in their table.
        frames
            Frames since the one before: above 1 if pictures were lost between them.

        Returns
        -------
        Detected
            Measurements in the area, sorted by x, then y, so that no result depends on
            the order of the table. Of several at one place the first is kept: others
            would be second tracks of one particle.
        """
        kept = np.flatnonzero(self.appearance.area.contains(places))
        # Complex numbers are sorted by real part, x, then by imaginary part, y.
        points = np.ascontiguousarray(places[kept]).view(np.complex128)
        inside, first = np.unique(points, return_index=True)
        return Detected(
            inside.view(np.float64).reshape(-1, 2),
            frame=number,
            span=self.frame_s * frames,
            rows=rows[kept[first]],
        )

    def likelihoods(self, detected: Detected, pairs: Pairs) -> Likelihoods:
        """Return the likelihoods of n tracks and m measurements (Fig. 3)."""
        unobserved, outside = self.appearance.unobserved_likelihood(
            pairs.expected, pairs.residual
        )
        logs = pairs.log_determinant + pairs.expected.shape[1] * np.log(2.0 * np.pi)
        normal = 0.5 * logs[pairs.track] - np.log(1.0 - MISSED)
        return Likelihoods(
            costs=normal + 0.5 * pairs.distance_squared,
            unobserved=unobserved,
            new=self.appearance.new(detected.positions),
            outside=outside,
        )

    def associate(
        self, tracks: Tracks, detected: Detected, pairs: Pairs
    ) -> tuple[Flags, ExtraColumns, ExtraColumns]:
        """Return the pairs that are taken, and the scores of tracks and of new tracks.

        Flags are of the pairs (p,). Scores are the columns `SCORES`, (n,) of the tracks
        and (m,) of those that the measurements would start. `follow` calls it.
        """
        likelihoods = self.likelihoods(detected, pairs)
        clutter = np.log(self.appearance.clutter_density)
        gain = np.log(likelihoods.unobserved)
        taken = likelihoods.taken(pairs[:2])
        gain[pairs.track[taken]] = -(likelihoods.costs[taken] + clutter)
        scores = _scores(tracks["score"] + gain, tracks["best"], likelihoods.outside)
        first = np.log(likelihoods.new) - clutter
        return taken, scores, _scores(first, first, np.zeros_like(first))

    def keeps(self, tracks: Tracks, frame: int) -> Flags:
        """Return whether each track (n,) lives on.

        It does if it is measured, or neither outside nor lost. ``frame`` is not used;
        `follow` passes it.
        """
        lost = tracks["best"] - tracks["score"] > LOST_BY
        return (tracks["row"] >= 0) | ~((tracks["outside"] > 0.5) | lost)

    def reasons(self, tracks: Tracks) -> Words:
        """Return why each track (n,) ends after its last step.

        One of `LEFT`, `BACK`, `SIDEWAYS`, `LOST`, or `RUNNING` if it lives on.
        """
        area = self.appearance.area
        x, y = tracks["state"][:, :2].T
        sideways = ((y < 0) | (y > area.width_mm)) & (x < area.end_mm)
        # What is outside by probability may lie just inside: the nearer end decides.
        back = 2.0 * x < area.start_mm + area.end_mm
        inside = tracks["outside"] <= 0.5
        cases = [self.keeps(tracks, 0), inside, sideways, back]
        return np.select(cases, [RUNNING, LOST, SIDEWAYS, BACK], LEFT)


def _scores(score: Array, best: Array, outside: Array) -> ExtraColumns:
    """Return the columns `SCORES` (n,) after a frame; ``best`` (n,) is from before."""
    best = np.maximum(best, score)
    return {
        "score": score,
        "best": best,
        "valid": best >= VALID_FROM,
        "outside": outside,
    }


def state_columns(tracks: Tracks) -> Named:
    """Return the states of tracks (n,) by the names of `BELT_STATES`, (n,) each.

    An acceleration that is not in them is 0. Variances are those of x, and of y, too.
    """
    values = np.zeros((9, len(tracks)))
    state = tracks["state"].T
    values[: len(state)] = state
    values[6:] = tracks["covariance"][:, [0, 0, 2], [0, 2, 2]].T
    return dict(zip(BELT_STATES.names[5:], values, strict=True))
