"""Poses of a sequence from CSV."""

import math

import pytest

from modules.formats import FormatError
from modules.formats.poses import read_poses

HEAD = "name,time_s,x_m,y_m,z_m,roll_deg,pitch_deg,yaw_deg"


def test_poses_are_read_with_their_uncertainty(tmp_path):
    (tmp_path / "p.csv").write_text(f"{HEAD}, sigma_m, sigma_deg\na,1.5,1,2,3,10,-20,90,0.02,0.5\nb,2,0,0,0,0,0,0,,\n")
    first, second = read_poses(tmp_path / "p.csv")
    assert (first.name, first.time_s, first.pose.translation_m, first.pose.sigma_m) == ("a", 1.5, (1, 2, 3), 0.02)
    angles = (first.pose.attitude.roll_rad, first.pose.attitude.pitch_rad, first.pose.attitude.yaw_rad)
    assert angles == pytest.approx([math.radians(a) for a in (10, -20, 90)])
    assert first.pose.attitude.sigma_rad == pytest.approx(math.radians(0.5))
    assert (second.pose.sigma_m, second.pose.attitude.sigma_rad) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "has no poses; write the header name,time_s"),
        ("name,time_s\na,1\n", "lacks x_m, y_m, z_m, roll_deg"),
        (f"{HEAD},speed\na,1,0,0,0,0,0,0,1\n", "has unknown columns speed"),
        (f"{HEAD}\na,1,0,0,0,0,0,zero\n", "line 2: yaw_deg is 'zero' and must be a finite number"),
        (f"{HEAD}\na,1,0,0,0,0,0,0\na,2,0,0,0,0,0,0\n", "line 3: the name a occurs twice"),
        (f"{HEAD}\na,2,0,0,0,0,0,0\nb,1,0,0,0,0,0,0\n", "line 3: time 1 s is before 2 s; sort the lines"),
        (f"{HEAD}\na,2,0,0,0,0,120,0\n", "line 2: pitch_deg is 120, beyond 90; give degrees"),
        (f"{HEAD}\na,nan,0,0,0,0,0,0\nb,inf,0,0,0,0,0,0\n", "line 2: time_s .* line 3: time_s"),
    ],
)
def test_wrong_pose_files_are_refused(tmp_path, text, words):
    (tmp_path / "p.csv").write_text(text)
    with pytest.raises(FormatError, match=words):
        read_poses(tmp_path / "p.csv")
