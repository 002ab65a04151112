"""Match pairs by CNES Pandora's census and SGM with cross-checking; runs in Pandora's own environment.

Reads one request per line, `{"left": PNG, "right": PNG, "range_px": [min, max], "out": NPY}`, and answers each with
`{"cpu_s": ..., "extra_mb": ...}`; the disparity is NaN where Pandora calls it invalid. `make bench-pandora` makes the
environment.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

PIPELINE = {
    "matching_cost": {"matching_cost_method": "census", "window_size": 5, "subpix": 1},
    "optimization": {"optimization_method": "sgm"},
    "disparity": {"disparity_method": "wta", "invalid_disparity": "NaN"},
    "refinement": {"refinement_method": "vfit"},
    "filter": {"filter_method": "median", "filter_size": 3},
    "validation": {"validation_method": "cross_checking_accurate"},
}


def match(pandora: Any, request: dict[str, Any]) -> tuple[NDArray[np.float32], float]:
    """Return the disparity of a pair, positive to the left, and the CPU time."""
    from pandora.check_configuration import check_conf
    from pandora.constants import Criteria
    from pandora.img_tools import create_dataset_from_inputs
    from pandora.state_machine import PandoraMachine

    low, high = request["range_px"]
    left = {"img": request["left"], "disp": [1 - high, -low], "nodata": -9999}
    right = {"img": request["right"], "nodata": -9999}
    machine = PandoraMachine()
    config = check_conf({"input": {"left": left, "right": right}, "pipeline": PIPELINE}, machine)
    config["input"]["right"]["disp"] = [low, high - 1]
    images = [create_dataset_from_inputs(input_config=config["input"][side]) for side in ("left", "right")]
    start = time.process_time()
    found, _ = pandora.run(machine, *images, config)
    spent = time.process_time() - start
    disparity = -found["disparity_map"].data.astype(np.float32)
    disparity[(found["validity_mask"].data & int(Criteria.PANDORA_MSK_PIXEL_INVALID)) != 0] = np.nan
    return disparity, spent


def peak_mb(*, reset: bool = False) -> float:
    """Return the peak memory of this process since the last reset, MB (Linux)."""
    if reset:
        Path("/proc/self/clear_refs").write_text("5", encoding="ascii")
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 1024


def main() -> None:
    """Answer requests until there are no more."""
    import pandora

    pandora.import_plugin()
    for line in sys.stdin:
        request = json.loads(line)
        before = peak_mb(reset=True)
        disparity, spent = match(pandora, request)
        after = peak_mb()
        np.save(request["out"], disparity)
        sys.stdout.write(json.dumps({"cpu_s": spent, "extra_mb": after - before}) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
