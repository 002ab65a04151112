from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from synthetic_pairs import SHIFT_PX, shifted, shifted_pair, texture

from expert import Decision, ExpertSystem, Result, StereoPair
from expert.pair import PairError
from modules.formats import FormatError
from modules.formats.images import write_image
from modules.operator import Operator, OperatorError
from modules.types import Attitude, Calibration, Invalid

CALIBRATION = Calibration(focal_px=200.0, cx_px=80.0, cy_px=60.0, baseline_m=0.1, width_px=160, height_px=120)


@pytest.fixture(scope="module")
def system() -> ExpertSystem:
    return ExpertSystem()


@pytest.fixture(scope="module")
def result(system: ExpertSystem) -> Result:
    return system.reconstruct(shifted_pair(calibration=CALIBRATION, attitude=Attitude()))


def test_a_plane_is_reconstructed_at_its_disparity_and_depth(result: Result) -> None:
    assert result.decision.status == "reconstructed"
    assert result.reconstructed
    assert result.disparity_px.dtype == np.float32
    assert result.disparity_px.shape == (120, 160)
    found = np.isfinite(result.disparity_px)
    assert found[:, SHIFT_PX:].mean() > 0.95
    # The interpolation between steps is right to a quarter of one, at the border too.
    assert np.abs(result.disparity_px[found] - SHIFT_PX).max() < 0.25
    assert result.points is not None
    # Body x is forward: Z = f B / d.
    assert np.median(result.points.xyz_m[:, 0]) == pytest.approx(200.0 * 0.1 / SHIFT_PX, rel=0.01)
    assert result.elevation is not None


def test_validity_gives_a_reason_exactly_where_there_is_no_disparity(result: Result) -> None:
    assert result.validity.dtype == np.uint16
    np.testing.assert_array_equal(result.validity == 0, np.isfinite(result.disparity_px))


def test_the_given_images_are_not_changed(system: ExpertSystem) -> None:
    left, right = shifted()
    dark = (right * 0.5).astype(np.uint8)
    before = left.copy(), dark.copy()
    system.reconstruct(StereoPair(left, dark))
    np.testing.assert_array_equal(left, before[0])
    np.testing.assert_array_equal(dark, before[1])


def test_decide_plans_every_stage_and_matches_nothing(system: ExpertSystem) -> None:
    decision = system.decide(shifted_pair())
    assert decision.status == "decided"
    assert list(decision.plans) == ["correction", "matching", "reconstruction"]
    assert decision.trials == ()
    assert not [name for name in decision.timings_s if name.startswith("matching.")]
    assert decision.operator("matching.matcher") == "matching.semi_global_match"
    assert decision.operator("matching.refine") != ""


def test_decide_and_reconstruct_plan_alike_where_nothing_is_repaired(system: ExpertSystem) -> None:
    # The map of a wall seen from the front has few cells; with seed 1 one of them stands alone and is repaired.
    pair = shifted_pair(seed=2, calibration=CALIBRATION, attitude=Attitude())
    assert system.decide(pair).plans == system.reconstruct(pair).decision.plans


def test_a_decision_can_be_read_back_from_its_json(result: Result) -> None:
    data = json.loads(result.decision.to_json())
    assert data.pop("decision_id") == result.decision.id
    again = Decision.model_validate(data)
    assert again.core() == result.decision.core()


def test_without_a_calibration_there_is_a_disparity_and_a_word_on_3d(system: ExpertSystem) -> None:
    result = system.reconstruct(shifted_pair())
    assert result.decision.status == "disparity_only"
    assert result.reconstructed
    assert result.points is None
    assert result.elevation is None
    assert "calibration-missing" in [finding.name for finding in result.decision.findings]
    assert "--calibration" in result.decision.text()


def test_a_given_range_is_used_as_it_is(system: ExpertSystem) -> None:
    decision = system.decide(shifted_pair(disparity_range_px=(2, 21)))
    step = decision.plans["matching"].steps[0]
    assert (step.operator, step.chosen_by) == ("matching.use_range", "MAT001")
    assert (step.parameters["min_px"], step.parameters["max_px"]) == (2, 21)


def dark_right() -> StereoPair:
    left, right = shifted(3)
    return StereoPair(left, (right * 0.5 + 10).astype(np.uint8), calibration=CALIBRATION)


