"""Every shipped rule fires for some pair of images: no rule waits for facts that pairs do not have."""

from __future__ import annotations

import importlib.util
import itertools
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from expert import Decision, ExpertSystem, StereoPair
from expert.facts import vocabulary
from expert.pair import Preparation
from expert.rules.load import load_rules
from modules.catalog import operators, probes
from modules.simulation import REFERENCE_DISTORTIONS, TerrainParams, distort_right, render_terrain
from modules.types import Attitude, Calibration, Rover, Views

WIDTH, HEIGHT = 320, 240
CAMERA = Calibration(250.0, 160.0, 120.0, 0.09, WIDTH, HEIGHT)
NARROW = """version: 1
rules:
  - id: RIG001
    name: range-cut-off
    stage: matching
    when: [{fact: task}]
    then:
      - {set: matching.use_range, parameter: LIMIT, score: 0.95}
    because: The range of this rig is cut off where the disparities lie.
    references: ["test"]
"""

CARELESS = """version: 1
rules:
  - id: RIG002
    name: checks-left-out
    stage: matching
    when: [{fact: task}]
    then:
      - {choose: none, slot: consistency, score: 0.99}
      - {choose: none, slot: speckles, score: 0.99}
    because: This rig checks nothing after matching.
    references: ["test"]
  - id: RIG003
    name: lone-points-kept
    stage: reconstruction
    when: [{fact: task}]
    then:
      - {choose: none, slot: outliers, score: 0.8}
    because: This rig keeps lone points.
    references: ["test"]
"""

TINY_CELLS = """
rules:
  - id: RIG004
    name: tiny-cells
    stage: reconstruction
    when: [{fact: task}]
    then: [{set: reconstruction.grid_elevation, parameter: cell_m, to: 0.001, score: 0.99}]
    because: This rig asks for more cells than there may be.
    references: ["test"]
"""


def texture(seed: int, sigma_px: float = 1.2, width: int = WIDTH + 100) -> NDArray[np.uint8]:
    noise = cv2.GaussianBlur(np.random.default_rng(seed).normal(0.0, 1.0, (HEIGHT, width)), (0, 0), sigma_px)
    return np.clip(128 + 40 * noise / noise.std(), 0, 255).astype(np.uint8)


def plane(scene: NDArray[np.uint8], shift_px: int) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    return scene[:, 60 : 60 + WIDTH].copy(), scene[:, 60 + shift_px : 60 + shift_px + WIDTH].copy()


def house_before_a_yard() -> StereoPair:
    """Return level ground 1 m below the camera and a wall 6 m ahead that is higher than the camera."""
    rig = replace(CAMERA, baseline_m=0.4)
    ground = rig.baseline_m * (np.arange(HEIGHT) - rig.cy_px)
    disparity = np.rint(np.maximum(ground, rig.focal_px * rig.baseline_m / 6.0)).astype(int)
    scene = texture(1, width=WIDTH + 200)
    right = np.stack([row[60 + shift :][:WIDTH] for row, shift in zip(scene, disparity, strict=True)])
    return StereoPair(scene[:, 60 : 60 + WIDTH].copy(), right, calibration=rig, attitude=Attitude())


def rules_of(decision: Decision) -> set[str]:
    """Return the rules that fired, those of trials that were not kept included."""
    setters = {rule for plan in decision.plans.values() for step in plan.steps for rule in step.set_by.values()}
    asked = {rule for trial in decision.trials for rule in re.findall(r"[A-Z]{3}\d{3}", trial.answer)}
    return {*decision.rules_fired, *setters, *asked}


