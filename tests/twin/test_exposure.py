import json
from dataclasses import asdict, replace

import numpy as np
import pandas as pd
import pytest

from kilnflight.checks import InputError
from kilnflight.project import cache
from kilnflight.twin import exposure
from kilnflight.twin.exposure import UNTOUCHED, FreeAppearance
from kilnflight.twin.optics import FULL_SCALE
from kilnflight.twin.scene import Twin
from kilnflight.twin.scenes import ground_truth, small


def test_untouched_inputs_change_nothing():
    scene = ground_truth("V1")
    plain = replace(scene, optics=type(scene.optics)(), on_the_wall=type(scene.on_the_wall)())
    plain = replace(plain, surroundings=type(scene.surroundings)())
    same = UNTOUCHED.applied(plain)
    assert same.optics.flame_level == pytest.approx(plain.optics.flame_level)
    assert replace(same, optics=plain.optics) == plain


def test_the_targets_are_the_published_row():
    row = exposure.targets().set_index("subset").loc["V5"]
    assert row.tolist() == [0.9920, 0.4758, 0.35]


def test_no_misfit_costs_nothing_and_units_are_the_spreads():
    wanted = exposure.targets()
    assert exposure.cost(wanted, wanted) == 0
    off = wanted.assign(recall=wanted["recall"] + 0.05)
    assert exposure.cost(off, wanted) == pytest.approx(5.0)


def test_the_search_is_deterministic_and_keeps_to_the_limits():
    def bowl(one):
        return (one.wall_level / 9000 - 1) ** 2 + (one.share_on - 0.3) ** 2

    first, evaluations = exposure.fit(bowl, seed=1, generations=4)
    assert (first, evaluations) == exposure.fit(bowl, seed=1, generations=4)
    assert all(low <= asdict(first)[n] <= high for n, (low, high) in exposure.LIMITS.items())
    assert set(exposure.LIMITS) == set(asdict(UNTOUCHED))


def test_the_row_is_what_otsu_finds_and_depends_on_the_light():
    twin = Twin(small(ground_truth("V3")))
    given = exposure.exposed()
    row = exposure.otsu_row([twin], given)
    assert list(row.columns) == list(exposure.targets().columns)
    assert row[["precision", "recall", "unlit"]].to_numpy().min() >= 0
    assert row[["precision", "recall", "unlit"]].to_numpy().max() <= 1
    pd.testing.assert_frame_equal(row, exposure.otsu_row([twin], given))
    other = exposure.otsu_row([twin], replace(given, irradiance=1.2, burner_flicker=0.5))
    assert not np.allclose(row.iloc[0, 1:].astype(float), other.iloc[0, 1:].astype(float))


def test_the_frozen_file_fits_the_targets_and_overexposes_flames():
    record = exposure.record()
    assert record["cost_calibrated"] < record["cost_inputs_only"]
    assert FreeAppearance(**record["inputs"]) == exposure.exposed()
    assert exposure.exposed().flame_reach >= 1
    optics = exposure.exposed().applied(ground_truth("V1")).optics
    assert optics.wall_level + optics.flame_level >= FULL_SCALE * (1 - 1e-9)


def test_scenes_are_seen_in_the_frozen_light():
    for scene in (ground_truth("V2"),):
        assert exposure.exposed().applied(scene) == scene


def test_other_inputs_are_refused(tmp_path):
    content = json.loads(exposure.FILE.read_text())
    content.pop("sha256")
    content["inputs"]["moon"] = content["inputs"].pop("irradiance")
    cache.write_calibration(tmp_path / "strange.json", content)
    with pytest.raises(InputError, match="other inputs"):
        exposure.exposed(tmp_path / "strange.json")
