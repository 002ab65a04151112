"""Compare two systems on the same cases, and say whether the difference is more than chance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.stats import wilcoxon

from expert.evaluate.table import BOOTSTRAP_ROUNDS, INTERVAL, Table, resample


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
    p_value : float or None
        Wilcoxon's signed-rank test on the mean differences of the scenes; None where all are equal.
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
    better: int
    worse: int
    equal: int
    largest: tuple[tuple[str, float], ...]

    def text(self) -> str:
        """Write it for a terminal."""
        chance = "no scene differs" if self.p_value is None else f"p = {self.p_value:.3g} (Wilcoxon, by scene)"
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
    names = np.unique(table.scenes)
    by_scene = np.array([difference[table.scenes == name].mean() for name in names])
    draws = [float(difference[index].mean()) for index in resample(table.scenes, BOOTSTRAP_ROUNDS, seed)]
    low, high = np.percentile(draws, INTERVAL)
    changed = by_scene[np.abs(by_scene) > 1e-12]
    order = np.argsort(-np.abs(difference), kind="stable")[:most]
    return Comparison(
        a,
        b,
        len(table),
        len(names),
        float(both[:, 0].mean()),
        float(both[:, 1].mean()),
        float(difference.mean()),
        (float(low), float(high)),
        float(wilcoxon(changed).pvalue) if len(changed) else None,
        int((difference < 0).sum()),
        int((difference > 0).sum()),
        int((difference == 0).sum()),
        tuple((table.rows[i][0].case, float(difference[i])) for i in order if difference[i] != 0),
    )