def rendered_decisions(system: ExpertSystem) -> Iterator[Decision]:
    made = render_terrain(
        TerrainParams(seed=3, width_px=WIDTH, height_px=HEIGHT, focal_px=250.0, roll_deg=2.0, pitch_deg=-4.0)
    )
    known = {"calibration": made.calibration, "mount": made.mount}
    views = Views(made.left, made.right)
    for kind in REFERENCE_DISTORTIONS:
        bad = distort_right(views, kind, seed=1)
        yield system.reconstruct(StereoPair(bad.left, bad.right, attitude=made.attitude, **known)).decision
    yield system.reconstruct(StereoPair(made.left, made.right, **known)).decision
    for wrong in (Attitude(0.0, 1.3, 0.0), Attitude(-made.attitude.roll_rad, -made.attitude.pitch_rad)):
        yield system.reconstruct(StereoPair(made.left, made.right, attitude=wrong, **known)).decision
    yield system.reconstruct(StereoPair(made.right, made.left)).decision
    for kind, strength in (("blur", 1.0), ("dark", 1.0), ("combined", 2.0), ("noise", 3.0)):
        swapped = distort_right(Views(made.right, made.left), kind, seed=1, strength=strength)
        yield system.reconstruct(StereoPair(swapped.right, swapped.left)).decision
    smeared = distort_right(views, "blur", seed=1, strength=4.0)
    yield system.reconstruct(StereoPair(smeared.left, smeared.right)).decision
    yield system.reconstruct(
        StereoPair(smeared.left, distort_right(smeared, "noise", seed=1, strength=2.0).right)
    ).decision
    small = Rover(
        wheel_radius_m=0.06, clearance_m=0.12, width_m=0.4, body_front_m=0.3, min_confidence=0.6, min_grazing_deg=4.0
    )
    yield ExpertSystem(engine="compiled", rover=small).decide(
        StereoPair(made.left, made.right, disparity_range_px=(0, 32), **known)
    )
    given = StereoPair(made.left, made.right, disparity_range_px=(0, 32))
    yield system.decide(replace(given, disparity_range_px=(0, 256)))
    for profile in ("fast", "best"):
        yield ExpertSystem(profile=profile, engine="compiled", memory_budget_mb=1).decide(given)
    for budget in np.geomspace(0.001, 0.15, 30):  # from less than anything takes to more than every plan does
        yield ExpertSystem(engine="compiled", time_budget_s=float(budget), machine_speed=1.0).decide(given)


def synthetic_decisions(system: ExpertSystem, folder: Path) -> Iterator[Decision]:
    left, right = plane(texture(1), 12)
    flat = np.full((HEIGHT, WIDTH), 90, np.uint8)
    yield system.reconstruct(StereoPair(flat, flat)).decision
    yield system.reconstruct(StereoPair(left, left.copy())).decision
    yield system.reconstruct(StereoPair(texture(2)[:, :WIDTH], texture(3)[:, :WIDTH])).decision
    yield system.reconstruct(StereoPair(*plane(texture(4, sigma_px=12.0), 10))).decision
    yield system.reconstruct(StereoPair(left, right, calibration=CAMERA)).decision
    yield system.reconstruct(StereoPair(left, right, calibration=CAMERA, attitude=Attitude(0.0, 0.7, 0.0))).decision
    source = np.random.default_rng(0)
    hidden = [np.clip(x + source.normal(0, 70, x.shape), 0, 255).astype(np.uint8) for x in plane(texture(1, 2.5), 12)]
    yield system.reconstruct(StereoPair(hidden[0], hidden[1], disparity_range_px=(0, 32))).decision
    wave = 128 + 60 * np.sin(np.arange(WIDTH + 12) / 2.0)
    grating = np.rint(np.tile(wave, (HEIGHT, 1))).astype(np.uint8)
    yield system.decide(StereoPair(grating[:, :WIDTH], grating[:, 12:], disparity_range_px=(0, 32)))
    wide = Calibration(250.0, 160.0, 120.0, 60.0, WIDTH, HEIGHT)
    yield system.reconstruct(StereoPair(left, right, calibration=wide, attitude=Attitude())).decision
    partly = right.copy()
    partly[:, 70:] = texture(8)[:, : WIDTH - 70]
    yield system.reconstruct(StereoPair(left, partly)).decision
    ramp = np.clip(texture(1) * 0.5 + np.linspace(0, 127, HEIGHT)[:, None], 0, 255).astype(np.uint8)
    curve = (255 * (np.arange(256) / 255.0) ** 3).astype(np.uint8)
    bright, dim = plane(ramp, 12)
    yield system.reconstruct(StereoPair(bright, curve[dim])).decision
    small = Calibration(25.0, 11.0, 8.0, 20.0, 22, 16)
    strip = texture(5)[:16]
    tiny = StereoPair(
        strip[:, :22], strip[:, 15:37], disparity_range_px=(0, 21), calibration=small, attitude=Attitude()
    )
    yield system.reconstruct(tiny).decision
    for number, limit in enumerate(("max_px, to: 13", "min_px, to: 12")):
        file = folder / f"narrow{number}.yaml"
        file.write_text(NARROW.replace("LIMIT", limit))
        yield ExpertSystem(rules=[file], engine="compiled").reconstruct(StereoPair(left, right)).decision


