"""What kind of images a pair has."""

from __future__ import annotations

from typing import ClassVar

from modules.measurement.sample import Sample
from modules.probe import FactModel, Probe, quantity


class ImageFormat(FactModel):
    """Size and depth of the images."""

    template: ClassVar[str] = "image_format"

    width_px: int = quantity("Columns", unit="px", ge=1)
    height_px: int = quantity("Rows", unit="px", ge=1)
    megapixels: float = quantity("Pixels per image, in millions", ge=0, resolution=0.001)
    channels: int = quantity("Channels: 1 is gray, 3 is RGB", ge=1, le=3)
    bit_depth: int = quantity("Bits per channel of the data type, 8 or 16", ge=8, le=16)


def measure_image_format(sample: Sample) -> list[ImageFormat]:
    """Return the one `image_format` fact of the pair."""
    height, width = sample.full_shape
    return [
        ImageFormat(
            width_px=width,
            height_px=height,
            megapixels=width * height * 1e-6,
            channels=sample.channels,
            bit_depth=8 * sample.views.left.dtype.itemsize,
        )
    ]


PROBE = Probe(
    "measurement.image_format", (ImageFormat,), measure_image_format, "cheap", "pair", "Reads size, channels and depth."
)
