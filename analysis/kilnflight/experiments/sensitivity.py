"""What the methods' results change by if an unpublished input of the simulation changes."""

from __future__ import annotations

import numpy as np

from kilnflight.detection.combination import Combination
from kilnflight.experiments import campaigns, detection
from kilnflight.experiments.accuracy import compare_campaigns, errors
from kilnflight.experiments.flights import PAPERS
from kilnflight.experiments.tracking_scores import GATE_PX
from kilnflight.scores import score_tracks
from kilnflight.tracklets import tracked


def watched(scale: str, scenario: str, seed: int, jobs: int) -> dict[str, float]:
    """Return five results of the methods in one scenario.

    ``f1`` of SIFT with DBSCAN on labelled frames; ``alpha`` of tracks by GNN with post-processing,
    mean over campaigns; ``dwell_bias_s`` and ``velocity_bias_m_s`` of the first metre, medians of
    measured minus true; ``false_ignitions_percent`` of papers that do not ignite.
    """
    settings = campaigns.settings_from_labels(scale, seed, scenario)
    subsets = detection.labelled_subsets(scale, seed, scenario=scenario)
    roi = subsets[0].recording.attributes.roi
    detector = Combination(detection.sift(settings.threshold))
    methods = {"": lambda view: detector(view, roi, 0)[["row", "col"]].to_numpy()}
    found = detection.sum_counts(detection.run(subsets, methods), ["method"])
    results = campaigns.results(scale, seed, jobs, scenario)
    alphas = []
    for campaign in results.campaigns:
        tracks = tracked(campaigns.of_campaign(results.tables.tracks, campaign.key))
        true = campaigns.true_positions(campaign)
        alphas += [score_tracks(true, tracks, GATE_PX).alpha] if len(true) else []
    both = compare_campaigns(results)
    error, papers = errors(both, seed), errors(both[both["fraction"].isin(PAPERS)], seed)
    return {
        "f1": float(found["f1"].iloc[0]),
        "alpha": float(np.mean(alphas)) if alphas else np.nan,
        "dwell_bias_s": error["dwell_s_bias"],
        "velocity_bias_m_s": error["velocity_m_s_bias"],
        "false_ignitions_percent": 100 * papers["unlit_detected"] / max(papers["unlit"], 1.0),
    }