def misplaced_decisions(system: ExpertSystem, folder: Path) -> Iterator[Decision]:
    """Yield decisions on pairs whose attitude, baseline, offset or checks are wrong, and on walls."""
    made = render_terrain(
        TerrainParams(seed=3, width_px=WIDTH, height_px=HEIGHT, focal_px=250.0, roll_deg=6.0, pitch_deg=-9.0)
    )
    right = StereoPair(made.left, made.right, calibration=made.calibration, mount=made.mount, attitude=made.attitude)
    negated = Attitude(-made.attitude.roll_rad, -made.attitude.pitch_rad)
    yield system.reconstruct(replace(right, attitude=negated)).decision
    radians = Attitude(np.radians(made.attitude.roll_rad), np.radians(made.attitude.pitch_rad))
    yield system.reconstruct(replace(right, attitude=radians)).decision
    half = Attitude(made.attitude.roll_rad, -made.attitude.pitch_rad)
    yield system.reconstruct(replace(right, attitude=half, disparity_range_px=(0, 10))).decision
    for change in ({"baseline_m": 0.15}, {"doffs_px": -7.0}):
        yield system.reconstruct(replace(right, calibration=replace(made.calibration, **change))).decision
    yield system.decide(StereoPair(*plane(texture(1), 12)[::-1], calibration=replace(CAMERA, doffs_px=4.0)))
    wall = StereoPair(*plane(texture(1), 12), calibration=replace(CAMERA, baseline_m=0.4), attitude=Attitude())
    yield system.reconstruct(wall).decision
    yield system.reconstruct(house_before_a_yard()).decision
    tiny = folder / "tiny.yaml"
    tiny.write_text(TINY_CELLS)
    yield ExpertSystem(rules=[tiny], engine="compiled").reconstruct(right).decision
    unlike = made.right.copy()
    unlike[150:] = texture(9)[150:, :WIDTH, None]
    yield system.reconstruct(replace(right, right=unlike)).decision
    file = folder / "careless.yaml"
    file.write_text(CARELESS)
    noisy = distort_right(Views(made.left, made.right), "noise", seed=1, strength=4.0)
    careless = ExpertSystem(rules=[file], engine="compiled")
    yield careless.reconstruct(replace(right, right=noisy.right)).decision


