"""Fixtures and settings that all tests share."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

# The same examples on every run; `make property` draws many new ones.
settings.register_profile(
    "repeatable",
    derandomize=True,
    database=None,
    deadline=None,
    max_examples=30,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.register_profile(
    "thorough", deadline=None, max_examples=1000, print_blob=True, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "repeatable"))


@pytest.fixture(scope="session")
def development_data() -> Path:
    """Return the folder of the development pairs, or skip the test where there is none."""
    value = os.environ.get("TERREX_DATA")
    if not value:
        pytest.skip("needs the development pairs: set TERREX_DATA to the folder that holds their INDEX.json")
    folder = Path(value)
    if not (folder / "INDEX.json").is_file():
        # A wrong path is a mistake of the caller, not an absence: say so loudly.
        pytest.fail(f"TERREX_DATA is {value}, and there is no INDEX.json in it; correct or unset the variable")
    return folder.resolve()
