import numpy as np
import pytest
from scipy import stats

from kilnflight.checks import InputError
from kilnflight.experiments.importance import effective, sample_posterior

PRIOR = {"a": stats.norm(0.0, 4.0), "b": stats.uniform(-50.0, 100.0)}


def bell(point):
    """a is 3 +- 1, and b lies 10 +- 0.5 above a."""
    return -0.5 * (point[0] - 3.0) ** 2 - 0.5 * ((point[1] - point[0] - 10.0) / 0.5) ** 2


@pytest.mark.parametrize("rounds", [(512, 256, 512), (1024, 256, 1024)])
def test_a_posterior_that_is_known_is_found(rounds):
    posterior = sample_posterior(PRIOR, bell, rounds, 3)
    mean, spread = posterior.moments()
    a_mean, a_variance = 3.0 * 16 / 17, 16 / 17
    assert posterior.effective > 100
    np.testing.assert_allclose(mean, [a_mean, a_mean + 10.0], atol=0.2)
    np.testing.assert_allclose(spread, np.sqrt([a_variance, a_variance + 0.25]), rtol=0.15)


def test_without_data_the_posterior_is_the_prior():
    posterior = sample_posterior(PRIOR, lambda _: 0.0, (512, 512), 1)
    mean, spread = posterior.moments()
    np.testing.assert_allclose(mean, [0.0, 0.0], atol=2.0)
    np.testing.assert_allclose(spread, [4.0, 100.0 / np.sqrt(12.0)], rtol=0.1)


def test_draws_are_equally_likely_and_reproducible():
    posterior, again = (sample_posterior(PRIOR, bell, (512, 512), 7) for _ in range(2))
    np.testing.assert_array_equal(posterior.points, again.points)
    draws = posterior.resampled(2000, 1)
    np.testing.assert_array_equal(draws, again.resampled(2000, 1))
    np.testing.assert_allclose(draws.mean(axis=0), posterior.moments()[0], atol=0.05)


def test_nothing_is_drawn_where_nothing_can_be():
    posterior = sample_posterior(PRIOR, lambda p: bell(p) if p[0] > 2.0 else -np.inf, (512, 512), 2)
    assert (posterior.resampled(500, 0)[:, 0] > 2.0).all()
    assert (posterior.weights[~np.isfinite(posterior.log_density)] == 0.0).all()
    low, width = PRIOR["b"].support()
    assert ((posterior.resampled(500, 0)[:, 1] >= low) & (posterior.points[0, 1] <= width)).all()


def test_a_likelihood_that_no_draw_meets_is_told():
    with pytest.raises(InputError, match="no draw agrees"):
        sample_posterior(PRIOR, lambda _: -np.inf, (64, 64), 1)
    with pytest.raises(InputError, match="hardly any"):
        sample_posterior(PRIOR, lambda p: 0.0 if p[0] > 8.0 else -np.inf, (64, 64), 1)


def test_the_effective_size_of_weights():
    assert effective(np.ones(7)) == pytest.approx(7.0)
    assert effective(np.array([1.0, 0.0, 0.0])) == pytest.approx(1.0)
