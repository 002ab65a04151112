"""Matching: the disparity range, the matchers, the checks that reject and the filters that refine.

Slots, in order: range, matcher, consistency, uniqueness, speckles, refine.
"""

from modules.matching.block_match import OPERATOR as BLOCK_MATCH
from modules.matching.check_left_right import OPERATOR as CHECK_LEFT_RIGHT
from modules.matching.check_uniqueness import OPERATOR as CHECK_UNIQUENESS
from modules.matching.median_filter import OPERATOR as MEDIAN_FILTER
from modules.matching.remove_speckles import OPERATOR as REMOVE_SPECKLES
from modules.matching.semi_global_block_match import OPERATOR as SEMI_GLOBAL_BLOCK_MATCH
from modules.matching.semi_global_match import OPERATOR as SEMI_GLOBAL_MATCH
from modules.matching.use_range import OPERATOR as USE_RANGE
from modules.operator import Operator

OPERATORS: tuple[Operator, ...] = (
    USE_RANGE,
    BLOCK_MATCH,
    SEMI_GLOBAL_BLOCK_MATCH,
    SEMI_GLOBAL_MATCH,
    CHECK_LEFT_RIGHT,
    CHECK_UNIQUENESS,
    REMOVE_SPECKLES,
    MEDIAN_FILTER,
)

__all__ = ["OPERATORS"]
