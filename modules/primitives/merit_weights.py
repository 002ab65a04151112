"""Weights of the merit of a map; written by `python -m benchmarks.quality_score --write`.

Fitted to 3480 runs of 21 groups of scenes.
"""

from __future__ import annotations

CONSTANT = -0.8359
WEIGHTS = {
    "expected": 0.41524,
    "density": 0.48467,
    "agreement": 1.00698,
    "roughness": -0.00095,
    "breaks": 0.00488,
    "edges": 0.00840,
}
