"""Print from what misalignment on it pays to align rows, and how well the misalignment is measured.

The evidence behind MEA003, MEA007 and COR001. The right image is moved down, or turned about its centre; below the
errors of the matchers stands what the fact `row_alignment` reads of each: the error of its offset and the root mean
square misalignment that MEA007 compares.

    TERREX_DATA=FOLDER python examples/evidence/alignment.py [--every 3] [--terrain 2] [--matchers sgbm own block]
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
from comparison import ALIGN, arguments, cases, compare, distort

from modules.catalog import probes
from modules.measurement.sample import Sample
from modules.simulation.sensor import SensorParams

OFFSETS_PX = (0.15, 0.3, 0.45, 0.6, 1.0, 2.0, 6.0)
TURNS_RAD = (0.001, 0.003)
DISTORTIONS = {
    "clean": SensorParams(),
    **{f"{offset} px down": SensorParams(shift_y_px=offset) for offset in OFFSETS_PX},
    **{f"turned by {turn} rad": SensorParams(misalign_rad=turn) for turn in TURNS_RAD},
}
CORRECTIONS = {"align_rows, as measured": ((ALIGN, {}),)}


def measured(given: argparse.Namespace) -> None:
    """Print what the fact reads of each misalignment: least, median and largest over the pairs."""
    read: dict[str, list[tuple[float, float]]] = {kind: [] for kind in DISTORTIONS}
    for number, case in enumerate(cases(given.data, given.every, given.terrain)):
        for kind, params in DISTORTIONS.items():
            views = distort(case.views, params, seed=number)
            fact: Any = probes()["measurement.row_alignment"].function(Sample(views))[0]
            if fact.offset_px is not None:
                read[kind].append((fact.offset_px - params.shift_y_px, fact.rms_px))
    print(f"\n{'read by row_alignment, px':24s}{'error of the offset':>30s}{'rms_px':>30s}")
    for kind, values in read.items():
        points = np.percentile(np.array(values), (0, 50, 100), axis=0)
        print(f"{kind:24s}" + "".join("".join(f"{p:10.2f}" for p in points[:, column]) for column in (0, 1)))


if __name__ == "__main__":
    chosen = arguments(__doc__)
    compare(chosen, DISTORTIONS, CORRECTIONS)
    measured(chosen)
