"""Shared plots."""

import numpy as np
import pandas as pd

from kilnflight.experiments import plots


def test_open_bounds_have_arrows_and_no_printed_value_is_cut_off(axes):
    axes.set_ylim(0, 4.5)
    columns = {"low": [3.0, np.nan, 7.1, 1.0], "high": [np.nan, 4.0, 7.1, 2.0]}
    plots.draw_published(axes, pd.DataFrame({"at": [1.0, 2.0, 3.0, 4.0]} | columns))
    assert axes.get_ylim()[1] > 7.1
    marks = {line.get_marker(): line.get_xdata().tolist() for line in axes.lines[:3]}
    assert marks == {"D": [3.0], "^": [1.0], "v": [2.0]}


def test_no_line_is_drawn_where_a_track_misses_frames():
    tracks = pd.DataFrame(
        {"particle": [1, 1, 1, 2], "frame": [3, 4, 7, 9], "row": [0.0, 1, 5, 2]}
    )
    broken = plots.broken_at_gaps(tracks.assign(col=2.0))
    assert broken["particle"].tolist() == [1] * 4 + [2]
    assert broken["frame"].tolist() == [3, 4, 6, 7, 9]
    assert broken["row"].isna().tolist() == [False, False, True, False, False]
    assert plots.broken_at_gaps(tracks.assign(col=2.0)[:0]).empty
