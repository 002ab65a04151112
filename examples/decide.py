"""Ask for the decision about two arrays, without dense matching: what would be done, and why.

python examples/decide.py
"""

from __future__ import annotations

import cv2
import numpy as np

from expert import ExpertSystem, StereoPair


def main() -> None:
    rng = np.random.default_rng(1)
    texture = cv2.GaussianBlur(rng.integers(0, 256, (240, 340), dtype=np.uint8), (0, 0), 1.5)
    texture = cv2.normalize(texture, None, 20, 235, cv2.NORM_MINMAX)
    left, right = texture[:, :320], texture[:, 12:332]  # everything at a disparity of 12 px
    dark = np.clip(np.rint(0.5 * right.astype(np.float32)), 0, 255).astype(np.uint8)

    pair = StereoPair(left, dark, disparity_range_px=(0, 32), name="dark right image")
    decision = ExpertSystem().decide(pair)
    print(decision.text())
    print("corrected by:", decision.operator("correction.radiometry"))
    print("matched by:", decision.operator("matching.matcher"))
    print("rules fired:", ", ".join(decision.rules_fired))


if __name__ == "__main__":
    main()
