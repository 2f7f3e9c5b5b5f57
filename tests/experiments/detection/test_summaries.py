import numpy as np
import pandas as pd
import pytest

from kilnflight.experiments.detection import summaries
from kilnflight.scores.intervals import DRAWS


def attempts(**true_positives):
    """Return ten particles per frame; a method detects so many of them, by frame."""
    rows = [
        {
            "subset": subset,
            "frame": t,
            "method": method,
            "tp": tp,
            "fp": 0,
            "fn": 10 - tp,
        }
        for method, detected in true_positives.items()
        for subset in ("V1", "V2")
        for t, tp in enumerate(detected)
    ]
    table = pd.DataFrame(rows).assign(seconds=0.1)
    return table.join(table[["tp", "fp", "fn"]].add_suffix("_pixels"))


def test_draws_are_paired_and_of_frames_that_are_all_alike_do_not_vary():
    table = attempts(one=(5, 5, 5), other=(8, 8, 8))
    draws = summaries.resampled_rates(table, 0)
    assert {rate.shape for rate in draws.values()} == {(DRAWS, 2)}
    assert draws["f1"]["one"].to_numpy() == pytest.approx(2 * 5 / 15)
    assert draws["recall"]["other"].to_numpy() == pytest.approx(0.8)
    assert (draws["precision"] == 1).all(axis=None)
    varied = summaries.resampled_rates(attempts(one=(0, 4, 9), other=(1, 5, 10)), 3)
    apart = varied["recall"]["other"] - varied["recall"]["one"]
    np.testing.assert_allclose(apart, 0.1)  # the same frames for both
    assert varied["recall"]["one"].nunique() > 5
