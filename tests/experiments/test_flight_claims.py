"""Verdicts on flights, on results made by hand."""

import numpy as np
import pandas as pd
import pytest

from kilnflight.experiments import flight_claims, flight_pictures, results
from kilnflight.experiments.campaigns import Measurement
from kilnflight.project import claims
from kilnflight.scores.flights import FlightValues
from kilnflight.twin.particles import FRACTIONS
from kilnflight.twin.scenes import PRESSURES_BAR

KEYS = [(name, bar) for name in FRACTIONS for bar in PRESSURES_BAR]
# seconds of dwell time, as the thesis has them at 4.5 bar
DWELL = {"wood chip": 0.30, "confetti": 0.42, "paper shred": 0.45, "PE granule": 0.48}
SPEED = {"wood chip": 13.5, "confetti": 7.4, "paper shred": 5.2, "PE granule": 9.0}


def flights(name, bar, count=20):
    """Particles that all do the same; PE granules are quicker at 5 bar."""
    shorter = 0.75 if (name, bar) == ("PE granule", 5.0) else 1.0
    velocity = np.full((count, 5), SPEED[name])
    ignition = np.full(count, np.nan)
    ignition[: {"confetti": 5, "paper shred": 14}.get(name, 0)] = 0.2
    dwell = np.full(count, DWELL[name] * shorter)
    return FlightValues(dwell, velocity, ignition, np.full(count, 3.0))


@pytest.fixture
def found():
    return {key: flights(*key) for key in KEYS}


@pytest.fixture
def measured():
    rows = [(*key, k, True) for key in KEYS for k in range(results.LEAST_FLIGHTS)]
    table = pd.DataFrame(rows, columns=[*results.KEYS, "particle", "from_lance"])
    return Measurement(None, None, table, None)


def by_id(verdicts):
    return {one.id: one.verdict for one in verdicts}


def test_dwell_times_as_published_are_reproduced(measured, found):
    verdicts = flight_claims.dwell_verdicts(measured, found, np.random.default_rng(0))
    told = by_id(verdicts)
    assert list(told) == ["dwell-1", "dwell-2", "dwell-3", "dwell-4"]
    assert told["dwell-2"] == told["dwell-3"] == claims.REPRODUCED
    reason = next(one.reason for one in verdicts if one.id == "dwell-2")
    assert "wood chip 4.5 < confetti 4.5" in reason
    slow = found | {("wood chip", 5.0): found["PE granule", 4.5]}
    told = by_id(flight_claims.dwell_verdicts(measured, slow, np.random.default_rng(0)))
    assert told["dwell-2"] == claims.NOT_REPRODUCED


def test_velocities_are_judged_and_what_was_fitted_is_no_result(measured, found):
    published = results.beside_published(found, found, ["velocity", "remaining", "landed"])
    told = by_id(
        flight_claims.velocity_verdicts(measured, found, published, np.random.default_rng(0))
    )
    assert set(told) == {f"vel-{k}" for k in range(1, 7)}
    assert told["vel-1"] == claims.REPRODUCED
    assert told["vel-2"] != claims.REPRODUCED


def test_ignition_is_judged_on_the_published_reading(measured, found):
    published = results.beside_published(found, found, ["ignited"])
    readings = {"as published": found, "above background": found}
    verdicts = flight_claims.ignition_verdicts(
        measured, readings, published, np.random.default_rng(0)
    )
    told = by_id(verdicts)
    assert list(told) == ["ign-1", "ign-2", "ign-3", "ign-4"]
    assert "wood chip 4.5 bar 0" in verdicts[0].measured
    assert "confetti 4.5" in verdicts[3].reason  # whether shares differ beyond chance
    assert "above the background: wood chip 4.5 bar 0 %" in verdicts[0].reason


def test_nothing_is_decided_with_too_few_flights(measured, found):
    few = measured._replace(flights=measured.flights[measured.flights["particle"] > 0])
    told = by_id(flight_claims.dwell_verdicts(few, found, np.random.default_rng(0)))
    assert set(told.values()) == {claims.NOT_DECIDABLE}


def test_pictures_have_a_panel_for_each_campaign_or_fraction(found):
    bounds = results.beside_published(found, found, ["velocity", "remaining", "landed"])
    boxes = flight_pictures.velocity_boxes({"true": found, "measured": found}, KEYS, bounds)
    assert [axes.get_title() for axes in boxes.axes] == [f"{a}, {b} bar" for a, b in KEYS]
    shares = flight_pictures.remaining_shares({"true": found, "measured": found}, bounds)
    assert [axes.get_title() for axes in shares.axes] == list(FRACTIONS)
    papers = [key for key in KEYS if key[0] in flight_claims.PAPERS]
    bars = flight_pictures.ignition_bars({"true": found}, papers, {})
    assert [axes.get_title() for axes in bars.axes] == [f"{a}, {b} bar" for a, b in papers]
