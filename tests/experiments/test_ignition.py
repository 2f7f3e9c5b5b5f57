import numpy as np
import pandas as pd
import pytest

from kilnflight.checks import InputError
from kilnflight.experiments import ignition
from kilnflight.experiments.campaigns import Measurement, Results
from kilnflight.flight import kept
from kilnflight.ignition import LitTrace
from kilnflight.project import claims
from kilnflight.recording.frames import ArrayRecording, Attributes
from kilnflight.scores.flights import FlightValues
from kilnflight.tables import FLIGHTS
from kilnflight.twin.particles import FRACTIONS
from kilnflight.twin.scenes import PRESSURES_BAR

KEYS = [(name, bar) for name in FRACTIONS for bar in PRESSURES_BAR]
# Per cent that ignite and the median time, after Figs 5.25 and 5.26.
PRINTED = {
    ("confetti", 4.5): (26, 0.2),
    ("confetti", 5.0): (15, 0.25),
    ("paper shred", 4.5): (71, 0.15),
    ("paper shred", 5.0): (40, 0.18),
}
EARLY = {("confetti", 4.5): 3, ("paper shred", 4.5): 21, ("paper shred", 5.0): 6}


def flown(key):
    ignition_s = np.full(100, np.nan)
    lit, middle = PRINTED.get(key, (0, np.nan))
    ignition_s[:lit] = middle
    ignition_s[: EARLY.get(key, 0)] = 0.05
    return FlightValues(np.full(100, 0.4), np.ones((100, 5)), ignition_s, np.full(100, 3.0))


@pytest.fixture
def values():
    return {key: flown(key) for key in KEYS}


def results(values, flights=6):
    rows = [(*key, k, True, "") for key in KEYS for k in range(flights)]
    columns = ["fraction", "pressure_bar", "particle", "from_lance", "refused"]
    table = pd.DataFrame(rows, columns=columns)
    return Results([], Measurement(None, None, table, None), values, values)


def traces(light_up=0, number=100, **counts):
    rows = [(name, *key, light_up, number) for name in ignition.PICTURES for key in KEYS]
    columns = ["picture", "fraction", "pressure_bar", "light_up", "number"]
    counts = {"unlit": 50, "unlit_light": 0, "lit": 50, "lit_light": 50} | counts
    return pd.DataFrame(rows, columns=columns).assign(**counts)


def judged(values, table, measured=None):
    generator = np.random.default_rng(0)
    return ignition.verdicts(results(values), both(measured or values), table, generator)


def both(first, second=None):
    """The two readings of grey values."""
    return {ignition.AS_THEY_ARE: first, ignition.ABOVE: second or first}


def test_what_is_printed_is_reproduced_but_for_what_was_fitted(values):
    verdicts = {each.id: each for each in judged(values, traces())}
    assert list(verdicts) == ["ign-1", "ign-2", "ign-3", "ign-4"]
    assert verdicts["ign-1"].verdict == verdicts["ign-3"].verdict == claims.REPRODUCED
    assert verdicts["ign-4"].verdict == claims.REPRODUCED
    assert verdicts["ign-2"].verdict == claims.NOT_DECIDABLE  # the twin was fitted to it
    assert "confetti 4.5" in verdicts["ign-4"].reason  # whether shares differ beyond chance
    assert "twice as light as the kiln behind" in verdicts["ign-1"].reason  # the other reading


@pytest.mark.parametrize(
    ("light_up", "verdict"),
    [(0, claims.REPRODUCED), (4, claims.NOT_DECIDABLE), (5, claims.NOT_REPRODUCED)],
)
def test_wood_is_judged_by_the_picture_and_a_few_are_open(values, light_up, verdict):
    """ "Do not combust basically": none is what is printed, up to 5 % is a bound of ours."""
    first = judged(values, traces(light_up))[0]
    assert first.verdict == verdict
    assert first.because == {claims.NOT_REPRODUCED: "chain"}.get(
        verdict, "criterion" if verdict == claims.NOT_DECIDABLE else ""
    )


@pytest.mark.parametrize("counts", [{"unlit_light": 3}, {"lit_light": 24}])
@pytest.mark.parametrize("light_up", [0, 50])
def test_a_test_of_traces_that_tells_nothing_decides_nothing(values, light_up, counts):
    """It takes over 5 % of the unlit for light, or sees under half of what burns."""
    first = judged(values, traces(light_up, **counts))[0]
    assert (first.verdict, first.because) == (claims.NOT_DECIDABLE, "method")
    few = counts.get("unlit_light", 0) * 4
    assert f"light are {few} of 200 unlit wood chips and granules" in first.reason


def test_grey_values_of_wood_decide_nothing(values):
    burning = values["paper shred", 4.5]
    measured = values | {(name, 4.5): burning for name in ("wood chip", "PE granule")}
    assert judged(values, traces(), measured)[0].verdict == claims.REPRODUCED


def test_a_claim_that_fails_on_the_truth_is_about_the_twin(values):
    often = values | {("paper shred", 5.0): values["paper shred", 4.5]}
    third = judged(often, traces())[2]
    assert (third.verdict, third.because) == (claims.NOT_REPRODUCED, "twin")
    third = judged(values, traces(), often)[2]
    assert (third.verdict, third.because) == (claims.NOT_REPRODUCED, "chain")


def test_what_hangs_on_the_reading_of_grey_values_is_not_decidable(values):
    """Section 5.3.2: "increases abruptly", which may be seen against what is behind or not."""
    often = values | {("paper shred", 5.0): values["paper shred", 4.5]}
    for readings in (both(values, often), both(often, values)):
        third = ignition.verdicts(results(values), readings, traces(), np.random.default_rng(0))[2]
        assert (third.verdict, third.because) == (claims.NOT_DECIDABLE, "method")


