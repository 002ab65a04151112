"""Facts about a pair do not change with its padding, a small crop, its file format or its bit depth."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from modules.formats.images import read_image
from modules.measurement import PROBES
from modules.measurement.sample import Sample
from modules.probe import FactModel
from modules.simulation.sensor import SensorParams, apply_sensor
from modules.types import Views

SHIFT_PX = 22
FAULTS = SensorParams(gain=0.8, vignetting=0.3, cast=(1.05, 1.0, 0.95), noise_sigma_dn=2.0, shift_y_px=0.8)

# How far a field without an uncertainty of its own may move: content at the border comes and goes with a crop.
TOLERANCE = {
    "count": 0.1, "support_count": 0.2, "matched_fraction": 0.1, "entropy_bits": 0.05, "skewness": 0.06,
    "bimodality": 0.02, "row_repetition": 0.06, "coverage_fraction": 0.13, "gradient_deg": 30.0, "direction_deg": 30.0,
    "min_px": 2.0, "max_px": 2.0, "lines_difference": 1.0, "left_lines": 1.0, "right_lines": 1.0,
}  # fmt: skip
SKIPPED = {"width_px", "height_px", "megapixels", "bit_depth"}  # of the file itself
RELATIVE = 0.08


def pair() -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    random = np.random.default_rng(3)
    wide = np.zeros((288, 384 + SHIFT_PX, 3))
    for sigma, weight in ((1.2, 14), (4.0, 14), (14.0, 14)):
        gray = cv2.GaussianBlur(random.normal(size=wide.shape[:2]), (0, 0), sigma)
        wide += weight * (gray / gray.std())[..., None]
        colour = cv2.GaussianBlur(random.normal(size=wide.shape), (0, 0), 2 * sigma)
        wide += 0.4 * weight * colour / colour.std()
    scene = np.clip(np.rint(125 + wide), 0, 255).astype(np.uint8)
    right = apply_sensor(scene[:, SHIFT_PX:], FAULTS, seed=1)
    return scene[:, :-SHIFT_PX].copy(), np.asarray(right, np.uint8)


def facts_of(views: Views) -> dict[tuple[str, ...], FactModel]:
    sample = Sample(views)
    found = {}
    for probe in PROBES:
        for fact in probe.function(sample) if probe.subject == "pair" else ():
            found[(fact.template, *(str(getattr(fact, key)) for key in fact.keys))] = fact
    return found


def padded(views: Views) -> Views:
    borders = (17, 9, 30, 12)
    mask = np.zeros((views.shape[0] + 26, views.shape[1] + 42), bool)
    mask[17:-9, 30:-12] = True
    images = [cv2.copyMakeBorder(x, *borders, cv2.BORDER_CONSTANT, value=(0, 0, 0)) for x in (views.left, views.right)]
    return Views(np.asarray(images[0], np.uint8), np.asarray(images[1], np.uint8), mask, mask)


def cropped(views: Views) -> Views:
    return Views(views.left[3:-2, 4:-3].copy(), views.right[3:-2, 4:-3].copy())


def deeper(views: Views) -> Views:
    return Views(views.left.astype(np.uint16) * 257, views.right.astype(np.uint16) * 257)


def differences(before: FactModel, after: FactModel) -> list[str]:
    told = []
    for name, info in type(before).model_fields.items():
        old, new = getattr(before, name), getattr(after, name)
        if name in SKIPPED or isinstance(old, str) or old is None or new is None:
            if name not in SKIPPED and old != new:
                told.append(f"{before.template}.{name}: {old} and {new}")
            continue
        extra = info.json_schema_extra if isinstance(info.json_schema_extra, dict) else {}
        if extra.get("sigma"):
            allowed = 2 * getattr(before, str(extra["sigma"]))
        else:
            allowed = max(RELATIVE * abs(old), TOLERANCE.get(name, 0.0), 5 * float(str(extra.get("resolution") or 0)))
            if name in ("count", "support_count"):
                allowed = TOLERANCE[name] * old
        if extra.get("unit") == "dn":
            allowed = max(allowed, 0.6)
        if abs(new - old) > allowed + 1e-9:
            told.append(f"{before.template}.{name}: {old} and {new}, allowed {allowed:.3g}")
    return told


@pytest.mark.parametrize("change", [padded, cropped, deeper], ids=lambda change: change.__name__)
def test_facts_stay_within_their_uncertainty(change: Callable[[Views], Views]) -> None:
    views = Views(*pair())
    before, after = facts_of(views), facts_of(change(views))
    assert before.keys() == after.keys()
    assert [line for key in before for line in differences(before[key], after[key])] == []


@pytest.mark.parametrize("ending", ["tif", "bmp"])
def test_another_lossless_format_changes_no_fact(tmp_path: Path, ending: str) -> None:
    left, right = pair()
    for name, image in (("left", left), ("right", right)):
        for suffix in ("png", ending):
            cv2.imwrite(str(tmp_path / f"{name}.{suffix}"), np.ascontiguousarray(image[..., ::-1]))
    read = [
        Views(read_image(tmp_path / f"left.{suffix}"), read_image(tmp_path / f"right.{suffix}"))
        for suffix in ("png", ending)
    ]
    assert facts_of(read[0]) == facts_of(read[1])
