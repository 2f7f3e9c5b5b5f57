"""The campaigns with the other value of a choice that the thesis does not print.

Detections and tracks stay; regression and flights are computed again
(data/reference/choices.csv).
"""

from collections.abc import Callable
from dataclasses import replace

from kilnflight.chain import Chain
from kilnflight.experiments.flights.campaigns import (
    Campaign,
    Results,
    measure_campaigns,
    twin_of,
    values_by_campaign,
)
from kilnflight.flight import Plausible
from kilnflight.ignition import Ignition
from kilnflight.regression import Regression
from kilnflight.store.parallel import Workers


def true_outlet(campaign: Campaign) -> Chain:
    """Return the run with the lance where it is, not where the camera sees it."""
    x, y, z = twin_of(campaign).scene.geometry.lance_mm.tolist()
    return replace(campaign.run, exit_point_mm=(x, y, z))


def rmse_alone(campaign: Campaign) -> Chain:
    """Return the run whose orders rise as long as the RMSE alone falls."""
    return replace(campaign.run, regression=Regression(measures=("rmse_mm",)))


def rejecting(campaign: Campaign) -> Chain:
    """Return the run that rejects impossible flights, as ``kilnflight run`` does."""
    rules = replace(campaign.run.rules, plausible=Plausible())
    return replace(campaign.run, rules=rules)


def gray_alone(campaign: Campaign) -> Chain:
    """Return the run that takes a rise of the grey value itself as ignition."""
    rules = campaign.run.rules
    if rules.ignition is None:
        return campaign.run
    gray = Ignition(above_background=False)
    return replace(campaign.run, rules=replace(rules, ignition=gray))


# Ids of data/reference/choices.csv.
OTHERS: dict[str, Callable[[Campaign], Chain]] = {
    "F1": true_outlet,
    "F2": rmse_alone,
    "F6": rejecting,
    "F7": gray_alone,
}


def varied(
    results: Results, change: Callable[[Campaign], Chain], jobs: int = 1
) -> Results:
    """Return the results with other runs; ``jobs`` processes make missing tables."""
    changed = [each._replace(run=change(each)) for each in results.campaigns]
    tables = measure_campaigns(changed, Workers(jobs))
    measured = values_by_campaign(tables, results.measured)
    return results._replace(campaigns=changed, tables=tables, measured=measured)
