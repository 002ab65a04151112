"""Matching: the disparity range, the matchers, the checks that reject and the filters that refine.

The slots are filled in the order of `SLOTS`.
"""

from modules.matching.block_match import OPERATOR as BLOCK_MATCH
from modules.matching.check_left_right import OPERATOR as CHECK_LEFT_RIGHT
from modules.matching.check_minimum import OPERATOR as CHECK_MINIMUM
from modules.matching.check_range_border import OPERATOR as CHECK_RANGE_BORDER
from modules.matching.check_saturation import OPERATOR as CHECK_SATURATION
from modules.matching.check_texture import OPERATOR as CHECK_TEXTURE
from modules.matching.check_uniqueness import OPERATOR as CHECK_UNIQUENESS
from modules.matching.cluster_disparities import OPERATOR as CLUSTER_DISPARITIES
from modules.matching.estimate_confidence import OPERATOR as ESTIMATE_CONFIDENCE
from modules.matching.fill_gaps import OPERATOR as FILL_GAPS
from modules.matching.median_filter import OPERATOR as MEDIAN_FILTER
from modules.matching.remove_speckles import OPERATOR as REMOVE_SPECKLES
from modules.matching.semi_global_block_match import OPERATOR as SEMI_GLOBAL_BLOCK_MATCH
from modules.matching.semi_global_match import OPERATOR as SEMI_GLOBAL_MATCH
from modules.matching.smooth_along_surfaces import OPERATOR as SMOOTH_ALONG_SURFACES
from modules.matching.use_range import OPERATOR as USE_RANGE
from modules.operator import Operator

SLOTS = (
    "range",
    "matcher",
    "range_border",
    "consistency",
    "uniqueness",
    "texture",
    "saturation",
    "minimum",
    "speckles",
    "refine",
    "confidence",
    "fill",
)

OPERATORS: tuple[Operator, ...] = (
    USE_RANGE,
    BLOCK_MATCH,
    SEMI_GLOBAL_BLOCK_MATCH,
    SEMI_GLOBAL_MATCH,
    CHECK_RANGE_BORDER,
    CHECK_LEFT_RIGHT,
    CHECK_UNIQUENESS,
    CHECK_TEXTURE,
    CHECK_SATURATION,
    CHECK_MINIMUM,
    REMOVE_SPECKLES,
    CLUSTER_DISPARITIES,
    MEDIAN_FILTER,
    SMOOTH_ALONG_SURFACES,
    ESTIMATE_CONFIDENCE,
    FILL_GAPS,
)

__all__ = ["OPERATORS", "SLOTS"]
