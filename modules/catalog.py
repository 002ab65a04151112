"""Every operator and probe by name: explicit mappings, extended by installed packages through entry points.

A package adds its own with the entry point groups `terrex.operators` and `terrex.probes`, each naming an `Operator` or
a `Probe`.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from importlib.metadata import entry_points
from types import MappingProxyType

import modules.correction
import modules.matching
import modules.measurement
import modules.measurement.disparity_agreement as disparity_agreement
import modules.measurement.disparity_quality as disparity_quality
import modules.measurement.terrain_quality as terrain_quality
import modules.reconstruction
from modules.operator import Operator
from modules.probe import Probe

SLOTS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "correction": ("align", "defects", "denoise", "sharpness", "radiometry", "local", "masks"),
        "matching": modules.matching.SLOTS,
        "reconstruction": modules.reconstruction.SLOTS,
    }
)


@cache
def operators() -> Mapping[str, Operator]:
    """Return the operators by name, those of installed plug-ins included."""
    shipped = (*modules.correction.OPERATORS, *modules.matching.OPERATORS, *modules.reconstruction.OPERATORS)
    plugged = tuple(entry.load() for entry in entry_points(group="terrex.operators"))
    return MappingProxyType({operator.name: operator for operator in (*shipped, *plugged)})


@cache
def probes() -> Mapping[str, Probe]:
    """Return the probes by name, those of installed plug-ins included."""
    of_products = (disparity_quality.PROBE, disparity_agreement.PROBE, terrain_quality.PROBE)
    plugged = tuple(entry.load() for entry in entry_points(group="terrex.probes"))
    return MappingProxyType({probe.name: probe for probe in (*modules.measurement.PROBES, *of_products, *plugged)})
