"""Medians and robust fits."""

import numpy as np
import pytest

from modules.primitives.statistics import fit_linear, median, percentiles, solve_weighted


@pytest.mark.parametrize("count", [1, 2, 3, 50, 51])
def test_the_median_is_that_of_numpy(count) -> None:
    values = np.random.default_rng(count).normal(size=count)
    assert median(values) == float(np.median(values))


def test_a_line_is_fitted_beside_outliers() -> None:
    random = np.random.default_rng(0)
    x = random.uniform(-1, 1, 400)
    y = 3 + 2 * x + random.normal(0, 0.01, 400)
    y[:100] += 5
    coefficients, covariance, weights = fit_linear(np.stack([np.ones_like(x), x], axis=1), y, 0.001)
    assert coefficients == pytest.approx([3, 2], abs=0.005)  # several of the standard errors of 0.0006 and 0.001
    assert np.sqrt(np.diag(covariance)) == pytest.approx([0.0006, 0.001], rel=0.3)
    assert weights[:100].max() == 0


def test_weights_count_as_repetitions() -> None:
    random = np.random.default_rng(1)
    design, values, times = random.normal(size=(20, 3)), random.normal(size=20), random.integers(1, 5, 20)
    repeated = np.linalg.lstsq(np.repeat(design, times, axis=0), np.repeat(values, times), rcond=None)[0]
    assert solve_weighted(design, values, times.astype(float)) == pytest.approx(repeated, rel=1e-8)


@pytest.mark.parametrize("second", [np.zeros(50), np.full(50, 5.0), np.linspace(-1, 1, 50)])
def test_columns_that_depend_on_each_other_still_give_a_fit(second) -> None:
    design = np.stack([np.ones(50), second, second], axis=1)
    values = design.sum(axis=1)
    assert design @ fit_linear(design, values, 0.01)[0] == pytest.approx(values, abs=1e-6)


@pytest.mark.parametrize("count", [1, 2, 50, 101])
def test_percentiles_are_those_of_numpy(count) -> None:
    values, percents = np.random.default_rng(count).normal(size=count).astype(np.float32), (0.0, 12.5, 99.0, 100.0)
    assert percentiles(values, percents) == pytest.approx(np.percentile(values.astype(float), percents), abs=1e-12)
