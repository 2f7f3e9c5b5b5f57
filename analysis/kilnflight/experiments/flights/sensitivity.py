"""Results of the methods if an unpublished input of the simulation changes."""

from __future__ import annotations

import numpy as np

from kilnflight.detection.combination import Combination
from kilnflight.experiments.detection import labelled
from kilnflight.experiments.flights import campaigns
from kilnflight.experiments.flights.accuracy import compare_campaigns, errors
from kilnflight.experiments.flights.comparison import PAPERS
from kilnflight.experiments.flights.track_scores import GATE_PX
from kilnflight.scores import score_tracks
from kilnflight.tracklets import tracked


def watched(scale: str, scenario: str, seed: int, jobs: int) -> dict[str, float]:
    """Return five results of the methods in one scenario.

    ``f1`` of SIFT with DBSCAN on labelled frames. Of papers at 4.5 bar: ``alpha`` of
    tracks by GNN with post-processing, mean over fractions; ``dwell_bias_s`` and
    ``velocity_bias_m_s`` of the first metre, medians of measured minus true;
    ``false_ignitions_percent`` of those that do not ignite.
    """
    settings = campaigns.settings_from_labels(scale, seed, scenario)
    subsets = labelled.labelled_subsets(scale, seed, scenario=scenario)
    roi = subsets[0].recording.attributes.roi
    detector = Combination(labelled.sift(settings.threshold))
    methods = {"": lambda view: detector(view, roi, 0)[["row", "col"]].to_numpy()}
    found = labelled.sum_counts(labelled.run(subsets, methods), ["method"])
    results = campaigns.results(
        scale, seed, jobs, scenario, [(name, 4.5) for name in PAPERS]
    )
    alphas = []
    for campaign in results.campaigns:
        true = campaigns.true_positions(campaign)
        tracks = tracked(results.tables.of(campaign.key).tracks)
        alphas.append(score_tracks(true, tracks, GATE_PX).alpha)
    error = errors(compare_campaigns(results), seed)
    false = error["unlit_detected"] / max(error["unlit"], 1.0)
    return {
        "f1": float(found["f1"].iloc[0]),
        "alpha": float(np.mean(alphas)),
        "dwell_bias_s": error["dwell_s_bias"],
        "velocity_bias_m_s": error["velocity_m_s_bias"],
        "false_ignitions_percent": 100 * false,
    }