def lit_decisions(system: ExpertSystem) -> Iterator[Decision]:
    """Yield decisions on pairs in other light: corresponding points are compared, on strips only histograms."""
    left, right = plane(texture(6), 12)
    across = np.linspace(0.75, 1.3, WIDTH)
    yield system.decide(StereoPair(left, np.clip(right * across, 0, 255).astype(np.uint8)))
    yield ExpertSystem(profile="fast", engine="compiled").decide(StereoPair(left, right // 2))
    shadow = np.where((np.arange(WIDTH) // 60) % 2, 0.3, 0.7)
    yield system.decide(StereoPair(left, (right * shadow).astype(np.uint8)))
    bright, dim = (image[:20].astype(float) for image in (left, right))
    red = np.stack([np.clip(dim + 40, 0, 255), dim, dim], axis=-1)
    yield system.decide(StereoPair(np.repeat(bright[..., None], 3, -1).astype(np.uint8), red.astype(np.uint8)))
    bent = 255 * (right / 255.0) ** 1.6
    yield system.decide(StereoPair(left, (bent * np.where(np.arange(WIDTH) < 130, 0.5, 1.0)).astype(np.uint8)))
    flat = texture(1, width=WIDTH)[:20] * 0.3 + np.linspace(0, 180, WIDTH)
    curve = (255 * (np.arange(256) / 255.0) ** 3).astype(np.uint8)
    yield system.decide(StereoPair(flat.astype(np.uint8), curve[flat.astype(np.uint8)]))


def faulty_decisions(system: ExpertSystem) -> Iterator[Decision]:
    """Yield decisions on pairs whose right image has defects of the sensor, motion blur or blocks of compression."""
    left, right = plane(texture(7), 12)
    random = np.random.default_rng(0)
    stuck = right.copy()
    stuck[random.integers(HEIGHT, size=60), random.integers(WIDTH, size=60)] = 255
    stripes = right.copy()
    stripes[:, [40, 90, 200]] //= 2
    smeared = cv2.blur(right, (9, 1))
    blocks = cv2.imdecode(cv2.imencode(".jpg", right, [cv2.IMWRITE_JPEG_QUALITY, 12])[1], cv2.IMREAD_GRAYSCALE)
    yield system.decide(StereoPair(left, right, disparity_range_px=(40, 72)))
    for damaged in (stuck, stripes, smeared, blocks):
        yield system.decide(StereoPair(left, np.asarray(damaged, np.uint8)))
    for light in np.broadcast_to(np.linspace(20, 220, WIDTH), (HEIGHT, WIDTH)), weak_scene():
        photons = random.normal(light, np.sqrt(light)).clip(0, 255).astype(np.uint8)
        yield system.decide(StereoPair(photons, photons))
        yield system.decide(StereoPair(light.astype(np.uint8), light.astype(np.uint8)))
    fence = np.tile(np.rint(120 + 60 * np.sin(np.arange(WIDTH) / 3)).astype(np.uint8), (HEIGHT, 1))
    yield system.decide(StereoPair(fence, fence))


def weak_scene() -> NDArray[np.float64]:
    """Return a smooth bright sky over ground that is rippled along the rows."""
    ripples = 90 + 50 * np.sin(np.arange(HEIGHT) / 2.0)
    ripples[: HEIGHT // 3] = 220
    return np.broadcast_to(ripples[:, None], (HEIGHT, WIDTH))


def calibration_decisions(system: ExpertSystem) -> Iterator[Decision]:
    """Yield decisions on calibrations that are doubtful, scaled or shifted, and on an attitude that is only assumed."""
    left, right = plane(texture(1), 12)
    pair = StereoPair(left, right, calibration=CAMERA)
    yield system.decide(replace(pair, preparation=Preparation(calibration_scale=0.5)))
    lower = np.roll(right, 3, axis=0)
    yield system.decide(replace(pair, right=lower, preparation=Preparation(rectified_here=True)))
    yield system.decide(replace(pair, attitude=Attitude(sigma_rad=0.1)))
    near = plane(texture(1), 30)[1]
    both = np.concatenate([right[: HEIGHT // 2], near[HEIGHT // 2 :]])
    shifted = replace(CAMERA, doffs_px=-20.0)
    yield system.reconstruct(StereoPair(left, both, calibration=shifted, attitude=Attitude())).decision


def sequence_decisions(system: ExpertSystem) -> Iterator[Decision]:
    """Yield decisions on pairs that follow others of one scene, with rows, light or range to take over."""
    left, right = plane(texture(1), 12)
    dimmed = StereoPair(left, np.roll(right // 2 + 20, 2, axis=0))
    before = system.reconstruct(dimmed).decision
    yield system.decide(dimmed, previous=before)
    yield ExpertSystem(profile="fast", engine="compiled").decide(dimmed, previous=before)
    first = system.reconstruct(StereoPair(left, right)).decision
    for shift in (15, 16, 17, 18, 40):
        nearer = StereoPair(left, plane(texture(1), shift)[1])
        yield system.reconstruct(nearer, previous=first).decision
    near = system.reconstruct(StereoPair(left, plane(texture(1), 30)[1])).decision
    for shift in (29, 28, 26, 24, 20):
        farther = StereoPair(left, plane(texture(1), shift)[1])
        yield system.reconstruct(farther, previous=near).decision
    hidden = right.copy()
    hidden[:, 160:] = texture(8)[:, : WIDTH - 160]
    yield system.reconstruct(StereoPair(left, hidden), previous=first).decision


def before_intensities() -> Iterator[Decision]:
    """Yield decisions without numba, where the matcher compares intensities."""
    left, right = plane(texture(6), 12)
    across = np.linspace(0.75, 1.3, WIDTH)
    shadow = np.where((np.arange(WIDTH) // 60) % 2, 0.3, 0.7)
    fast = ExpertSystem(profile="fast", engine="compiled")
    y, x = np.mgrid[-1 : 1 : HEIGHT * 1j, -1 : 1 : WIDTH * 1j]
    corners = 1 - 0.3 * (x**2 + y**2)
    for light in (corners, np.broadcast_to(across, x.shape), corners * across, np.broadcast_to(shadow, x.shape)):
        yield fast.decide(StereoPair(left, np.clip(right * light, 0, 255).astype(np.uint8)))
    grey = np.repeat(right[..., None], 3, -1) * corners[..., None]
    tinted = np.clip(grey * (1.15, 1.0, 0.8), 0, 255).astype(np.uint8)
    yield fast.decide(StereoPair(np.repeat(left[..., None], 3, -1), tinted))
    yield fast.reconstruct(StereoPair(texture(2)[:, :WIDTH], texture(3)[:, :WIDTH])).decision
    strips = [np.clip(image[:20] * light, 0, 255) for image, light in ((left, across), (right, across[::-1]))]
    yield fast.reconstruct(StereoPair(*(strip.astype(np.uint8) for strip in strips))).decision


def test_every_shipped_rule_fires_for_some_pair(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    system = ExpertSystem(engine="compiled")
    fired: set[str] = set()
    decisions = (
        rendered_decisions(system),
        synthetic_decisions(system, tmp_path),
        misplaced_decisions(system, tmp_path),
        lit_decisions(system),
        faulty_decisions(system),
        calibration_decisions(system),
        sequence_decisions(system),
    )
    for decision in itertools.chain(*decisions):
        fired |= rules_of(decision)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    for decision in before_intensities():
        fired |= rules_of(decision)

    shipped = load_rules(None, vocabulary(probes().values()), operators(), probes()).base.rules
    assert sorted({rule.id for rule in shipped} - fired) == []
