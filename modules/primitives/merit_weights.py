"""Weights of the merit of a map; written by `python -m benchmarks.quality_score --write`.

Fitted to 3480 runs of 21 groups of scenes.
"""

from __future__ import annotations

CONSTANT = -0.9459
WEIGHTS = {
    "expected": 0.36561,
    "density": 0.55882,
    "agreement": 1.09489,
    "roughness": 0.00052,
    "edges": 0.01063,
}
