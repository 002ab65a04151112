"""Simulate what a camera does to an ideal image: response, optics, light on the scene, noise, misalignment."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from modules.operator import OperatorParams
from modules.types import Image, dn_scale, full_scale

Triple = tuple[float, float, float]


class SensorParams(OperatorParams):
    """Parameters of `apply_sensor`; the defaults change nothing.

    Colours are R, G, B; a gray image uses the value of G.
    """

    misalign_rad: float = Field(0.0, ge=-0.2, le=0.2, description="Rotation about the image centre, rad, clockwise")
    shift_x_px: float = Field(0.0, ge=-100, le=100, description="Shift to the right, px")
    shift_y_px: float = Field(0.0, ge=-100, le=100, description="Shift down, px")
    blur_sigma_px: float = Field(0.0, ge=0, le=20, description="Standard deviation of the Gaussian blur, px")
    spot_gain: float = Field(1.0, ge=0, le=5, description="Light in the centre of a soft spot, factor")
    spot_x: float = Field(0.35, ge=-1, le=2, description="Column of the spot as a fraction of the width")
    spot_y: float = Field(0.45, ge=-1, le=2, description="Row of the spot as a fraction of the height")
    spot_sigma: float = Field(0.18, gt=0, le=2, description="Standard deviation of the spot as a fraction of the width")
    shadow_gain: float = Field(1.0, ge=0, le=1, description="Light inside a shadow band with hard edges, factor")
    shadow_from: float = Field(
        0.60, ge=-1, le=2, description="Left edge of the band at mid-height, fraction of the width"
    )
    shadow_to: float = Field(
        0.78, ge=-1, le=2, description="Right edge of the band at mid-height, fraction of the width"
    )
    shadow_slope: float = Field(0.25, ge=-5, le=5, description="Columns that the band moves right per row down")
    vignetting: float = Field(0.0, ge=0, le=1, description="Loss of light in the corners, 0-1, growing with r^2")
    gamma: Triple = Field((1.0, 1.0, 1.0), description="Exponent of the response per channel, 0.1-10")
    gain: float = Field(1.0, ge=0, le=20, description="Factor on all channels")
    cast: Triple = Field((1.0, 1.0, 1.0), description="Factor per channel, 0-20")
    offset_dn: float = Field(0.0, ge=-255, le=255, description="Added to all channels, DN")
    noise_sigma_dn: float = Field(0.0, ge=0, le=100, description="Standard deviation of additive Gaussian noise, DN")
    electrons_per_dn: float | None = Field(
        None, gt=0, le=1e6, description="Electrons per DN of the shot noise; None for no shot noise"
    )

    def model_post_init(self, context: object, /) -> None:
        """Check the ranges of the triples."""
        for name, values, low, high in (("gamma", self.gamma, 0.1, 10.0), ("cast", self.cast, 0.0, 20.0)):
            if not all(low <= value <= high for value in values):
                raise ValueError(f"{name} {values} is outside {low} to {high}")


def apply_sensor(image: Image, params: SensorParams, seed: int = 0) -> Image:
    """Return the image as a camera with these faults would have taken it.

    The order is that of the light: misalignment, blur, light on the scene, vignetting, response (gamma, then gain,
    cast and offset), noise, saturation. Vignetting multiplies what leaves the lens, that is, it comes before the
    response.

    Parameters
    ----------
    image : (H, W) or (H, W, 3), uint8 or uint16
        Ideal image.
    params : SensorParams
        Faults.
    seed : int
        Seed of the noise.

    Returns
    -------
    (H, W) or (H, W, 3), dtype of the image
        Rounded to the nearest level, halves to even, and clipped to the range of the dtype; rotated-in borders repeat
        the nearest pixel.

    Raises
    ------
    ValueError
        If the image is of another shape or dtype.

    Examples
    --------
    >>> gray = np.full((4, 4), 100, np.uint8)
    >>> int(apply_sensor(gray, SensorParams(gain=0.5, offset_dn=10.0))[0, 0])
    60
    """
    if (
        image.dtype not in (np.uint8, np.uint16)
        or image.ndim not in (2, 3)
        or (image.ndim == 3 and image.shape[2] != 3)
    ):
        raise ValueError(f"image of shape {image.shape} and {image.dtype}: give (H, W) or (H, W, 3), uint8 or uint16")
    if params == SensorParams():
        return image.copy()
    colour = image.ndim == 3
    f = image.astype(np.float64) / dn_scale(image)
    f = _misalign(f, params)
    if params.blur_sigma_px > 0:
        blurred = cv2.GaussianBlur(f, (0, 0), params.blur_sigma_px, borderType=cv2.BORDER_REFLECT_101)
        f = np.asarray(blurred, np.float64)
    light = _light(f.shape[:2], params)
    f = f * (light[..., None] if colour else light)
    gamma, cast = (np.array(v if colour else v[1]) for v in (params.gamma, params.cast))
    if np.any(gamma != 1.0):
        f = 255.0 * np.maximum(f / 255.0, 0.0) ** gamma
    f = f * (params.gain * cast) + params.offset_dn
    rng = np.random.default_rng(seed)
    if params.electrons_per_dn is not None:
        f = f + np.sqrt(np.maximum(f, 0.0) / params.electrons_per_dn) * rng.standard_normal(f.shape)
    if params.noise_sigma_dn > 0:
        f = f + params.noise_sigma_dn * rng.standard_normal(f.shape)
    stored = np.clip(np.rint(f * dn_scale(image)), 0, full_scale(image))
    return np.asarray(stored.astype(image.dtype))


def _misalign(image: NDArray[np.float64], params: SensorParams) -> NDArray[np.float64]:
    """Rotate about the centre, then shift; cubic interpolation, border repeated."""
    if params.misalign_rad == 0 and params.shift_x_px == 0 and params.shift_y_px == 0:
        return image
    rows, columns = image.shape[:2]
    cx, cy = (columns - 1) / 2, (rows - 1) / 2
    c, s = np.cos(params.misalign_rad), np.sin(params.misalign_rad)
    # Rows point down, so this matrix turns clockwise on the screen for positive angles.
    forward = np.array(
        [
            [c, -s, cx - c * cx + s * cy + params.shift_x_px],
            [s, c, cy - s * cx - c * cy + params.shift_y_px],
        ]
    )
    warped = cv2.warpAffine(image, forward, (columns, rows), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(warped, np.float64)


def _light(shape: tuple[int, int], params: SensorParams) -> NDArray[np.float64]:
    """Return the factor on each pixel (H, W): soft spot, shadow band and vignetting."""
    rows, columns = shape
    y, x = np.mgrid[:rows, :columns].astype(np.float64)
    light = np.ones(shape)
    if params.spot_gain != 1:
        away = (x - params.spot_x * columns) ** 2 + (y - params.spot_y * rows) ** 2
        light *= 1 + (params.spot_gain - 1) * np.exp(-away / (2 * (params.spot_sigma * columns) ** 2))
    if params.shadow_gain != 1:
        place = (x - params.shadow_slope * (y - rows / 2)) / columns
        light[(place >= params.shadow_from) & (place < params.shadow_to)] *= params.shadow_gain
    if params.vignetting > 0:
        cx, cy = (columns - 1) / 2, (rows - 1) / 2
        corner = max(cx * cx + cy * cy, 1e-9)
        light *= 1 - params.vignetting * ((x - cx) ** 2 + (y - cy) ** 2) / corner
    return light
