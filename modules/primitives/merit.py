"""How good a disparity map is as a whole, without a reference: what trials of one pair are ordered by."""

from __future__ import annotations

import cv2
import numpy as np

from modules.primitives import merit_weights
from modules.primitives.agreement import Evidence
from modules.primitives.confidence import chance_factor, mean_code
from modules.types import FloatImage


def map_features(evidence: Evidence, confidence: FloatImage) -> dict[str, float]:
    """Return what the merit is a weighted sum of, by name.

    `expected`, the share of the wanted pixels that are right as far as the confidence knows; `density`, the share that
    has a disparity; `agreement` of the images; the mean code of `roughness`; `edges` of the image where objects end.
    """
    valid = int(np.count_nonzero(evidence.valid))
    believed = cv2.sumElems(confidence)[0] / max(valid, 1)  # the confidence is 0 elsewhere
    return {
        "expected": believed * evidence.density,
        "density": evidence.density,
        "agreement": evidence.agreement or 0.0,
        "roughness": mean_code(evidence, "roughness") or 0.0,
        "edges": evidence.edges,
    }


def predict_merit(evidence: Evidence, confidence: FloatImage) -> float:
    """Return the share of the wanted pixels that are right within 1 px, predicted from the map as a whole, 0 to 1.

    The confidence sees one pixel at a time, and to it a map that was smoothed too much is as credible as one that was
    not; here what differs between the maps of one pair is weighed against the truth. Use it to order maps of one pair;
    the difficulty of the pair itself is hardly in it.

    Notes
    -----
    The weights are fitted by `benchmarks/quality_score.py` to the differences between configurations on the same pair.
    """
    if not evidence.valid.any():
        return 0.0
    features = map_features(evidence, confidence)
    total = merit_weights.CONSTANT + sum(merit_weights.WEIGHTS[name] * value for name, value in features.items())
    return chance_factor(evidence.over_chance) * float(np.clip(total, 0.0, 1.0))
