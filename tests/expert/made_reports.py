"""A hand-made record and the files of its run; every free text of both may be markup."""

from __future__ import annotations

import tempfile
from pathlib import Path

import cv2
import numpy as np

from expert.decision import Decision, FactRecord, FindingRecord, FiringRecord, TrialRecord
from expert.plan import Candidate, StagePlan, Step
from modules.formats.layers import write_layers
from modules.types import ElevationMap, Hazard, Invalid, Sight

EVIL = "<script>alert('x')</script>\"&'"


def record(text: str = "word", **changes: object) -> Decision:
    """Return a decision of one stage whose free texts all contain `text`."""
    fact = FactRecord(template="brightness", fields={"offset_dn": -13.97, "gain": 1.05}, probe="measurement.brightness")
    other = FactRecord(template=text, fields={text: text}, probe=text)
    loser = Candidate(operator=text, rule=text, score=0.1, priority=1, lost_because=text)
    step = Step(
        slot="radiometry",
        operator="correction.match_histograms",
        parameters={"channels": text, "range": (1, 2)},
        chosen_by="COR1",
        set_by={"channels": "COR1", "range": "COR1"},
        losers=(loser,),
    )
    plan = StagePlan(stage="correction", steps=(step,))
    firing = FiringRecord(rule="COR1", name=text, stage="correction", bindings={"b": fact, text: other}, because=text)
    values: dict[str, object] = {
        "pair": text,
        "status": "disparity_only",
        "profile": "balanced",
        "rules_digest": "0" * 64,
        "inputs": {side: {"sha256": "1" * 64, "shape": (2, 3), "dtype": "uint8"} for side in ("left", "right")},
        "facts": (fact, other),
        "firings": (firing,),
        "findings": (FindingRecord(name=text, severity="major", sentence=text, rules=(text,), stage="correction"),),
        "plans": {"correction": plan},
        "trials": (TrialRecord(stage="matching", number=1, plan=plan, score=0.5, kept=True, answer=text),),
        "notes": (text,),
        "engine": "compiled",
        "versions": {text: text},
        "timings_s": {"matching.x": 2.0, text: 1.0},
    }
    return Decision.model_validate({**values, **changes})


def png(image: np.ndarray) -> bytes:
    return cv2.imencode(".png", image)[1].tobytes()


def pair_images() -> dict[str, bytes]:
    rng = np.random.default_rng(0)
    left = rng.integers(40, 200, (60, 80, 3), np.uint8)
    validity = np.zeros((60, 80), np.uint16)
    validity[:30] = int(Invalid.OUTSIDE)
    validity[:15] |= int(Invalid.SATURATED)
    return {
        "left_corrected.png": png(left),
        "right_corrected.png": png(left),
        "right_original.png": png(left // 2),
        "validity.png": png(validity),
        "disparity_view.png": png(left),
        "confidence.png": png(left[..., 0]),
        "ortho.png": png(np.full((9, 6, 3), 90, np.uint8)),
        "layers.npz": layers(),
    }


def layers(rows: int = 6, columns: int = 9, seed: int = 5) -> bytes:
    """Return the layers of a small map that has everything that is drawn."""
    rng = np.random.default_rng(seed)
    elevation = rng.normal(0.0, 0.1, (rows, columns)).astype(np.float32)
    elevation[0, 0] = np.nan
    sight = np.where(np.isfinite(elevation), Sight.MEASURED, Sight.OCCLUDED).astype(np.uint8)
    parts = {
        "elevation": elevation,
        "sigma_m": np.full((rows, columns), 0.01, np.float32),
        "slope_deg": rng.uniform(0, 40, (rows, columns)).astype(np.float32),
        "traversability": rng.uniform(0, 1, (rows, columns)).astype(np.float32),
        "hazard": np.full((rows, columns), Hazard.STEP, np.uint8),
        "sight": sight,
    }
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "layers.npz"
        write_layers(path, ElevationMap(1.0, -0.3, 0.1, parts))
        return path.read_bytes()
