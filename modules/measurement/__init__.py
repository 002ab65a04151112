"""Probes: facts about pairs and about products."""

from modules.measurement import (
    brightness,
    compression,
    defects,
    disparity_range,
    histograms,
    image_format,
    light_shape,
    motion,
    noise,
    radiometry,
    row_alignment,
    saturation,
    sharpness,
    texture,
)
from modules.probe import Probe

PROBES: tuple[Probe, ...] = (
    image_format.PROBE,
    histograms.PROBE,
    brightness.PROBE,
    saturation.PROBE,
    noise.PROBE,
    sharpness.PROBE,
    texture.PROBE,
    row_alignment.PROBE,
    disparity_range.PROBE,
    radiometry.PROBE,
    light_shape.PROBE,
    motion.PROBE,
    compression.PROBE,
    defects.PROBE,
)
