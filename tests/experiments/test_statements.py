import numpy as np
import pandas as pd
import pytest

from kilnflight.experiments import statements
from kilnflight.project import claims
from kilnflight.scores import flights as flight_scores
from kilnflight.twin import truth
from kilnflight.twin.flight import Flight
from kilnflight.twin.gas import Gas


def test_every_number_about_flight_and_ignition_is_expressed():
    rows = claims.published("flight", as_printed=True)
    numbers = rows[(rows["value_low"] != "") | (rows["value_high"] != "")]
    left_out = [row["quantity"] for _, row in numbers.iterrows() if not statements.outcome_of(row)]
    assert set(left_out) == {"sequence_length"}


def test_every_statement_names_an_outcome():
    flights = truth.released("confetti", 4.5, (Flight(step_s=2e-3), Gas()), 5, 1)
    assert set(statements.statements()["outcome"]) <= set(
        flight_scores.outcomes(truth.flight_values(flights)).index
    )


def test_the_calibration_sees_only_its_cells_and_no_ignition_times():
    said = statements.targets()
    assert set(zip(said["fraction"], said["pressure_bar"], strict=True)) == set(statements.CELLS)
    kinds = set(said["outcome"].str.split(" ").str[0])
    assert kinds == {"velocity", "remaining", "dwell", "ignited"}
    assert set(said.loc[said["outcome"].str.startswith("ignited"), "outcome"]) == {"ignited (%)"}
    everything = statements.statements()
    held_out = everything[everything["use"] == statements.HELD_OUT]
    assert {"PE granule", "paper shred"} <= set(held_out["fraction"])
    assert (everything.loc[everything["pressure_bar"] == 5, "use"] == statements.HELD_OUT).all()


@pytest.mark.parametrize(
    ("low", "high", "value", "misfit"),
    [
        (7.4, 7.4, 7.9, 1.0),  # 0.5 m/s is a unit where one value is printed
        (7.4, np.nan, 9.0, 0.0),
        (7.4, np.nan, 6.4, 2.0),
        (np.nan, 13.5, 14.5, 2.0),
        (8.0, 12.0, 16.0, 2.0),  # half the width is more than 0.5
        (8.0, 12.0, 9.0, 0.0),
        (4.0, 4.0, np.nan, 8.0),  # nothing passed: as far out as a standstill
    ],
)
def test_a_misfit_is_the_distance_from_the_bounds(low, high, value, misfit):
    said = pd.DataFrame([{"outcome": "velocity 0-1 m (m/s)", "low": low, "high": high}])
    assert statements.misfits(said, pd.Series([value]))[0] == pytest.approx(misfit)
