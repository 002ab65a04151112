"""Files in and out; the only module that touches the file system."""

from modules.formats.atomic import whole_folder
from modules.formats.attitude import (
    attitude_from_degrees,
    attitude_from_gravity,
    attitude_from_rotation,
    read_attitude,
    write_attitude,
)
from modules.formats.calibration import (
    CalibrationFile,
    CalibrationSource,
    calibration_schema,
    check_calibration,
    for_images,
    read_calibration,
    write_calibration,
)
from modules.formats.disparity import (
    read_disparity_png,
    read_pfm,
    read_validity_png,
    write_disparity_png,
    write_disparity_view,
    write_pfm,
    write_validity_png,
)
from modules.formats.elevation import read_geotiff, write_geotiff
from modules.formats.errors import FormatError
from modules.formats.images import read_image, write_image
from modules.formats.imu import ImuLog, read_imu_log
from modules.formats.layers import read_layers, write_grid_map, write_layers
from modules.formats.mesh import write_glb, write_obj
from modules.formats.occupancy import occupancy_of, write_occupancy
from modules.formats.points import read_ply, write_las, write_pcd, write_ply
from modules.formats.terrain_pictures import write_terrain_picture

__all__ = [
    "CalibrationFile",
    "CalibrationSource",
    "FormatError",
    "ImuLog",
    "attitude_from_degrees",
    "attitude_from_gravity",
    "attitude_from_rotation",
    "calibration_schema",
    "check_calibration",
    "for_images",
    "read_attitude",
    "read_calibration",
    "read_disparity_png",
    "read_geotiff",
    "read_image",
    "read_imu_log",
    "read_pfm",
    "read_layers",
    "read_ply",
    "read_validity_png",
    "whole_folder",
    "write_attitude",
    "write_calibration",
    "write_disparity_png",
    "write_disparity_view",
    "write_geotiff",
    "write_image",
    "write_pfm",
    "write_glb",
    "write_grid_map",
    "write_las",
    "write_layers",
    "write_obj",
    "write_occupancy",
    "write_pcd",
    "write_ply",
    "write_terrain_picture",
    "occupancy_of",
    "write_validity_png",
]
