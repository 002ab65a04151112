"""What the left image shows: sky, horizon, shadow, featureless ground."""

from __future__ import annotations

from typing import ClassVar

import cv2
import numpy as np
from numpy.typing import NDArray

from modules.measurement.sample import Gray, Sample
from modules.primitives.photometry import shrink
from modules.primitives.sky import find_sky
from modules.probe import FactModel, Probe, quantity
from modules.types import Mask

WIDTH_PX = 320  # of the copy that is looked at
WINDOW_PX = 7  # of the copy
FEATURELESS_DN = 2.0  # local deviation; the limit of correction.mask_featureless
SHADOW_SHARE = 0.45  # of the median brightness of what is no sky; sunlit ground is two to five times brighter
SMALLEST_PX = 5  # side of the smallest shadow, of the copy


class Scene(FactModel):
    """Shares of the left image; a smooth bright wall at the top passes for sky, a dark object for a shadow."""

    template: ClassVar[str] = "scene"

    sky_fraction: float = quantity("Pixels of the sky", ge=0, le=1, resolution=0.001)
    horizon_fraction: float | None = quantity(
        "Median row of the lower border of the sky over the height; absent without sky",
        ge=0,
        le=1,
        resolution=0.001,
        default=None,
    )
    shadow_fraction: float = quantity(
        "Pixels below the sky in dark patches, darker than 0.45 of the median", ge=0, le=1, resolution=0.001
    )
    featureless_fraction: float = quantity(
        "Pixels below the sky around which nothing varies by 2 dn", ge=0, le=1, resolution=0.001
    )


def measure_scene(sample: Sample) -> list[Scene]:
    """Return the one `scene` fact of the pair."""
    gray = sample.half[0] if sample.shape[1] >= 2 * WIDTH_PX else sample.gray8[0]
    if gray.shape[1] > WIDTH_PX:
        gray = shrink(gray, WIDTH_PX, max(1, round(gray.shape[0] * WIDTH_PX / gray.shape[1])))
    sky = find_sky(gray)
    ground = ~sky
    if not ground.any():
        return [Scene(sky_fraction=1.0, horizon_fraction=1.0, shadow_fraction=0.0, featureless_fraction=0.0)]
    return [
        Scene(
            sky_fraction=float(sky.mean()),
            horizon_fraction=_horizon(sky),
            shadow_fraction=float(_shadows(gray, ground)[ground].mean()),
            featureless_fraction=float(_featureless(gray)[ground].mean()),
        )
    ]


def _horizon(sky: Mask) -> float | None:
    """Return the median over the columns with sky of the row below its lowest pixel, over the height."""
    columns = sky.any(axis=0)
    if not columns.any():
        return None
    below = sky.shape[0] - np.argmax(sky[::-1, columns], axis=0)
    return float(np.median(below) / sky.shape[0])


def _shadows(gray: Gray, ground: Mask) -> NDArray[np.bool_]:
    level = cv2.boxFilter(gray, cv2.CV_32F, (3, 3))
    dark = (level < SHADOW_SHARE * float(np.median(gray[ground]))) & ground
    return np.asarray(cv2.morphologyEx(dark.astype(np.uint8), cv2.MORPH_OPEN, np.ones((SMALLEST_PX, SMALLEST_PX))) > 0)


def _featureless(gray: Gray) -> NDArray[np.bool_]:
    window = (WINDOW_PX, WINDOW_PX)
    mean = np.asarray(cv2.boxFilter(gray, cv2.CV_32F, window))
    return np.asarray(cv2.sqrBoxFilter(gray, cv2.CV_32F, window) - mean * mean < FEATURELESS_DN**2)


PROBE = Probe(
    "measurement.scene",
    (Scene,),
    measure_scene,
    "medium",
    "pair",
    "Finds the sky, the horizon, shadows and featureless ground.",
)
