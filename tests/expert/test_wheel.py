"""The wheel, installed away from the checkout."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import cv2
import pytest
from synthetic_pairs import shifted

pytestmark = pytest.mark.slow
CHECKOUT = Path(__file__).parents[2]
PARTS = ("expert", "modules", "knowledge", "pyproject.toml", "README.md", "LICENSE")


def run(*command: str | Path, where: Path, **variables: str) -> str:
    """Run a command away from the checkout and return what it prints."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    ended = subprocess.run(
        [str(part) for part in command],
        cwd=where,
        env={**kept, **variables},
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    assert ended.returncode == 0, ended.stdout + ended.stderr
    return ended.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the wheel from a copy, so that the checkout gets no build folder."""
    source = tmp_path_factory.mktemp("source")
    for name in PARTS:
        part = CHECKOUT / name
        if part.is_dir():
            shutil.copytree(part, source / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            shutil.copy(part, source / name)
    run(sys.executable, "-m", "build", "--no-isolation", "--wheel", "--outdir", source / "dist", where=source)
    (built,) = (source / "dist").glob("terrex-*.whl")
    return built


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Install the wheel into a folder; what it depends on comes from the environment of the tests."""
    target = tmp_path_factory.mktemp("installed")
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(target)
    return target


def test_the_wheel_carries_the_rules_and_no_tests(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        names = set(archive.namelist())
    assert "knowledge/rules.yaml" in names
    tops = {name.split("/")[0] for name in names}
    assert {name for name in tops if not name.endswith(".dist-info")} == {"expert", "modules", "knowledge"}


def test_the_installed_package_is_the_one_that_runs_and_its_rules_load(installed: Path, tmp_path: Path) -> None:
    program = (
        "import expert, knowledge, modules\n"
        "from expert import ExpertSystem\n"
        "system = ExpertSystem()\n"
        "print(expert.__file__, knowledge.__file__, modules.__file__, sep='\\n')\n"
        "print(len(system._knowledge.rules.base.rules))\n"
    )
    said = run(sys.executable, "-c", program, where=tmp_path, PYTHONPATH=str(installed)).splitlines()
    assert all(Path(line).is_relative_to(installed) for line in said[:3])
    assert int(said[3]) >= 30


def test_the_installed_command_decides_about_a_pair(installed: Path, tmp_path: Path) -> None:
    for name, image in zip(("left.png", "right.png"), shifted(), strict=True):
        cv2.imwrite(str(tmp_path / name), image)
    program = "from expert.cli import main; main()"
    arguments = ("decide", "left.png", "right.png", "--json")
    said = run(sys.executable, "-c", program, *arguments, where=tmp_path, PYTHONPATH=str(installed))
    assert json.loads(said)["status"] == "decided"


def test_the_wheel_names_the_command(wheel: Path) -> None:
    with zipfile.ZipFile(wheel) as archive:
        (points,) = (name for name in archive.namelist() if name.endswith("entry_points.txt"))
        assert "terrex = expert.cli:main" in archive.read(points).decode()
