"""Reconstruct a pair from files with every input that can be given, and use the result.

    python examples/reconstruct.py [FOLDER]

FOLDER holds left.png, right.png, calibration.yaml and attitude.yaml, as `terrex simulate --out FOLDER` writes them;
without it a small pair is rendered first.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np
from small_pair import write_small_pair

from expert import ExpertSystem, StereoPair


def main(folder: Path, out: Path) -> None:
    pair = StereoPair.load(
        folder / "left.png",
        folder / "right.png",
        calibration=folder / "calibration.yaml",
        attitude=folder / "attitude.yaml",
    )
    system = ExpertSystem(profile="balanced", engine="experta")
    result = system.reconstruct(pair)
    print(result.decision.text())
    print(f"{100 * np.isfinite(result.disparity_px).mean():.0f} % of the pixels have a disparity")
    if result.points is not None and result.elevation is not None:
        print(f"{len(result.points)} points, elevation map of {result.elevation.shape} cells")
    result.save(out)
    print(f"saved: {', '.join(sorted(path.name for path in out.iterdir()))}")


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as temporary:
        given = Path(sys.argv[1]) if len(sys.argv) > 1 else write_small_pair(Path(temporary) / "pair")
        main(given, Path(temporary) / "out")
