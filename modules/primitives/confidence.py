"""From evidence to the probability that a disparity is right, and to its standard deviation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from modules.primitives import confidence_tables as tables
from modules.primitives.agreement import LAST_CODE, UNKNOWN, Evidence, spread
from modules.types import FloatImage

SAMPLE_STEP = 3  # the mean evidence of a map is taken over every third row and column
CHANCE = 0.12  # agreement over chance that pairs of unrelated images do not reach: 0.09 at most of 50
CERTAIN = 0.22  # that pairs of one scene exceed: 0.29 at least, under four times the noise of the reference


@dataclass(frozen=True)
class Table:
    """Contribution of one kind of evidence: values at nodes, linear between them, and where it is unknown."""

    nodes: Sequence[float]
    values: Sequence[float]
    unknown: float = 0.0

    def at(self, value: float | None) -> float:
        """Return the contribution of one value, None where it is unknown."""
        return self.unknown if value is None else float(np.interp(value, self.nodes, self.values))

    def by_code(self) -> FloatImage:
        """Return the contribution of every code, float32 (256,)."""
        found = np.interp(np.arange(256), self.nodes, self.values).astype(np.float32)
        found[UNKNOWN] = self.unknown
        return found


def map_evidence(evidence: Evidence) -> dict[str, float | None]:
    """Return what speaks for the map as a whole: the agreement, and the mean code of every kind; None where unknown."""
    return {kind: evidence.agreement if kind == "agreement" else mean_code(evidence, kind) for kind in tables.MAP}


def mean_code(evidence: Evidence, kind: str) -> float | None:
    """Return the mean code of one kind of fine evidence over the map; None where it is known nowhere."""
    some = (slice(SAMPLE_STEP // 2, None, SAMPLE_STEP),) * 2
    known = evidence.fine[kind][some][evidence.valid[some]]
    known = known[known <= LAST_CODE]
    return float(known.mean()) if known.size else None


def chance_factor(over_chance: float | None) -> float:
    """Return what the agreement over chance leaves of the confidence: nothing where the pair matches by chance only."""
    if over_chance is None:
        return 1.0
    return float(np.clip((over_chance - CHANCE) / (CERTAIN - CHANCE), 0.0, 1.0))


def predict_confidence(evidence: Evidence) -> FloatImage:
    """Return the probability that the error is below 1 px, float32 (H, W), 0 where there is no disparity.

    The log odds are a sum of one table per kind of evidence at the pixel, and one per kind over the whole map: the same
    pixel is less credible in a map that agrees with the images nowhere else. This presumes that the images show one
    scene; where they agree no better than by chance, nothing is credible.

    Notes
    -----
    The tables are fitted by `benchmarks/calibrate_confidence.py`, which also shows how far they hold for scenes that
    they were not fitted to.
    """
    whole = map_evidence(evidence)
    constant = tables.CONSTANT + sum(Table(*table).at(whole[kind]) for kind, table in tables.MAP.items())
    odds = _sum(evidence, tables.PIXEL, constant)
    cv2.exp(np.negative(odds, out=odds), dst=odds)
    odds += np.float32(1.0)
    likely = np.divide(np.float32(chance_factor(evidence.over_chance)), odds, out=odds)
    return np.asarray(cv2.copyTo(likely, evidence.valid.view(np.uint8)), np.float32)  # 0 elsewhere


def predict_sigma_px(evidence: Evidence) -> FloatImage:
    """Return the standard deviation of right disparities, px, float32 (H, W), NaN where there is none."""
    if bool((evidence.fine["excess"] != UNKNOWN).any()):
        logarithm = _sum(evidence, tables.SIGMA, tables.SIGMA_CONSTANT)
    else:
        logarithm = _sum(evidence, tables.SIGMA_WITHOUT_EXCESS, tables.SIGMA_CONSTANT_WITHOUT_EXCESS)
    logarithm *= np.float32(np.log(2.0))
    cv2.exp(logarithm, dst=logarithm)
    logarithm[~evidence.valid] = np.nan
    return logarithm


def _sum(
    evidence: Evidence, kinds: Mapping[str, tuple[tuple[float, ...], tuple[float, ...], float]], constant: float
) -> FloatImage:
    coarse = np.full(next(iter(evidence.coarse.values())).shape, np.float32(constant))
    for kind, codes in evidence.coarse.items():
        cv2.add(coarse, cv2.LUT(codes, Table(*kinds[kind]).by_code()), dst=coarse)
    total = spread(coarse, evidence.valid.shape)
    for kind, codes in evidence.fine.items():
        cv2.add(total, cv2.LUT(codes, Table(*kinds[kind]).by_code()), dst=total)
    return total
