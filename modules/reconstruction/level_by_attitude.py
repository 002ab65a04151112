"""Frame from a measured attitude."""

from __future__ import annotations

import math
from dataclasses import replace

from pydantic import Field

from modules.operator import Cost, Operator, OperatorError, OperatorParams
from modules.types import Scene


class LevelByAttitudeParams(OperatorParams):
    """Parameters of `level_by_attitude`."""

    max_tilt_deg: float = Field(60.0, ge=1.0, le=90.0, description="Largest roll or pitch that is believed, deg")


def level_by_attitude(scene: Scene, params: LevelByAttitudeParams) -> Scene:
    """Use the measured attitude for the level frame, whose origin is the body origin.

    Parameters
    ----------
    scene : Scene
        Needs `attitude`.
    params : LevelByAttitudeParams

    Returns
    -------
    Scene
        The attitude is kept and a fitted ground plane is dropped.

    Raises
    ------
    OperatorError
        When there is no attitude, or roll or pitch exceed the limit.

    References
    ----------
    T. Foote and M. Purvis, ROS REP 103, 2010.
    """
    if scene.attitude is None:
        raise OperatorError(
            "the pair has no attitude; give roll, pitch and yaw, or use reconstruction.level_by_ground_plane"
        )
    for name, value in (("roll", scene.attitude.roll_rad), ("pitch", scene.attitude.pitch_rad)):
        if abs(math.degrees(value)) > params.max_tilt_deg:
            raise OperatorError(
                f"{name} is {math.degrees(value):.1f} deg, beyond the limit of {params.max_tilt_deg:g} deg; "
                "check sign, unit and convention (axes) of the attitude, or raise max_tilt_deg"
            )
    return replace(scene, ground=None)


OPERATOR = Operator(
    name="reconstruction.level_by_attitude",
    slot="frame",
    params=LevelByAttitudeParams,
    function=level_by_attitude,
    cost=Cost(fixed_ms=0.05),
    summary="Rotates points into a level frame by the measured roll, pitch and yaw.",
    suits="Best whenever an attitude was measured; a stale or wrongly signed one tilts the whole map.",
    needs=("attitude",),
)
