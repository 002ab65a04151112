"""Errors of a disparity against its truth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from modules.types import FloatImage, Mask


@dataclass(frozen=True)
class Scores:
    """Errors over the scored pixels.

    Attributes
    ----------
    bad_05, bad_1, bad_2 : float
        Share of the pixels that are wrong by more than 0.5, 1 and 2 px; missing counts as wrong. %.
    wrong : float or None
        Share of the valid pixels that are wrong by more than 1 px, %; None where nothing is valid.
    density : float
        Share of the pixels with a disparity, %.
    epe_px : float or None
        Mean absolute error of the valid pixels (end-point error), px.
    """

    bad_05: float
    bad_1: float
    bad_2: float
    wrong: float | None
    density: float
    epe_px: float | None


def score(disparity_px: FloatImage | None, truth_px: FloatImage, scored: Mask) -> Scores:
    """Score a disparity.

    Parameters
    ----------
    disparity_px : float32 (H, W) or None
        px, NaN where invalid; None counts as missing everywhere.
    truth_px : float32 (H, W)
    scored : bool (H, W)
        Pixels that count.

    Raises
    ------
    ValueError
        No pixel counts, or the shapes differ.

    Examples
    --------
    >>> truth = np.full((1, 4), 10, np.float32)
    >>> score(np.array([[10.0, 10.7, 13.0, np.nan]], np.float32), truth, truth > 0).bad_1
    50.0
    """
    if not scored.any():
        raise ValueError("no pixel of the truth is known and not occluded; leave this pair out")
    if disparity_px is None:
        return Scores(100.0, 100.0, 100.0, None, 0.0, None)
    if disparity_px.shape != truth_px.shape:
        raise ValueError(f"the disparity is {disparity_px.shape} and the truth {truth_px.shape}")
    error = np.abs(disparity_px - truth_px)[scored].astype(np.float64)
    valid = np.isfinite(error)
    bad_05, bad_1, bad_2 = (100.0 * float(np.mean(~(error <= limit))) for limit in (0.5, 1.0, 2.0))
    some = bool(valid.any())
    return Scores(
        bad_05,
        bad_1,
        bad_2,
        wrong=100.0 * float(np.mean(error[valid] > 1.0)) if some else None,
        density=100.0 * float(valid.mean()),
        epe_px=float(error[valid].mean()) if some else None,
    )
