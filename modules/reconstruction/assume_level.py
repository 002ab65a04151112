"""Frame of a body that stands level."""

from __future__ import annotations

import math
from dataclasses import replace

from pydantic import Field

from modules.operator import Cost, Operator, OperatorParams
from modules.types import Attitude, Scene


class AssumeLevelParams(OperatorParams):
    """Parameters of `assume_level`."""

    sigma_deg: float = Field(
        10.0,
        ge=0.0,
        le=45.0,
        description="Standard deviation of the unknown roll and pitch, deg; widens elevation sigma",
    )


def assume_level(scene: Scene, params: AssumeLevelParams) -> Scene:
    """Take the body as level: roll, pitch and yaw are 0, with a stated uncertainty.

    Parameters
    ----------
    scene : Scene
    params : AssumeLevelParams

    Returns
    -------
    Scene
        With that attitude and without a ground plane.
    """
    return replace(scene, attitude=Attitude(sigma_rad=math.radians(params.sigma_deg)), ground=None)


OPERATOR = Operator(
    name="reconstruction.assume_level",
    slot="frame",
    params=AssumeLevelParams,
    function=assume_level,
    cost=Cost(fixed_ms=0.05),
    summary="Takes the body as level because nothing better is known.",
    suits="Last resort without attitude and without visible ground: slopes of the map are relative to the body.",
)
