"""Print what corrections do to pairs that really differ: other exposure, other lamps, and a rover's two cameras.

For the development pairs with truth that differ by themselves, bad-1 in % per pair, correction and matcher, and what
the rules choose when that matcher follows. For natural terrain without truth (Devon Island), the share of pixels that
match consistently. With --pictures FOLDER, the pairs before and after the rules' correction are written there, the
left half of each picture from the left image.

    TERREX_DATA=FOLDER python examples/evidence/radiometric_pairs.py [--matchers sgbm own block] [--pictures FOLDER]
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from comparison import CHECKS, MATCHERS, Case, Steps, bad_1, cases, correct

from expert import ExpertSystem, StereoPair
from modules.catalog import operators
from modules.formats.images import read_image
from modules.types import DisparityRange, Matching, Views

CORRECTIONS: dict[str, Steps] = {
    "none": (),
    "match_histograms, left": (("correction.match_histograms", {}),),
    "match_histograms, slope 1.5": (("correction.match_histograms", {"slope_limit": 1.5}),),
    "match_histograms, right": (("correction.match_histograms", {"reference": "right"}),),
    "fit_response": (("correction.fit_response", {}),),
    "warp_histograms_dynamically": (("correction.warp_histograms_dynamically", {}),),
    "calibrate_segments": (("correction.calibrate_segments", {}),),
    "transfer_local_affine": (("correction.transfer_local_affine", {}),),
    "level_gain_field, quadratic": (("correction.level_gain_field", {"shape": "quadratic"}),),
    "normalise_local_contrast": (("correction.normalise_local_contrast", {}),),
    "subtract_bilateral_background": (("correction.subtract_bilateral_background", {}),),
    "filter_homomorphic": (("correction.filter_homomorphic", {}),),
}
INTENSITIES = """version: 1
rules:
  - id: EVI001
    name: intensities-are-compared
    stage: correction
    when: [{fact: task}]
    then: [{derive: intensities-compared}]
    because: The matcher of this comparison compares intensities.
    references: ["examples/evidence/radiometric_pairs.py"]
"""


def system_before(matcher: str) -> ExpertSystem:
    """Return a system that corrects for a matcher."""
    if matcher != "sgbm":
        return ExpertSystem(engine="compiled")
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "follows.yaml"
        file.write_text(INTENSITIES, encoding="utf-8")
        return ExpertSystem(rules=[file], engine="compiled")


def chosen(system: ExpertSystem, views: Views, ndisp: int) -> tuple[Steps, list[str]]:
    """Return the steps that the rules choose, and the names of the findings."""
    decision = system.decide(StereoPair(views.left, views.right, disparity_range_px=(0, ndisp)))
    steps = decision.plans["correction"].steps if "correction" in decision.plans else ()
    found = [finding.name for finding in decision.findings if finding.name != "calibration-missing"]
    return [(step.operator, dict(step.parameters)) for step in steps if step.operator != "none"], found


def consistent(views: Views, ndisp: int, matcher: str) -> float:
    """Return the share of pixels that match from left to right and back, %."""
    state = Matching(views, DisparityRange(0, ndisp))
    for name, values in (MATCHERS[matcher], *CHECKS):
        operator = operators()[name]
        state = operator.function(state, operator.params(**values))
    assert state.disparity is not None
    return 100.0 * float(state.disparity.valid.mean())


def rover_pairs(folder: Path) -> Iterator[tuple[str, Views, int]]:
    """Yield the pairs of Devon Island at half size."""
    for entry in json.loads((folder / "INDEX.json").read_text(encoding="utf-8")):
        if entry["dataset"] == "devon_island":
            images = [read_image(folder / entry[side]) for side in ("left", "right")]
            half = [cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA) for image in images]
            yield entry["scene"], Views(half[0], half[1]), max(64, entry["ndisp"] // 2)


def picture(folder: Path, name: str, before: Views, after: Views) -> None:
    """Write the pair before (above) and after (below), left and right half by half."""
    rows = [np.hstack([views.left, views.right]) for views in (before, after)]
    cv2.imwrite(str(folder / f"{name}.png"), cv2.cvtColor(np.vstack(rows), cv2.COLOR_RGB2BGR))


def show(names: list[str], columns: dict[str, list[float]], title: str) -> None:
    print(f"\n{title}\n{'':34s}" + "".join(f"{name[-14:]:>16s}" for name in names))
    for what, values in columns.items():
        print(f"{what:34s}" + "".join(f"{value:16.2f}" for value in values))


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, default=os.environ.get("TERREX_DATA"))
    parser.add_argument("--matchers", nargs="+", choices=tuple(MATCHERS), default=["sgbm", "own"])
    parser.add_argument("--pictures", type=Path, help="folder for pictures before and after the rules' correction")
    given = parser.parse_args()
    if given.data is None:
        parser.error("name the folder of the pairs with --data, or set TERREX_DATA")
    real: list[Case] = list(cases(Path(given.data), 1, 0, differing=True))
    rovers = list(rover_pairs(Path(given.data)))
    if given.pictures:
        given.pictures.mkdir(parents=True, exist_ok=True)
    for matcher in given.matchers:
        system = system_before(matcher)
        plans = [chosen(system, case.views, case.ndisp) for case in real]
        columns = {
            name: [bad_1(case, correct(case.views, s), matcher) for case in real] for name, s in CORRECTIONS.items()
        }
        after = [correct(case.views, steps) for case, (steps, _) in zip(real, plans, strict=True)]
        columns["rules"] = [bad_1(case, views, matcher) for case, views in zip(real, after, strict=True)]
        show([case.name for case in real], columns, f"{matcher}: bad-1 in %")
        fields = [chosen(system, views, ndisp) for _, views, ndisp in rovers]
        shares = {
            name: [consistent(correct(views, steps), ndisp, matcher) for _, views, ndisp in rovers]
            for name, steps in CORRECTIONS.items()
            if name.startswith(("none", "match", "fit", "transfer"))
        }
        shares["rules"] = [
            consistent(correct(views, steps), ndisp, matcher)
            for (_, views, ndisp), (steps, _) in zip(rovers, fields, strict=True)
        ]
        show([name for name, _, _ in rovers], shares, f"{matcher}: pixels that match consistently, %")
        everything = [(case.name, case.views, plan) for case, plan in zip(real, plans, strict=True)]
        everything += [(name, views, plan) for (name, views, _), plan in zip(rovers, fields, strict=True)]
        for number, (name, views, (steps, found)) in enumerate(everything):
            does = ", ".join(f"{step.split('.')[1]} {values}" for step, values in steps) or "nothing"
            print(f"{name}: {', '.join(found) or 'nothing found'} -> {does}")
            if given.pictures:
                picture(given.pictures, f"{matcher}_{number}_{name.split('/')[-1]}", views, correct(views, steps))


if __name__ == "__main__":
    main()
