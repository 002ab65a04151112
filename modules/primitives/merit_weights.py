"""Weights of the merit of a map; written by `python -m benchmarks.quality_score --write`.

Fitted to 3480 runs of 21 groups of scenes.
"""

from __future__ import annotations

CONSTANT = 0.5399
WEIGHTS = {
    "expected": 0.49025,
    "density": 0.41060,
    "agreement": -0.48835,
    "roughness": 0.00189,
    "edges": 0.01243,
}
