"""The YAML of terrex: one form for rectified pairs, one for cameras as they are."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, TypeAdapter, ValidationError
from pydantic_core import ErrorDetails

from modules.formats._text import unknown_field
from modules.formats.calibration.file import CalibrationFile
from modules.formats.errors import FormatError
from modules.primitives.frames import mount_from_aerospace, mount_from_angles, nearest_rotation, rotation_problem
from modules.types import Calibration, Camera, Mount, StereoRig

SCHEMA_ID = "https://json-schema.org/draft/2020-12/schema"
Vector = tuple[FiniteFloat, FiniteFloat, FiniteFloat]
Rows = tuple[Vector, Vector, Vector]


class _Block(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class MountBlock(_Block):
    """Where the left camera sits on the body; angles or a matrix, not both."""

    convention: Literal["rep103", "aerospace"] = Field(
        "rep103",
        description="Axes of the body: rep103 is front-left-up, aerospace is front-right-down; the matrix and the "
        "translation are given in them. Angles always follow REP 103",
    )
    rotation_matrix: Rows | None = Field(
        None, description="Rows of R in p_body = R p_optical + t; optical is x right, y down, z forward"
    )
    roll_deg: FiniteFloat | None = Field(None, description="Roll of the camera, positive lowers its right side, deg")
    pitch_deg: FiniteFloat | None = Field(None, description="Pitch of the camera, positive looks down, deg")
    yaw_deg: FiniteFloat | None = Field(None, description="Yaw of the camera, positive looks left, deg")
    translation_m: Vector = Field((0.0, 0.0, 0.0), description="The left camera in body axes, m")


class CameraBlock(_Block):
    """One camera as it is."""

    focal_px: tuple[FiniteFloat, FiniteFloat] = Field(description="Focal length along columns and rows, px")
    centre_px: tuple[FiniteFloat, FiniteFloat] = Field(
        description="Principal point, column and row; pixel centres have whole coordinates, px"
    )
    model: Literal["radtan", "equidistant"] = Field(
        "radtan", description="radtan: k1, k2, p1, p2[, k3[, k4, k5, k6]]; equidistant (fisheye): k1, k2, k3, k4"
    )
    distortion: list[FiniteFloat] = Field(default_factory=list, description="Coefficients of the model; empty for none")


class PoseBlock(_Block):
    """The pose between the cameras: p_right = R p_left + t, both optical (x right, y down, z forward)."""

    rotation_matrix: Rows = Field(description="Rows of R")
    translation_m: Vector = Field(description="t; its first number is about minus the baseline, m")


class _Sized(_Block):
    width_px: Annotated[int, Field(description="Width of the images, px", json_schema_extra={"minimum": 1})]
    height_px: Annotated[int, Field(description="Height of the images, px", json_schema_extra={"minimum": 1})]
    mount: MountBlock | None = Field(None, description="Where the left camera sits on the body")


class RectifiedPairFile(_Sized):
    """Calibration of a rectified pair: Z = focal_px * baseline_m / (disparity + doffs_px)."""

    focal_px: FiniteFloat = Field(description="Focal length of both cameras, px")
    cx_px: FiniteFloat = Field(description="Column of the left principal point, px")
    cy_px: FiniteFloat = Field(description="Row of the principal points, px")
    baseline_m: FiniteFloat = Field(description="Distance of the cameras, m")
    doffs_px: FiniteFloat = Field(0.0, description="Column of the right principal point minus that of the left, px")


class StereoRigFile(_Sized):
    """Calibration of two cameras as they are, from which terrex rectifies their images."""

    left: CameraBlock = Field(description="The left camera")
    right: CameraBlock = Field(description="The right camera")
    right_from_left: PoseBlock = Field(description="The pose between the cameras")


Either: TypeAdapter[RectifiedPairFile | StereoRigFile] = TypeAdapter(RectifiedPairFile | StereoRigFile)
FIELDS = frozenset(RectifiedPairFile.model_fields) | frozenset(StereoRigFile.model_fields)
RIG_FIELDS = frozenset(StereoRigFile.model_fields) - frozenset(RectifiedPairFile.model_fields)


def calibration_schema() -> dict[str, Any]:
    """Return the JSON schema of the YAML form, draft 2020-12."""
    return {"$schema": SCHEMA_ID, "title": "Calibration of a stereo pair for terrex", **Either.json_schema()}


def read_own(source: str, mapping: Mapping[str, object]) -> CalibrationFile:
    """Read the YAML form; all faults are reported at once."""
    model: type[RectifiedPairFile | StereoRigFile]
    model = StereoRigFile if RIG_FIELDS & set(mapping) else RectifiedPairFile
    try:
        stated = model.model_validate(mapping)
    except ValidationError as error:
        raise FormatError(". ".join(_sentences(source, model, error.errors()))) from error
    mount = None if stated.mount is None else _mount(source, stated.mount)
    if isinstance(stated, RectifiedPairFile):
        values = stated.model_dump(exclude={"mount"})
        return CalibrationFile("terrex", rectified=Calibration(**values), mount=mount)
    cameras = [
        Camera(block.focal_px, block.centre_px, stated.width_px, stated.height_px, tuple(block.distortion), block.model)
        for block in (stated.left, stated.right)
    ]
    pose = stated.right_from_left
    rotation = _rotation(source, "right_from_left.rotation_matrix", pose.rotation_matrix)
    return CalibrationFile("terrex", rig=StereoRig(cameras[0], cameras[1], rotation, pose.translation_m), mount=mount)


def as_own(geometry: Calibration | StereoRig, mount: Mount | None) -> dict[str, Any]:
    """Return what the YAML form holds for a rectified pair or a rig, as plain data."""
    stated: RectifiedPairFile | StereoRigFile
    block = (
        None if mount is None else MountBlock(rotation_matrix=_rows(mount.rotation), translation_m=mount.translation_m)
    )
    if isinstance(geometry, Calibration):
        stated = RectifiedPairFile(**{name: getattr(geometry, name) for name in _OWN_NUMBERS}, mount=block)
    else:
        left, right = (
            CameraBlock(focal_px=c.focal_px, centre_px=c.centre_px, model=c.model, distortion=list(c.distortion))
            for c in (geometry.left, geometry.right)
        )
        pose = PoseBlock(rotation_matrix=_rows(geometry.rotation), translation_m=geometry.translation_m)
        width, height = geometry.left.width_px, geometry.left.height_px
        stated = StereoRigFile(
            width_px=width, height_px=height, left=left, right=right, right_from_left=pose, mount=block
        )  # fmt: skip
    return stated.model_dump(mode="json", exclude_none=True)


_OWN_NUMBERS = ("focal_px", "cx_px", "cy_px", "baseline_m", "width_px", "height_px", "doffs_px")


def _rows(matrix: NDArray[np.float64]) -> Rows:
    first, second, third = ((float(a), float(b), float(c)) for a, b, c in matrix)
    return first, second, third


def _mount(source: str, block: MountBlock) -> Mount:
    angles = [getattr(block, f"{name}_deg") for name in ("roll", "pitch", "yaw")]
    if block.rotation_matrix is not None:
        if any(angle is not None for angle in angles):
            raise FormatError(f"{source}: mount has both rotation_matrix and angles; keep one")
        rotation = _rotation(source, "mount.rotation_matrix", block.rotation_matrix)
        if block.convention == "aerospace":
            return mount_from_aerospace(rotation, block.translation_m)
        return Mount(rotation, block.translation_m)
    if block.convention == "aerospace":
        raise FormatError(f"{source}: mount has the convention 'aerospace' and needs a rotation_matrix in those axes")
    roll, pitch, yaw = (float(np.radians(angle or 0.0)) for angle in angles)
    return mount_from_angles(roll, pitch, yaw, block.translation_m)


def _rotation(source: str, name: str, rows: Rows) -> NDArray[np.float64]:
    matrix = np.array(rows, np.float64)
    problem = rotation_problem(matrix)
    if problem:
        raise FormatError(f"{source}: {name}: {problem}")
    return nearest_rotation(matrix)


def _sentences(source: str, model: type[BaseModel], items: list[ErrorDetails]) -> list[str]:
    """Say every fault once; fields that are missing are named together."""
    missing = [".".join(str(part) for part in item["loc"]) for item in items if item["type"] == "missing"]
    said = [_sentence(source, model, item) for item in items if item["type"] != "missing"]
    if missing:
        listed = ", ".join(f"'{name}'" for name in missing)
        said.append(f"{source} has no {listed}; add a line '{missing[0]}: value'{' and so on' if missing[1:] else ''}")
    return said


def _sentence(source: str, model: type[BaseModel], item: ErrorDetails) -> str:
    """Say one fault in the words of all readers."""
    where = ".".join(str(part) for part in item["loc"])
    given = item["input"]
    if item["type"] == "extra_forbidden":
        allowed = _fields(model, item["loc"][:-1])
        return str(unknown_field(f"{source}: {where.rpartition('.')[0]}" if len(item["loc"]) > 1 else source,
                                 str(item["loc"][-1]), allowed))  # fmt: skip
    if item["type"].startswith(("float", "int_parsing", "int_type")):
        return f"{source}: {where} is {given!r} and must be a number"
    if item["type"] == "finite_number":
        return f"{source}: {where} is {given!r} and must be finite"
    if item["type"] == "int_from_float":
        return f"{source}: {where} is {given!r} and must be a whole number of px"
    if item["type"] == "model_type":
        return f"{source}: {where} is {given!r} and must be a mapping with {', '.join(_fields(model, item['loc']))}"
    return f"{source}: {where} is {given!r}: {item['msg'][:1].lower()}{item['msg'][1:]}"


def _fields(model: type[BaseModel], location: tuple[int | str, ...]) -> list[str]:
    """Return the names that may stand at a place of the file."""
    blocks: dict[str, type[BaseModel]] = {
        "mount": MountBlock, "left": CameraBlock, "right": CameraBlock, "right_from_left": PoseBlock
    }  # fmt: skip
    return list((blocks[str(location[0])] if location else model).model_fields)
