"""The folder of a rendered pair: the inputs of a reconstruction, and its truth."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from modules.formats.atomic import whole_folder
from modules.formats.attitude import write_attitude
from modules.formats.calibration import write_calibration
from modules.formats.disparity import write_pfm
from modules.formats.elevation import write_geotiff
from modules.formats.images import write_image
from modules.types import Attitude, Calibration, ElevationMap, FloatImage, Mask, Mount, Views


def write_rendered_pair(
    out: Path | str,
    views: Views,
    calibration: Calibration,
    mount: Mount,
    attitude: Attitude,
    disparity_px: FloatImage,
    occluded: Mask,
    elevation: ElevationMap,
) -> None:
    """Write a pair as a user would have it, and beside it the truth: disparity, occlusions, elevation.

    Raises
    ------
    FormatError
        When the folder cannot be written.
    """
    with whole_folder(out) as folder:
        write_image(folder / "left.png", views.left)
        write_image(folder / "right.png", views.right)
        write_calibration(folder / "calibration.yaml", calibration, mount)
        write_attitude(folder / "attitude.yaml", attitude)
        write_pfm(folder / "true_disparity.pfm", disparity_px)
        write_image(folder / "occluded.png", occluded.astype(np.uint8) * 255)
        write_geotiff(folder / "true_elevation.tif", elevation)
