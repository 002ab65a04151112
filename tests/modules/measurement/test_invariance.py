"""Facts about a pair do not change with its padding, a small crop, its file format or its bit depth."""

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
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
    "anisotropy": 0.02, "row_blind_fraction": 0.02, "local_entropy_bits": 0.05, "shadow_fraction": 0.01,
    "featureless_fraction": 0.01, "sky_fraction": 0.01, "cost": 0.03, "plain_cost": 0.03,
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


def padded(views: Views, top: int = 17, bottom: int = 9, left: int = 30, right: int = 12) -> Views:
    borders = (top, bottom, left, right)
    mask = cv2.copyMakeBorder(np.ones(views.shape, np.uint8), *borders, cv2.BORDER_CONSTANT, value=0) > 0
    images = [cv2.copyMakeBorder(x, *borders, cv2.BORDER_CONSTANT, value=(0, 0, 0)) for x in (views.left, views.right)]
    return Views(np.asarray(images[0], np.uint8), np.asarray(images[1], np.uint8), mask, mask)


def cropped(views: Views, top: int = 3, bottom: int = 2, left: int = 4, right: int = 3) -> Views:
    part = slice(top, views.shape[0] - bottom), slice(left, views.shape[1] - right)
    return Views(views.left[part].copy(), views.right[part].copy())


def gray(views: Views) -> Views:
    left, right = (np.asarray(cv2.cvtColor(x, cv2.COLOR_RGB2GRAY), np.uint8) for x in (views.left, views.right))
    return Views(left, right)


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


def check_same(before: dict[tuple[str, ...], FactModel], after: dict[tuple[str, ...], FactModel]) -> None:
    assert before.keys() == after.keys()
    assert [line for key in before for line in differences(before[key], after[key])] == []


@pytest.fixture(scope="module")
def views() -> Views:
    return Views(*pair())


@pytest.fixture(scope="module")
def known(views: Views) -> dict[tuple[str, ...], FactModel]:
    return facts_of(views)


def test_every_probe_of_pairs_is_compared(known: dict[tuple[str, ...], FactModel]) -> None:
    assert {key[0] for key in known} == {model.template for probe in PROBES for model in probe.templates}


@pytest.mark.parametrize("change", [padded, cropped, deeper], ids=lambda change: change.__name__)
def test_facts_stay_within_their_uncertainty(change: Callable[[Views], Views], views: Views, known) -> None:
    check_same(known, facts_of(change(views)))


@pytest.mark.parametrize("change", [padded, cropped, deeper], ids=lambda change: change.__name__)
def test_facts_about_gray_pairs_stay_within_their_uncertainty(change: Callable[[Views], Views], views: Views) -> None:
    check_same(facts_of(gray(views)), facts_of(change(gray(views))))


@settings(max_examples=6)
@given(change=st.sampled_from([padded, cropped]), borders=st.tuples(*4 * [st.integers(0, 6)]))
def test_no_border_of_a_few_pixels_moves_a_fact_beyond_its_uncertainty(
    change: Callable[..., Views], borders: tuple[int, int, int, int], views: Views, known
) -> None:
    check_same(known, facts_of(change(views, *borders)))


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
