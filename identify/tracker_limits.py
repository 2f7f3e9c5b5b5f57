"""Identify the limits of Eq. 4.14 by eight JSC_theta of Table 5.17.

    python -m identify.tracker_limits

tries all `LIMITS` on the full windows and writes data/reference/tracker_limits.csv.
"""

from collections.abc import Sequence
from itertools import product

import pandas as pd
from tqdm import tqdm

from kilnflight.experiments.flights import campaigns, tracking
from kilnflight.experiments.flights import track_scores as scores
from kilnflight.experiments.flights.trackers import chosen
from kilnflight.experiments.flights.tracking import Window
from kilnflight.store import paths

# Visibility and missed frames that are tried. After one miss in the second frame the
# visibility is 1/2, after two misses 1/3. Gaps of up to 15 frames are closed afterwards
# (Table 5.16).
VISIBILITIES = (0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)
LIMITS = ((0.0, 0), *product(VISIBILITIES, (1, 2, 3, 5, 8, 15)))


def identify(
    windows: Sequence[Window], limits: Sequence[tuple[float, int]] = LIMITS
) -> pd.DataFrame:
    """Return the misfit of each setting of the limits of Eq. 4.14, the best first.

    One setting holds for both trackers and all windows. Its misfit is the sum of
    squared differences of JSC_theta without post-processing from Table 5.17, eight
    numbers. Of equal misfits the one that is tried first is the best.

    Parameters
    ----------
    windows
        Windows with their detections and truth.
    limits
        Visibility and missed frames of each setting.

    Returns
    -------
    DataFrame
        ``visibility``, ``missed_frames``, ``misfit``, and JSC_theta of each window and
        tracker, in columns such as "wood chip, GNN".
    """
    printed = scores.published().set_index([*scores.KEYS, "measure"])["published"]
    rows = []
    for visibility, missed in tqdm(limits, "limits of tracks", disable=None):
        row = {"visibility": visibility, "missed_frames": missed, "misfit": 0.0}
        for window, name in product(windows, scores.TRACKERS):
            tracker = chosen(name, visibility=visibility, missed_frames=missed)
            tracks = tracker(window.detections)
            score = scores.score_from_lance(window.truth, tracks, window.lance)
            value = scores.measures_of(score)["jsc_theta"]
            wanted = printed[window.fraction, name, "without", "jsc_theta"]
            row[f"{window.fraction}, {name}"] = value
            row["misfit"] += (value - wanted) ** 2
        rows.append(row)
    return pd.DataFrame(rows).sort_values("misfit", kind="stable", ignore_index=True)


def main() -> None:
    """Identify both limits on the full windows, and keep the misfit of each setting."""
    learned = campaigns.settings_from_labels("full")
    table = identify(tracking.windows("full", learned)).round(4)
    table.to_csv(paths.reference() / "tracker_limits.csv", index=False)


if __name__ == "__main__":
    main()
