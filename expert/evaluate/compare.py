"""Compare two systems on the same cases, and say whether the difference is more than chance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import wilcoxon

from expert.evaluate.table import BOOTSTRAP_ROUNDS, INTERVAL, Floats, Table, resample


@dataclass(frozen=True)
class Comparison:
    """System `b` against system `a`; negative differences are in favour of `b`.

    Attributes
    ----------
    a, b : str
    cases, scenes : int
    mean_a, mean_b, difference : float
        Mean losses and their difference.
    interval : (float, float)
        95 % interval of the difference by a bootstrap over scenes.
    p_value, p_pairs : float or None
        Wilcoxon's signed-rank test on the mean differences of the scenes, and of the pairs; None where all are equal.
        Pairs of one scene are alike, so the test by pairs is the more generous one.
    better, worse, equal : int
        Cases in which `b` has the lower, higher, same loss.
    largest : tuple of (case, difference)
        The cases that differ most.
    """

    a: str
    b: str
    cases: int
    scenes: int
    mean_a: float
    mean_b: float
    difference: float
    interval: tuple[float, float]
    p_value: float | None
    p_pairs: float | None
    better: int
    worse: int
    equal: int
    largest: tuple[tuple[str, float], ...]

    def text(self) -> str:
        """Write it for a terminal."""
        chance = (
            "no pair differs"
            if self.p_value is None or self.p_pairs is None
            else f"p = {self.p_pairs:.3g} by pairs, {self.p_value:.3g} by scenes (Wilcoxon)"
        )
        lines = [
            f"{self.cases} cases of {self.scenes} scenes, mean bad-1: {self.a} {self.mean_a:.2f} %, {self.b} "
            f"{self.mean_b:.2f} %",
            f"difference {self.difference:+.2f} [{self.interval[0]:+.2f}, {self.interval[1]:+.2f}], {chance}",
            f"{self.b} is better in {self.better} cases, worse in {self.worse}, equal in {self.equal}",
        ]
        lines += [f"  {case:50s} {value:+.2f}" for case, value in self.largest]
        return "\n".join(lines) + "\n"


def compare(table: Table, a: str, b: str, loss: str = "bad_1", most: int = 10, seed: int = 0) -> Comparison:
    """Compare two systems of a table case by case.

    Raises
    ------
    ValueError
        There is no case that both were run on.

    References
    ----------
    J. Demsar, Statistical comparisons of classifiers over multiple data sets, JMLR 7, 2006.
    """
    if not len(table):
        raise ValueError(f"{a} and {b} have no case in common")
    both = table.losses([a, b], loss)
    difference = both[:, 1] - both[:, 0]
    draws = [float(difference[index].mean()) for index in resample(table.scenes, BOOTSTRAP_ROUNDS, seed)]
    low, high = np.percentile(draws, INTERVAL)
    order = np.argsort(-np.abs(difference), kind="stable")[:most]
    return Comparison(
        a,
        b,
        len(table),
        len(np.unique(table.scenes)),
        float(both[:, 0].mean()),
        float(both[:, 1].mean()),
        float(difference.mean()),
        (float(low), float(high)),
        _p_value(difference, table.scenes),
        _p_value(difference, np.array([rows[0].pair for rows in table.rows])),
        int((difference < 0).sum()),
        int((difference > 0).sum()),
        int((difference == 0).sum()),
        tuple((table.rows[i][0].case, float(difference[i])) for i in order if difference[i] != 0),
    )


def _p_value(difference: Floats, units: NDArray[np.str_]) -> float | None:
    """Test the mean differences of units, e.g. scenes: None where no unit differs."""
    means = np.array([difference[units == name].mean() for name in np.unique(units)])
    changed = means[np.abs(means) > 1e-12]
    return float(wilcoxon(changed).pvalue) if len(changed) else None
