"""Products by name, from Python and from the command line."""

import sys

import numpy as np
import pytest
import yaml

from expert.cli import main
from expert.products import DEFAULT_PRODUCTS, PRODUCTS, Terrain, check_products, product_writers
from modules.formats import FormatError, read_validity_png, write_image
from modules.formats.rover import read_rover
from modules.types import ElevationMap, Rover


def test_every_product_has_a_summary_and_the_defaults_are_products():
    assert all(product.summary for product in PRODUCTS.values())
    assert set(DEFAULT_PRODUCTS) <= set(PRODUCTS)


def test_all_stands_for_every_product_once():
    assert check_products(["mesh.glb", "all"])[0] == "mesh.glb"
    assert sorted(check_products(["all"])) == sorted(PRODUCTS)


def test_unknown_products_and_missing_extras_are_told_together(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(FormatError) as caught:
        check_products(["mesh.stl", "points.las", "points.ply"])
    text = str(caught.value)
    assert text.startswith("there is no product mesh.stl; possible are all, points.ply")
    assert text.endswith("points.las needs laspy, which is not installed; install terrex[geo]")


def test_what_a_terrain_cannot_give_is_left_out():
    bare = ElevationMap(0.0, 0.0, 0.1, {"elevation": np.zeros((4, 4), np.float32)})
    given = product_writers(Terrain(bare), PRODUCTS)
    assert "elevation.tif" in given
    assert not {"points.ply", "slope.png", "occupancy.yaml"} & set(given)
    assert product_writers(Terrain(None), PRODUCTS) == {}


def test_a_rover_file_overrides_the_defaults(tmp_path):
    (tmp_path / "rover.yaml").write_text("width_m: 1.5\nmax_tilt_deg: 30\n")
    assert read_rover(tmp_path / "rover.yaml") == Rover(width_m=1.5, max_tilt_deg=30.0)


def test_what_a_rover_says_of_its_body_and_its_trust_becomes_gates():
    from expert import ExpertSystem, StereoPair
    from modules.types import Calibration

    image = np.random.default_rng(1).integers(0, 255, (60, 80), dtype=np.uint8)
    pair = StereoPair(image, image, calibration=Calibration(60.0, 40.0, 30.0, 0.1, 80, 60), disparity_range_px=(0, 16))
    rover = Rover(width_m=0.6, body_front_m=0.4, min_confidence=0.7, min_grazing_deg=6.0)
    steps = ExpertSystem(engine="compiled", rover=rover).decide(pair).steps()
    gates = next(step.parameters for step in steps if step.operator == "reconstruction.gate_points")
    assert (gates["body_front_m"], gates["body_back_m"], gates["body_side_m"]) == (0.4, 0.0, 0.3)
    assert (gates["min_confidence"], gates["min_grazing_deg"]) == (0.7, 6.0)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "width_m: 150\nwheel_radius_m: -1\n",
            "wheel_radius_m is -1 and must be 0.001 to 2; width_m is 150 and must be",
        ),
        ("width: 1\n", "unknown field 'width'; did you mean 'width_m'"),
        ("width_m: wide\n", "width_m is 'wide' and must be a number"),
    ],
)
def test_a_wrong_rover_file_is_refused(tmp_path, text, words):
    (tmp_path / "rover.yaml").write_text(text)
    with pytest.raises(FormatError, match=words):
        read_rover(tmp_path / "rover.yaml")


def run(monkeypatch, *words):
    monkeypatch.setattr(sys, "argv", ["terrex", *map(str, words)])
    with pytest.raises(SystemExit) as end:
        main()
    return end.value.code


def test_the_command_line_writes_what_is_asked_for(tmp_path, monkeypatch, capsys):
    from modules.formats.simulation import write_rendered_pair
    from modules.simulation import TerrainParams, render_terrain
    from modules.types import Views

    made = render_terrain(TerrainParams(seed=5, width_px=320, height_px=240, focal_px=250.0, supersample=1))
    pair = tmp_path / "pair"
    write_rendered_pair(
        pair,
        Views(made.left, made.right),
        made.calibration,
        made.mount,
        made.attitude,
        made.disparity_px,
        made.occluded,
        made.elevation,
    )
    (tmp_path / "rover.yaml").write_text("wheel_radius_m: 0.06\nwidth_m: 0.4\n")
    inputs = (pair / "left.png", pair / "right.png", "--calibration", pair / "calibration.yaml")
    wanted = "occupancy.yaml,mesh.glb,terrain.html,layers.npz"
    options = ("--attitude", pair / "attitude.yaml", "--rover", tmp_path / "rover.yaml", "--products", wanted)
    assert run(monkeypatch, "run", *inputs, *options, "--out", tmp_path / "out") == 0
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert {*wanted.split(","), "occupancy.pgm", "report.html"} <= names
    assert "points.ply" not in names
    assert yaml.safe_load((tmp_path / "out" / "occupancy.yaml").read_text())["resolution"] == 0.05
    text = capsys.readouterr().out
    assert "assess_traversability" in text
    hidden = np.full((240, 320), 255, np.uint8)
    hidden[200:] = 0  # the robot is seen in the lowest rows
    write_image(tmp_path / "mask.png", hidden)
    assert run(monkeypatch, "run", *inputs, "--mask", tmp_path / "mask.png", "--out", tmp_path / "masked") == 0
    validity = read_validity_png(tmp_path / "masked" / "validity.png")
    assert (validity[200:] != 0).all()
    assert (validity[150:200] == 0).mean() > 0.5
    write_image(tmp_path / "small.png", hidden[:100])
    assert run(monkeypatch, "run", *inputs, "--mask", tmp_path / "small.png", "--out", tmp_path / "no") == 2
    assert "make the mask on the rectified left image" in capsys.readouterr().err
    assert run(monkeypatch, "run", *inputs, "--products", "mesh.stl", "--out", tmp_path / "no") == 2
    assert "there is no product mesh.stl" in capsys.readouterr().err
    assert run(monkeypatch, "run", *inputs, "--datum", "95", "0", "--out", tmp_path / "no") == 2
    assert "datum 95 0 is no place" in capsys.readouterr().err
    assert not (tmp_path / "no").exists()