PAIRS = {
    "clean": shifted_pair(calibration=CALIBRATION, attitude=Attitude(0.1, -0.1)),
    "dark right": dark_right(),
    "unrelated": StereoPair(texture(5), texture(6)),
    "swapped": StereoPair(*shifted()[::-1]),
    "constant": StereoPair(np.full((120, 160), 90, np.uint8), np.full((120, 160), 90, np.uint8)),
}


@pytest.mark.parametrize("name", PAIRS)
def test_both_engines_and_every_repeat_give_the_same_core(system: ExpertSystem, name: str) -> None:
    first = system.reconstruct(PAIRS[name])
    second = system.reconstruct(PAIRS[name])
    compiled = ExpertSystem(engine="compiled").reconstruct(PAIRS[name])
    assert first.decision.core() == second.decision.core() == compiled.decision.core()
    assert first.decision.engine == "experta"
    assert compiled.decision.engine == "compiled"
    np.testing.assert_array_equal(first.disparity_px, compiled.disparity_px)


def test_one_system_serves_threads_and_keeps_nothing_of_other_pairs(system: ExpertSystem) -> None:
    alone = {name: system.decide(pair).core() for name, pair in PAIRS.items()}
    found: dict[str, bytes] = {}
    threads = [
        threading.Thread(target=lambda name=name, pair=pair: found.update({name: system.decide(pair).core()}))
        for name, pair in PAIRS.items()
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == alone


def test_a_brightness_difference_is_answered_and_absent_it_is_not(system: ExpertSystem) -> None:
    clean, dark = system.decide(PAIRS["clean"]), system.decide(PAIRS["dark right"])
    assert clean.operator("correction.radiometry") == "none"
    assert dark.operator("correction.radiometry") != "none"
    assert "MEA032" in dark.rules_fired
    assert "MEA032" not in clean.rules_fired


def test_one_file_given_twice_is_not_called_swapped(system: ExpertSystem) -> None:
    same = texture(1, 320, 240)
    found = [finding.name for finding in system.decide(StereoPair(same, same.copy())).findings]
    assert "images-swapped" not in found


RANGE_OF_TERRAIN = """
version: 1
disable: [REC044, REC045]  # a wall has points above the plane, and block matching leaves needles
rules:
  - id: RIG001
    name: terrain-was-made-by-the-accurate-matcher
    stage: reconstruction
    when:
      - {fact: planned, field: operator, op: eq, value: matching.semi_global_match}
      - {fact: terrain_quality}
    then:
      - {repair: matching.block_match, score: 0.95}
    because: it is needed for a test of repairs that reach back
    references: [test]
"""


def test_a_rule_about_the_terrain_can_ask_for_another_matcher(tmp_path: Path) -> None:
    (tmp_path / "rig.yaml").write_text(RANGE_OF_TERRAIN, encoding="utf-8")
    pair = shifted_pair(calibration=CALIBRATION, attitude=Attitude())
    result = ExpertSystem(rules=[tmp_path / "rig.yaml"]).reconstruct(pair)
    decision = result.decision
    assert decision.status == "reconstructed"
    assert decision.operator("matching.matcher") == "matching.block_match"
    assert [(trial.number, trial.kept) for trial in decision.trials if trial.stage == "reconstruction"] == [
        (1, False),
        (2, True),
    ]
    assert "matching.block_match" in decision.timings_s


def as_rgb(image: np.ndarray) -> np.ndarray:
    return np.stack([image, (image * 0.8).astype(image.dtype), (image * 0.6).astype(image.dtype)], axis=-1)


KINDS: dict[str, Any] = {
    "gray": lambda image: image,
    "gray with an axis": lambda image: image[..., None],
    "RGB": as_rgb,
    "RGBA": lambda image: np.dstack([as_rgb(image), np.full(image.shape, 255, np.uint8)]),
    "gray of 16 bit": lambda image: image.astype(np.uint16) * 257,
    "RGB of 16 bit": lambda image: as_rgb(image.astype(np.uint16) * 257),
    "not contiguous": lambda image: np.repeat(image, 2, axis=1)[:, ::2],
}


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_image_gives_the_same_disparity(system: ExpertSystem, kind: str, tmp_path: Path) -> None:
    left, right = (KINDS[kind](image) for image in shifted())
    result = system.reconstruct(StereoPair(left, right))
    found = np.isfinite(result.disparity_px)
    assert found[:, SHIFT_PX:].mean() > 0.95
    error = np.abs(result.disparity_px[found] - SHIFT_PX)
    assert error.max() < 0.5
    assert np.percentile(error, 99) < 0.1  # without a calibration nothing finer is asked for
    result.save(tmp_path / "out")
    assert (tmp_path / "out" / "disparity.pfm").is_file()


def test_8_and_16_bit_of_one_picture_lead_to_one_plan(system: ExpertSystem) -> None:
    low = dark_right()
    high = replace(low, left=low.left.astype(np.uint16) * 257, right=low.right.astype(np.uint16) * 257)
    assert system.decide(low).plans == system.decide(high).plans


def test_a_pair_loads_from_files(system: ExpertSystem, tmp_path: Path) -> None:
    for name, image in zip(("left.png", "right.png"), shifted(), strict=True):
        write_image(tmp_path / name, as_rgb(image))
    (tmp_path / "attitude.yaml").write_text("roll_deg: 5\npitch_deg: -8\n", encoding="utf-8")
    pair = StereoPair.load(tmp_path / "left.png", str(tmp_path / "right.png"), attitude=tmp_path / "attitude.yaml")
    np.testing.assert_array_equal(pair.left, as_rgb(shifted()[0]))
    assert pair.attitude is not None
    assert pair.attitude.roll_rad == pytest.approx(np.radians(5.0))
    assert pair.name == tmp_path.name


def with_nan() -> np.ndarray:
    image = shifted()[0].astype(np.float32)
    image[3, 4] = np.nan
    return image


GOOD = shifted()[0]
WRONG = {
    "NaN": (with_nan(), GOOD, "left contains NaN or infinite values; replace them and convert to uint8 or uint16"),
    "float": (GOOD, GOOD / 255.0, "right has dtype float64; convert it to uint8 or uint16"),
    "signed": (GOOD.astype(np.int16), GOOD, "left has dtype int16; convert it to uint8 or uint16"),
    "list": ([[1, 2]], GOOD, "left: expected a NumPy array, got list; load files with StereoPair.load"),
    "path": ("left.png", GOOD, "left: expected a NumPy array, got str; load files with StereoPair.load"),
    "one pixel": (GOOD[:1, :1], GOOD[:1, :1], "left is 1x1; each side must have at least 16 px"),
    "empty": (GOOD[:0], GOOD[:0], "left is 160x0; each side must have at least 16 px"),
    "sizes": (
        GOOD, GOOD[:100],
        "left is 160x120 and right is 160x100; crop them to one size or rectify the pair first",
    ),
    "depths": (
        GOOD, GOOD.astype(np.uint16), "left is uint8 and right is uint16; convert both to one bit depth",
    ),
    "colour": (
        as_rgb(GOOD), GOOD, "one image is gray and the other is colour; convert both to gray or both to RGB",
    ),
    "two channels": (
        np.dstack([GOOD, GOOD]), GOOD,
        "left has shape (120, 160, 2); expected (H, W), (H, W, 3) RGB or (H, W, 4) RGBA",
    ),
    "enormous": (
        np.broadcast_to(np.uint8(0), (20_000, 20_000)), GOOD,
        "left is 20000x20000; at most 100 megapixels are allowed: downscale it",
    ),
}  # fmt: skip


@pytest.mark.parametrize("fault", WRONG)
def test_arrays_that_are_no_pair_are_refused_with_the_remedy(fault: str) -> None:
    left, right, expected = WRONG[fault]
    with pytest.raises(PairError) as error:
        StereoPair(left, right)  # type: ignore[arg-type]
    assert str(error.value) == expected


def test_a_calibration_of_another_size_is_refused() -> None:
    with pytest.raises(FormatError, match="the calibration is for 320x240 px and the images are 160x120 px"):
        shifted_pair(calibration=replace(CALIBRATION, width_px=320, height_px=240))


@pytest.mark.parametrize("bounds", [(10, 10), (20, 10), (0, 1000), (-500, 0)])
def test_a_range_that_cannot_be_is_refused_with_its_numbers(bounds: tuple[int, int]) -> None:
    with pytest.raises(PairError, match=f"^disparity range {bounds[0]} {bounds[1]} is "):
        shifted_pair(disparity_range_px=bounds)


def test_saving_twice_replaces_the_folder_as_a_whole(result: Result, system: ExpertSystem, tmp_path: Path) -> None:
    out = tmp_path / "out"
    spent = result.save(out)
    assert {path.name for path in out.iterdir()} == {".terrex", *spent}
    assert "elevation.tif" in spent
    system.reconstruct(PAIRS["constant"]).save(out)
    assert not (out / "elevation.tif").exists()
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def test_a_failure_while_saving_keeps_what_was_there(
    result: Result, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object, **__: object) -> None:
        raise FormatError("no space left")

    out = tmp_path / "out"
    result.save(out)
    before = {path.name: path.read_bytes() for path in out.iterdir()}
    monkeypatch.setattr("expert.products.write_geotiff", full)
    with pytest.raises(FormatError, match="no space left"):
        result.save(out)
    assert {path.name: path.read_bytes() for path in out.iterdir()} == before
    assert [path.name for path in tmp_path.iterdir()] == ["out"]


def broken(operator: Operator) -> Operator:
    def fail(*_: object) -> None:
        raise OperatorError("it is broken")

    return replace(operator, function=fail)


def with_broken(*names: str) -> ExpertSystem:
    system = ExpertSystem(engine="compiled")
    knowledge = system._knowledge
    catalog = {name: broken(entry) if name in names else entry for name, entry in knowledge.operators.items()}
    system._knowledge = replace(knowledge, operators=catalog)
    return system


def test_a_correction_that_fails_is_left_out_of_the_plan_and_reported() -> None:
    name = ExpertSystem(engine="compiled").decide(dark_right()).operator("correction.radiometry")
    decision = with_broken(name).reconstruct(dark_right()).decision
    assert decision.status == "reconstructed"
    assert decision.operator("correction.radiometry") != name
    assert f"{name}: it is broken" in decision.text()
    assert "operator-failed" in [finding.name for finding in decision.findings]


def test_a_matcher_that_fails_is_replaced_by_the_default() -> None:
    result = with_broken("matching.semi_global_match").reconstruct(shifted_pair())
    assert result.decision.status == "disparity_only"
    assert result.decision.operator("matching.matcher") == "matching.semi_global_block_match"


def test_a_pair_that_no_matcher_can_do_fails_with_a_report(tmp_path: Path) -> None:
    result = with_broken("matching.semi_global_match", "matching.semi_global_block_match").reconstruct(shifted_pair())
    assert result.decision.status == "failed"
    assert not np.isfinite(result.disparity_px).any()
    assert (result.validity == int(Invalid.NO_MATCH)).all()
    result.save(tmp_path / "out")
    assert "it is broken" in (tmp_path / "out" / "report.md").read_text(encoding="utf-8")


def test_terrain_that_lies_outside_every_gate_is_a_major_finding() -> None:
    far = replace(CALIBRATION, baseline_m=90.0)
    decision = ExpertSystem(engine="compiled").reconstruct(shifted_pair(calibration=far, attitude=Attitude())).decision
    assert "major" in [finding.severity for finding in decision.findings if finding.name == "operator-failed"]
    assert "reconstruction.gate_points: the gates dropped all" in decision.text()


def test_importing_compiles_nothing() -> None:
    program = "import sys, expert; print([name for name in ('numba', 'llvmlite') if name in sys.modules])"
    ended = subprocess.run(
        [sys.executable, "-c", program],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])},
    )
    assert ended.stdout.strip() == "[]"


