"""Group pixels of similar disparity, and remove or re-label the small groups."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from modules.matching.common import require_disparity
from modules.operator import Cost, Operator, OperatorParams
from modules.types import FloatImage, Invalid, Mask, Matching

EVERY, FIRST, LAST = slice(None), slice(None, -1), slice(1, None)
NEIGHBOURS = (((EVERY, FIRST), (EVERY, LAST)), ((FIRST, EVERY), (LAST, EVERY)))  # along the rows, along the columns


class ClusterDisparitiesParams(OperatorParams):
    """Parameters of `cluster_disparities`."""

    max_size_px: int = Field(100, ge=0, le=100000, description="Largest area of a group that counts as small, px")
    max_difference_px: float = Field(
        1.0, ge=0.0625, le=16.0, description="Largest difference of neighbours in one group, px"
    )
    small: Literal["remove", "relabel"] = Field(
        "relabel", description="Remove small groups, or give those that one large group encloses its disparity"
    )
    enclosed: float = Field(
        0.8, ge=0.5, le=1.0, description="Least share of a group's border that one large group must hold"
    )


def group(disparity: FloatImage, max_difference_px: float) -> NDArray[np.int32]:
    """Return the number of each pixel's 4-connected group of similar disparity, -1 where there is no disparity."""
    rows, columns = disparity.shape
    index = np.arange(rows * columns).reshape(rows, columns)
    valid = np.isfinite(disparity)
    ends = []
    for one, other in NEIGHBOURS:
        with np.errstate(invalid="ignore"):
            linked = np.abs(disparity[one] - disparity[other]) <= max_difference_px
        ends.append((index[one][linked], index[other][linked]))
    first, second = (np.concatenate(part) for part in zip(*ends, strict=True))
    graph = coo_array((np.ones(len(first), np.int8), (first, second)), shape=(index.size, index.size))
    _, labels = connected_components(graph, directed=False)
    return np.where(valid, labels.reshape(rows, columns), -1).astype(np.int32)


def cluster_disparities(state: Matching, params: ClusterDisparitiesParams) -> Matching:
    """Remove small groups of similar disparity, or give them the disparity of the group that encloses them.

    Parameters
    ----------
    state : Matching
        With a disparity.
    params : ClusterDisparitiesParams

    Returns
    -------
    Matching
        Small groups are either gone, with `Invalid.SPECKLE`, or have the median disparity of the enclosing group along
        their border; the others are unchanged.

    Raises
    ------
    OperatorError
        If no matcher has run.

    Notes
    -----
    After Correal, Pajares & Ruz: connected groups of similar disparity are formed and the small ones removed or
    re-labelled. How theirs are formed and re-labelled in detail is not known to us.

    References
    ----------
    R. Correal, G. Pajares and J. J. Ruz, disparity clustering, Revista Iberoamericana de Automatica e Informatica
    Industrial, 2013.
    """
    disparity = require_disparity(state, "matching.cluster_disparities")
    if not disparity.valid.any():
        return state
    labels = group(disparity.disparity_px, params.max_difference_px)
    sizes = np.bincount(labels[labels >= 0], minlength=int(labels.max()) + 1)
    small: Mask = (labels >= 0) & (sizes[labels] <= params.max_size_px)
    values = disparity.disparity_px.copy()
    if params.small == "relabel":
        for number, value in _enclosing(labels, small, disparity.disparity_px, params.enclosed).items():
            values[labels == number] = value
            small &= labels != number
    return replace(state, disparity=replace(disparity, disparity_px=values).reject(small, Invalid.SPECKLE))


def _enclosing(labels: NDArray[np.int32], small: Mask, disparity: FloatImage, enclosed: float) -> dict[int, float]:
    """Return for each small group that one large group encloses the median disparity of that group along the border."""
    inner, outer, value = [], [], []
    for one, other in NEIGHBOURS:
        for inside, beside in ((one, other), (other, one)):
            border = small[inside] & (labels[inside] != labels[beside])
            inner.append(labels[inside][border])
            outer.append(np.where(small[beside], -1, labels[beside])[border])
            value.append(disparity[beside][border])
    groups, around, values = (np.concatenate(part) for part in (inner, outer, value))
    found = {}
    order = np.argsort(groups, kind="stable")
    edges = np.flatnonzero(np.diff(groups[order])) + 1
    for part in np.split(order, edges) if len(order) else []:
        large = around[part][around[part] >= 0]
        if not len(large):
            continue
        names, counts = np.unique(large, return_counts=True)
        best = names[counts.argmax()]
        if counts.max() >= enclosed * len(part):
            found[int(groups[part[0]])] = float(np.median(values[part][around[part] == best]))
    return found


OPERATOR = Operator(
    name="matching.cluster_disparities",
    slot="speckles",
    params=ClusterDisparitiesParams,
    function=cluster_disparities,
    cost=Cost(fixed_ms=1.0, ns_per_pixel=350.0),
    summary="Group pixels of similar disparity, and remove or re-label small groups.",
    suits="Maps with many small wrong islands inside large surfaces; dearer than removing speckles.",
)
