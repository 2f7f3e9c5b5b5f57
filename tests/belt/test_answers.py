import numpy as np
import pandas as pd
import pytest

from kilnflight.belt.answers import (
    arrival_answers,
    by_data_set,
    lateral_answers,
    speed_answers,
    tracking_answers,
)
from kilnflight.project import claims

SETS = ("spheres", "cuboids", "cylinders")


def table(values, columns=("iqr", "mae")):
    rows = [
        {"data_set": name, "model": model} | dict.fromkeys(columns, value)
        for name in SETS
        for model, value in values.items()
    ]
    return pd.DataFrame(rows)


def verdicts(answers):
    return {claim: claims.judge(claim, one).verdict for claim, one in answers.items()}


def test_a_world_as_published_reproduces_every_claim_about_the_arrival():
    said = table({"IV": 3.0, "CV": 4.0, "CVBC": 1.0, "CA": 1.5, "CALV": 1.4, "IA": 0.5})
    said.loc[(said["data_set"] == "cuboids") & (said["model"] == "CA"), ["iqr", "mae"]] = 0.9
    said.loc[(said["data_set"] == "cuboids") & (said["model"] == "CALV"), ["iqr", "mae"]] = 0.8
    assert set(verdicts(arrival_answers(said)).values()) == {claims.REPRODUCED}


def test_the_opposite_reproduces_none():
    said = table({"IV": 1.0, "CV": 1.0, "CVBC": 2.0, "CA": 1.9, "CALV": 1.0, "IA": 5.0})
    assert set(verdicts(arrival_answers(said)).values()) == {claims.NOT_REPRODUCED}


def test_an_answer_has_a_part_for_each_data_set_or_stays_whole():
    said = arrival_answers(
        table({"IV": 3.0, "CV": 4.0, "CVBC": 1.0, "CA": 1.5, "CALV": 1.4, "IA": 2})
    )
    assert all(list(by_data_set(one)) == list(SETS) for one in said.values())
    assert list(by_data_set(said["belt20-3"])["cuboids"].values()) == [False]
    assert by_data_set(said["belt20-4"])["spheres"].to_dict() == said["belt20-4"][:1].to_dict()
    counted = {"CA-CA below CV-CV for none": False}
    assert by_data_set(counted) == {"all": counted}


@pytest.mark.parametrize(("last", "holds"), [(1.4, True), (1.05, False), (1.51, False)])
def test_speed_must_rise_and_stay_below_the_belt(last, holds):
    means = [1.0, 1.1, last]
    said = pd.DataFrame({"data_set": "spheres", "x_mm": [1.0, 2.0, 3.0], "mean_m_s": means})
    answer = speed_answers(said)["belt20-6"]
    assert list(answer.values()) == [holds]


def test_a_world_as_published_reproduces_every_claim_about_the_position():
    models = {"Straight": 3.0, "CV-CV": 1.0, "CA-CA": 0.9, "LV-DSC": 0.92, "IA-CV": 1.0}
    said = table(models | {"IA-CA": 0.95, "IA-Ratio": 0.5})
    said.loc[(said["data_set"] == "cylinders") & (said["model"] == "IA-Ratio"), "iqr"] = 2.0
    assert set(verdicts(lateral_answers(said)).values()) == {claims.REPRODUCED}
    said["iqr"] = 6.0 - said["iqr"]
    opposite = verdicts(lateral_answers(said))
    assert opposite["belt20-7"] == opposite["belt20-8"] == claims.NOT_REPRODUCED


def tracked(spreads, late=1.0):
    """Return deviations of one material, evenly spread; by data and approach."""
    parts = [
        pd.DataFrame(
            {
                "data": data,
                "approach": approach,
                "lateral_mm": spread * np.linspace(-1, 1, 41),
                "temporal_ms": late * spread * np.linspace(0, 2, 41),
            }
        )
        for (data, approach), spread in spreads.items()
    ]
    return pd.concat(parts, ignore_index=True)


AS_IN_2016 = {
    ("noise-free", "Sim"): 0.1,
    ("noise-free", "Tracking"): 0.11,
    ("noise-free", "Straight"): 1.0,
    ("images", "Tracking"): 1.0,
    ("images", "Straight"): 2.0,
}


def test_a_world_as_published_in_2016_reproduces_every_claim_and_its_opposite_none():
    said = tracking_answers(tracked(AS_IN_2016))
    assert list(said) == [f"belt16-{k}" for k in range(1, 6)]
    assert set(verdicts(said).values()) == {claims.REPRODUCED}
    opposite = {key: 2.1 / value for key, value in AS_IN_2016.items()}
    said = verdicts(tracking_answers(tracked(opposite, late=-1.0)))
    assert set(said.values()) == {claims.NOT_REPRODUCED}


def test_what_a_source_has_no_data_for_is_not_answered():
    some = {key: AS_IN_2016[key] for key in (("noise-free", "Sim"), ("noise-free", "Straight"))}
    assert list(tracking_answers(tracked(some))) == ["belt16-1", "belt16-4"]