def decided_elsewhere(seed: int) -> Decision:
    return ExpertSystem(engine="compiled").decide(shifted_pair(seed))


def test_spawned_processes_decide_the_same_and_send_their_decisions_back() -> None:
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        found = list(pool.map(decided_elsewhere, (1, 2)))
    system = ExpertSystem()
    assert [decision.core() for decision in found] == [system.decide(shifted_pair(seed)).core() for seed in (1, 2)]
    assert found[0].why_not("matching.block_match").name == "matching.block_match"


@pytest.mark.parametrize(
    ("left", "name"),
    [
        ("day 3/left.png", "day 3"),
        ("Adirondack/im0.png", "Adirondack"),
        ("x/../ridge/Left.png", "ridge"),
        ("ridge/left_1.png", "left_1"),
        ("pairs/left_0042.png", "left_0042"),
        ("image_0/000001.png", "000001"),
    ],
)
def test_a_pair_is_named_after_what_tells_it_from_others(left: str, name: str, tmp_path: Path) -> None:
    path = tmp_path / left
    path.parent.mkdir(parents=True)
    (tmp_path / "x").mkdir(exist_ok=True)
    path.parent.resolve().mkdir(parents=True, exist_ok=True)
    write_image(path, GOOD)
    assert StereoPair.load(path, path).name == name
