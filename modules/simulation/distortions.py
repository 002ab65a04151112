"""The ten reference distortions of the right image, and how to apply them at other strengths."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from modules.simulation.sensor import SensorParams, apply_sensor
from modules.types import Views

REFERENCE_DISTORTIONS: Mapping[str, SensorParams] = MappingProxyType(
    {
        "clean": SensorParams(),
        "dark": SensorParams(gain=0.45, noise_sigma_dn=1.5),
        "clipped": SensorParams(gain=1.5, offset_dn=10.0),
        "curve": SensorParams(gamma=(0.9, 1.2, 1.5), cast=(1.1, 1.0, 0.9)),
        "vignette": SensorParams(vignetting=0.55, gain=0.9),
        "local": SensorParams(spot_gain=1.8, shadow_gain=0.4),
        "noise": SensorParams(noise_sigma_dn=12.0),
        "blur": SensorParams(blur_sigma_px=1.3),
        "misrectified": SensorParams(misalign_rad=0.003, shift_y_px=1.3),
        "combined": SensorParams(vignetting=0.4, gamma=(1.3, 1.3, 1.3), gain=0.7, offset_dn=15.0, noise_sigma_dn=5.0),
    }
)


def scale_distortion(params: SensorParams, strength: float) -> SensorParams:
    """Scale a distortion: 0 leaves the image as it is, 1 is the distortion itself.

    Additive parameters (offset, noise, blur, shift, rotation, vignetting) are multiplied by the strength; factors and
    exponents are raised to its power; electrons per DN are divided by its square, so that shot noise grows in
    proportion. The result is clipped to the ranges of `SensorParams`.

    Parameters
    ----------
    params : SensorParams
        Distortion of strength 1.
    strength : float
        Not negative.

    Returns
    -------
    SensorParams

    Raises
    ------
    ValueError
        If the strength is negative or a scaled value leaves the range of its parameter.
    """
    if strength < 0:
        raise ValueError(f"strength {strength} is negative; give 0 or more")
    if strength == 1:
        return params
    values = params.model_dump()
    for name in ("misalign_rad", "shift_x_px", "shift_y_px", "blur_sigma_px", "offset_dn", "noise_sigma_dn"):
        values[name] *= strength
    values["vignetting"] = min(values["vignetting"] * strength, 1.0)
    for name in ("gain", "spot_gain", "shadow_gain"):
        values[name] **= strength
    for name in ("gamma", "cast"):
        values[name] = tuple(value**strength for value in values[name])
    if values["electrons_per_dn"] is not None:
        values["electrons_per_dn"] = None if strength == 0 else values["electrons_per_dn"] / strength**2
    return SensorParams(**values)


def distort_right(views: Views, name: str, seed: int = 0, strength: float = 1.0) -> Views:
    """Return the views with a reference distortion applied to the right image.

    Parameters
    ----------
    views : Views
        Pair; not modified.
    name : str
        Key of `REFERENCE_DISTORTIONS`.
    seed : int
        Seed of the noise.
    strength : float
        0 for none, 1 for the reference; see `scale_distortion`.

    Returns
    -------
    Views
        Same shapes and dtypes.

    Raises
    ------
    ValueError
        If the name is unknown or the strength negative.
    """
    if name not in REFERENCE_DISTORTIONS:
        raise ValueError(f"unknown distortion {name!r}; choose one of {', '.join(REFERENCE_DISTORTIONS)}")
    params = scale_distortion(REFERENCE_DISTORTIONS[name], strength)
    return views.with_images(views.left, apply_sensor(views.right, params, seed))
