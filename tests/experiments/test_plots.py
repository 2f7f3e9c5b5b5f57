"""Shared plots: marks lie where the definition says, up is up."""

import numpy as np
import pandas as pd

from kilnflight.experiments import plots


def test_open_bounds_are_arrows_from_their_end_and_numbers_diamonds(axes):
    axes.set_ylim(0, 10)
    columns = {"low": [3.0, np.nan, 5.0, 1.0], "high": [np.nan, 4.0, 5.0, 2.0]}
    plots.draw_published(axes, pd.DataFrame({"at": [1.0, 2.0, 3.0, 4.0]} | columns))
    ends = [segment[:, 1] for segment in axes.collections[0].get_segments()]
    np.testing.assert_allclose(ends, [[3.0, 3.9], [3.1, 4.0], [5.0, 5.0], [1.0, 2.0]])
    marks = {line.get_marker(): line.get_xdata().tolist() for line in axes.lines[:3]}
    assert marks == {"D": [3.0], "^": [1.0], "v": [2.0]}
    assert axes.get_ylim() == (0, 10)
    axes.set_ylim(0, 4.5)
    plots.draw_published(axes, pd.DataFrame({"at": [1.0], "low": [7.1], "high": [7.1]}))
    assert axes.get_ylim()[1] > 7.1  # no printed value is cut off


def test_no_line_is_drawn_where_a_track_misses_frames():
    tracks = pd.DataFrame({"particle": [1, 1, 1, 2], "frame": [3, 4, 7, 9], "row": [0.0, 1, 5, 2]})
    broken = plots.broken_at_gaps(tracks.assign(col=2.0))
    assert broken["particle"].tolist() == [1] * 4 + [2]
    assert broken["frame"].tolist() == [3, 4, 6, 7, 9]
    assert broken["row"].isna().tolist() == [False, False, True, False, False]
    assert plots.broken_at_gaps(tracks.assign(col=2.0)[:0]).empty
