"""Shapes, units and conventions shared by all modules; written once, here.

Images are `(H, W)` gray or `(H, W, 3)` RGB, uint8 or uint16. Arrays are indexed row, column. A quantity in `_dn` is on
the 0-255 scale whatever the bit depth. Disparity is left column minus right column, in pixels of the left image; a
point at infinity has disparity `-doffs`. Lengths are metres; angles are radians inside and degrees at the edge.

Frames follow ROS REP 103. Camera optical: x right, y down, z forward. Body and level: x forward, y left, z up. Positive
roll lowers the right side, positive pitch lowers the nose, positive yaw turns left.
"""

from modules.types.cameras import Calibration, Camera, Rectification, StereoRig
from modules.types.disparity import Disparity, DisparityRange, Invalid, Matching, blanked, flagged
from modules.types.images import Correspondences, FloatImage, Image, Mask, Side, Views, dn_scale, full_scale
from modules.types.poses import Attitude, Mount, Pose
from modules.types.terrain import Datum, ElevationMap, GroundPlane, Hazard, PointCloud, Rover, Scene, SharedError, Sight

__all__ = [
    "Attitude",
    "Calibration",
    "Camera",
    "Correspondences",
    "Datum",
    "Disparity",
    "DisparityRange",
    "ElevationMap",
    "FloatImage",
    "GroundPlane",
    "Hazard",
    "Image",
    "Invalid",
    "Mask",
    "Matching",
    "Mount",
    "PointCloud",
    "Pose",
    "Rectification",
    "Rover",
    "Scene",
    "SharedError",
    "Side",
    "Sight",
    "StereoRig",
    "Views",
    "blanked",
    "dn_scale",
    "flagged",
    "full_scale",
]
