"""Predict how far each disparity can be trusted, and reject those that cannot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pydantic import Field

from modules.matching.common import require_disparity
from modules.operator import Cost, Operator, OperatorParams
from modules.primitives.agreement import gather_evidence
from modules.primitives.confidence import predict_confidence, predict_sigma_px
from modules.primitives.merit import predict_merit
from modules.types import Invalid, Matching


class EstimateConfidenceParams(OperatorParams):
    """Parameters of `estimate_confidence`."""

    least: float = Field(
        0.25, ge=0.0, le=1.0, description="Pixels less likely than this to be right within 1 px are rejected; 0: none"
    )
    same_scene: bool = Field(
        False,
        description="The images are known to show one scene; otherwise that is asked of the pair, which takes longer",
    )


def estimate_confidence(state: Matching, params: EstimateConfidenceParams) -> Matching:
    """Predict the probability that each disparity is right within 1 px and its standard deviation; reject the unlikely.

    The evidence is what any matcher leaves: correlation and misfit of the two images around the pixel and its
    match, how far that is from the better part of the map, agreement with the disparity of the match, the excess of
    the second best cost where the matcher knows it, the neighbouring disparities, and the agreement over the map as
    a whole. The images are those that the cameras saw, whatever corrections the matcher was given. Whether they
    show one scene at all is asked of the pair itself unless it is known: it has to match better than with its right
    image upside down.

    Parameters
    ----------
    state : Matching
        With a disparity.
    params : EstimateConfidenceParams

    Returns
    -------
    Matching
        With `confidence` float32 (H, W), 0 where there is no disparity, `sigma_px` float32 (H, W), NaN there, and
        `merit`, the share of pixels that are right, predicted before any is rejected;
        rejected pixels carry `Invalid.LOW_CONFIDENCE` and keep both.

    Raises
    ------
    OperatorError
        If no matcher has run.

    Notes
    -----
    On scenes left out of the fit (`benchmarks.calibrate_confidence`), the limit of 0.25 takes the wrong among valid
    of the robust matcher from 8.2 to 7.6 % for 1.1 % of its pixels, one of 0.5 to 6.4 % for 3.9 %. Of wrong patches
    put into good maps these limits reject 85 and 93 % of the pixels; of images that cannot match (two scenes,
    noise, a pattern that repeats along the rows, nothing) they keep none.
    `sigma_px` describes pixels whose match is right; whether it is, the confidence says. A pattern that repeats along
    the rows agrees with the images at several disparities: use `check_uniqueness` there.

    References
    ----------
    X. Hu and P. Mordohai, A quantitative evaluation of confidence measures for stereo vision, IEEE TPAMI 34(11), 2012.
    """
    disparity = require_disparity(state, "matching.estimate_confidence")
    asked = None if params.same_scene else state.range_px
    evidence = gather_evidence(*state.views.as_seen, disparity, asked)
    confidence = predict_confidence(evidence)
    known = replace(
        disparity,
        confidence=confidence,
        sigma_px=predict_sigma_px(evidence),
        merit=predict_merit(evidence, confidence),
    )
    return replace(state, disparity=known.reject(confidence < np.float32(params.least), Invalid.LOW_CONFIDENCE))


OPERATOR = Operator(
    name="matching.estimate_confidence",
    slot="confidence",
    params=EstimateConfidenceParams,
    function=estimate_confidence,
    cost=Cost(fixed_ms=1.5, ns_per_pixel=25.0),
    summary="Predict for each pixel whether its disparity is right and how exact, and reject the unlikely ones.",
    suits="After all checks; a higher limit trades density for fewer wrong pixels. Empties unrelated images.",
)