def test_three_per_cent_among_them_are_of_all_or_of_the_burning(values):
    """Where both shares answer differently the sentence decides nothing."""
    rng = np.random.default_rng(0)
    for early, answers in ((3, {None}), (40, {False})):  # 3 of 100, of which 26 burn: 11 of 100
        lit = np.full(100, np.nan)
        lit[:26] = 0.25
        lit[:early] = 0.05
        cell = {("confetti", 4.5): values["confetti", 4.5]._replace(ignition_s=lit)}
        asked = ignition._printed_shares(values | cell, "confetti", rng)
        found = {v for k, v in asked.items() if k.startswith("ignited < 0.1 s") and "4.5 bar" in k}
        assert found == answers


def test_refused_flights_do_not_count_towards_a_verdict(values):
    few = results(values)
    flights = few.tables.flights
    refused = flights.assign(refused=np.where(flights["particle"] == 0, "too fast", ""))
    few = few._replace(tables=few.tables._replace(flights=refused))
    verdicts = ignition.verdicts(few, both(values), traces(), np.random.default_rng(0))
    assert {each.verdict for each in verdicts} == {claims.NOT_DECIDABLE}


FRAMES = np.arange(20)
FLIGHT = {"t0_s": -0.1, "first_s": 0.0, "last_s": 1.9, "end_s": 1.25, "dwell_s": 1.35}
FLIGHT |= {"ending": "landed", "start_mm": 0.0, "ignition": "none", "ignition_s": np.nan}
FLIGHT |= {"rise_gray": 0.0, "wall_mm": 700.0}


def test_a_trace_counts_up_to_the_landing_and_of_kept_flights_only():
    """The wall ignites all that land (5.1.1)."""
    rows = [FLIGHT | {"particle": k, "from_lance": True, "refused": ""} for k in range(3)]
    rows[2]["refused"] = "too fast"
    flights = pd.DataFrame(rows)[FLIGHTS.names]
    courses = {0: np.where(FRAMES < 8, 900.0, 2000.0), 1: np.where(FRAMES < 13, 900.0, 2000.0)}
    tracks = pd.concat(
        [
            pd.DataFrame({"particle": k, "frame": FRAMES, "time_s": FRAMES / 10, "gray": gray})
            for k, gray in courses.items()
        ]
    ).assign(background=1000.0)
    count = ignition._count_lit(kept(flights), tracks, LitTrace(), pd.Series({0: False, 2: True}))
    assert (count["light_up"], count["light_at_first"], count["too_few"]) == (1, 0, 0)
    assert [count[name] for name in ignition.COUNTS] == [1, 1, 0, 0]
    assert (count["number"], count["estimate"]) == (2, 0.5)


def test_what_truly_ignites_is_known_of_tracks_of_particles_only():
    """Neither of a particle without a track nor of a false flight."""
    columns = {"particle": [7, 8, 9, -1], "track": [0, 1, -1, 2]}
    true = pd.DataFrame(columns | {"true_ignition_s": [0.2, np.nan, 0.1, np.nan]})
    assert ignition._truly_ignite(true).to_dict() == {0: True, 1: False}


def test_rates_of_hits_and_false_alarms():
    both = pd.DataFrame(
        {
            "fraction": "confetti",
            "pressure_bar": 4.5,
            "particle": range(6),
            "measurable": True,
            "track": [0, 1, 2, 3, 4, -1],
            "true_ignition_s": [0.1, 0.2, np.nan, np.nan, np.nan, 0.1],
            "measured_ignition_s": [0.13, np.nan, 0.3, np.nan, np.nan, np.nan],
        }
        | {
            f"{kind}_{name}": 1.0
            for kind in ("true", "measured")
            for name in ("dwell_s", "velocity_m_s")
        }
    )
    row = ignition.ignition_errors({"one": both}).iloc[0]
    assert (row["lit"], row["unlit"]) == (2, 3)  # of the five that were detected
    assert row["hit_percent"] == pytest.approx(50)
    assert row["false_alarm_percent"] == pytest.approx(33.33)
    assert row["time_error_median_s"] == pytest.approx(0.03)


def test_the_optical_picture_keeps_the_greatest_difference_light_or_dark():
    """A silhouette passes dark, a flame light, in whichever stretch of frames."""
    images = np.full((200, 24, 32), 1000, np.uint16)
    images[100:] = 1300  # the kiln brightens
    images[3, 5, 7] = 400  # a silhouette
    images[20, 5, 7] = 1100  # less
    images[150, 9, 9] = 5000  # a flame
    recording = ArrayRecording(Attributes("array", 100.0, 24, 32), images)
    total = ignition.optical_picture(recording, range(200))
    assert (total[5, 7], total[9, 9]) == (700, 5000)
    rest = np.delete(total.ravel(), [5 * 32 + 7, 9 * 32 + 9])
    assert set(rest) == {1300}
    with pytest.raises(InputError, match="no frame"):
        ignition.optical_picture(recording, range(0))


def test_the_greatest_difference_that_is_kept_is_its_definition():
    rng = np.random.default_rng(2)
    pictures = rng.integers(0, 9, (30, 500), dtype=np.uint16)  # many differences are equal
    background = rng.integers(0, 9, 500).astype(np.float32)
    fast = np.zeros(500, np.float32)
    for picture in pictures:
        ignition.keep_greatest(picture, background, fast)
    changes = pictures - background
    first = np.abs(changes).argmax(axis=0)
    assert np.array_equal(fast, changes[first, np.arange(500)])


def test_a_picture_of_no_campaign_is_refused(values):
    with pytest.raises(InputError, match="no campaign"):
        ignition.draw_optical_pictures(results(values), 4.5)
