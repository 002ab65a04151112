"""Every example runs, in a process of its own, as a user would run it."""

import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("decide.py", "corrected by: correction.match_histograms"),
        ("reconstruct.py", "elevation.tif"),
        ("own_rules.py", "speckles up to 300 px"),
    ],
)
def test_the_example_runs_and_prints_what_it_says(name: str, expected: str) -> None:
    done = subprocess.run(
        [sys.executable, str(EXAMPLES / name)], capture_output=True, text=True, timeout=300, check=False
    )
    assert done.returncode == 0, done.stderr
    assert expected in done.stdout
