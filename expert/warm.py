"""What the decision about an earlier pair tells about the next one of a sequence, and how much has changed since.

Nothing is kept between pairs: the caller hands the earlier decision on, and what follows from it are facts that rules
read and the report shows.
"""

from __future__ import annotations

import base64
from dataclasses import asdict
from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

from expert.decision import Decision, FactRecord
from expert.facts import PreviousPair, Scalar
from expert.pair import StereoPair
from modules.primitives.photometry import to_8_bit, to_gray
from modules.types import Image

THUMBNAIL = (24, 18)  # columns and rows
ALIGN, RANGE = "correction.align_rows", "matching.use_range"


def thumbnail(image: Image) -> str:
    """Return a tiny gray copy of an image as base64, uint8 by rows; what changes between pairs is measured on it."""
    step = max(1, min(image.shape[1] // (8 * THUMBNAIL[0]), image.shape[0] // (8 * THUMBNAIL[1])))
    small = cast(Image, cv2.resize(image[::step, ::step], THUMBNAIL, interpolation=cv2.INTER_AREA))
    return base64.b64encode(to_8_bit(to_gray(small)).tobytes()).decode("ascii")


def change_dn(before: str, after: str) -> tuple[float, float]:
    """Return how far two thumbnails differ, dn: in place after equalising their means, and in their gray levels.

    Examples
    --------
    >>> import numpy as np
    >>> flat, bright = (thumbnail(np.full((36, 48), level, np.uint8)) for level in (90, 100))
    >>> change_dn(flat, bright)
    (0.0, 10.0)
    """
    one, other = _levels(before), _levels(after)
    in_place = float(np.mean(np.abs((one - one.mean()) - (other - other.mean()))))
    return in_place, float(np.mean(np.abs(np.sort(one) - np.sort(other))))


def _levels(text: str) -> NDArray[np.float64]:
    return np.frombuffer(base64.b64decode(text), np.uint8).astype(np.float64)


def previous_pair(earlier: Decision, pair: StereoPair) -> PreviousPair | None:
    """Return what an earlier decision tells about a pair; None where it tells nothing, as after a failure."""
    if not earlier.thumbnail or earlier.status == "failed" or "matching" not in earlier.plans:
        return None
    in_place, in_levels = change_dn(earlier.thumbnail, thumbnail(pair.left))
    searched = _parameters(earlier, RANGE)
    aligned = _parameters(earlier, ALIGN)
    rows = _number(earlier, "row_alignment", "count")
    if rows is None and any(fact.template == "previous" and fact.fields.get("same_rig") for fact in earlier.facts):
        rows = _number(earlier, "previous", "rows_count")
    return PreviousPair(
        same_rig=_same_rig(earlier, pair),
        change_dn=in_place,
        level_change_dn=in_levels,
        min_px=searched.get("min_px"),
        max_px=searched.get("max_px"),
        rows_count=None if rows is None else int(rows),
        rows_aligned=bool(aligned),
        offset_px=aligned.get("offset_px"),
        roll_deg=aligned.get("roll_deg"),
        row_scale=aligned.get("row_scale"),
        radiometry=earlier.operator("correction.radiometry"),
        density_fraction=_number(earlier, "disparity_quality", "density_fraction"),
    )


def _same_rig(earlier: Decision, pair: StereoPair) -> bool:
    """Whether images, calibration and given range are of the kind of the earlier pair."""
    given, camera = earlier.inputs, pair.calibration
    return (
        tuple(given.left.shape) == pair.left.shape
        and given.left.dtype == str(pair.left.dtype)
        and given.calibration == (None if camera is None else asdict(camera))
        and given.disparity_range_px == pair.disparity_range_px
    )


def _parameters(decision: Decision, operator: str) -> dict[str, Scalar]:
    return next((dict(step.parameters) for step in decision.steps() if step.operator == operator), {})


def _number(decision: Decision, template: str, name: str) -> float | None:
    found: list[FactRecord] = [fact for fact in decision.facts if fact.template == template]
    value = found[0].fields.get(name) if found else None
    return float(value) if isinstance(value, int | float) else None
