"""The nodes of the anatomical knee, and the file of a user's knee."""

import numpy as np
import pytest

from kneexo.errors import ParameterError, ScenarioError
from kneexo.geometry.shank_motion import anatomical_motion
from kneexo.parameters import GAIT2392, AnatomicalKneeParameters
from kneexo.parameters.wearer.anatomical_knee import read_anatomical_knee

ANGLES_DEG = np.arange(-10.0, 121.0, 1.0)


def written(path, columns):
    rows = [
        ",".join(columns),
        *(",".join(f"{v:.12g}" for v in row) for row in zip(*columns.values(), strict=True)),
    ]
    path.write_text("\n".join(rows) + "\n")
    return path


def test_the_nodes_are_those_of_gait2392_with_flexion_positive():
    nodes = dict(zip(GAIT2392.anterior_angles_rad, GAIT2392.anterior_m, strict=True))
    # OpenSim, Models/Gait2392_Simbody: knee_angle, tibia in front of the femur's origin.
    assert nodes[2.0944] == -0.0032
    assert nodes[1.0472] == 0.0041
    assert nodes[-2.0944] == -0.00525
    assert dict(zip(GAIT2392.up_angles_rad, GAIT2392.up_m, strict=True))[1.22173] == -0.4082
    assert (len(nodes), len(GAIT2392.up_m)) == (12, 7)
    assert GAIT2392.range_rad == (-2.0944, 2.0944)


@pytest.mark.parametrize("what", ["place", "centre"])
def test_a_file_gives_the_motion_that_it_was_written_from(tmp_path, what):
    motion = anatomical_motion(GAIT2392, np.radians(ANGLES_DEG))
    start = anatomical_motion(GAIT2392, 0.0).translation
    point = (motion.translation if what == "place" else motion.fixed_centrode) - start
    forwards, up = ("anterior_mm", "up_mm") if what == "place" else ("icr_anterior_mm", "icr_up_mm")
    columns = {"knee_flexion_deg": ANGLES_DEG, forwards: -1e3 * point.real, up: 1e3 * point.imag}
    knee = read_anatomical_knee(written(tmp_path / "knee.csv", columns))
    angles = np.radians(np.linspace(0.0, 90.0, 37))
    expected = anatomical_motion(GAIT2392, angles).translation - start
    got = anatomical_motion(knee, angles).translation - anatomical_motion(knee, 0.0).translation
    # Splines through 1° nodes of splines whose third derivative jumps: 1e-6 m at most.
    np.testing.assert_allclose(got, expected, atol=5e-6)


@pytest.mark.parametrize("count", [0, 2])
def test_a_file_of_fewer_than_three_rows_is_refused(tmp_path, count):
    columns = {name: values[:count] for name, values in GOOD.items()}
    path = written(tmp_path / "knee.csv", columns)
    with pytest.raises(ScenarioError, match=rf"has {count} rows of numbers: must have at least 3"):
        read_anatomical_knee(path)


GOOD = {
    "knee_flexion_deg": [0.0, 60.0, 120.0],
    "anterior_mm": [0.0, 4.0, -3.0],
    "up_mm": [0.0, -9.0, -27.0],
}


@pytest.mark.parametrize(
    ("name", "values", "message"),
    [
        ("knee_flexion_deg", [0.0, 1.0, 2.09], "ends at 2.09 deg: must reach 10 deg; .* in deg"),
        ("knee_flexion_deg", [-50.0, -20.0, 0.0], "ends at 0 deg: .*; flexion is positive"),
        ("knee_flexion_deg", [-120.0, -60.0, 0.0], "= -120 deg is out of range: must be >= -60"),
        ("knee_flexion_deg", [0.0, 60.0, 40.0], "= 40 deg after 60 deg: must increase"),
        ("knee_flexion_deg", [5.0, 60.0, 120.0], "must have full extension, 0 rad, and flexion"),
        ("up_mm", [0.0, -9.0, -2700.0], "up_mm = -2700 mm is out of range: must be >= -1000"),
        ("up_mm", None, "has no column 'up_mm'; it has .*; rename its columns"),
        ("icr_anterior_mm", [0.0] * 3, "has places and centres of rotation: must have one of both"),
    ],
)
def test_a_faulty_file_is_one_line(tmp_path, name, values, message):
    columns = GOOD | {name: values}
    if values is None:
        del columns[name]
    with pytest.raises(ScenarioError, match=message) as error:
        read_anatomical_knee(written(tmp_path / "knee.csv", columns))
    assert "knee.csv" in str(error.value)
    assert "\n" not in str(error.value)


def test_a_path_of_three_mm_may_be_in_cm(tmp_path, recwarn):
    read_anatomical_knee(written(tmp_path / "knee.csv", GOOD))
    still = GOOD | {"anterior_mm": [0.0] * 3, "up_mm": [0.0] * 3}  # a hinge
    read_anatomical_knee(written(tmp_path / "knee.csv", still))
    assert not recwarn.list
    in_cm = {name: [value / 10.0 for value in values] for name, values in GOOD.items()}
    columns = in_cm | {"knee_flexion_deg": GOOD["knee_flexion_deg"]}
    with pytest.warns(
        UserWarning, match=r"anterior_mm and up_mm change by 2.7 mm at most; are they in cm"
    ):
        read_anatomical_knee(written(tmp_path / "knee.csv", columns))


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"up_m": (0.0, -0.1, 0.0)}, "up_angles_rad has 7 values and up_m has 3"),
        ({"up_angles_rad": (0.0, 1.0, 0.5), "up_m": (0.0,) * 3}, "up_angles_rad: must increase"),
        ({"up_angles_rad": (-2.0, -1.0, 0.0), "up_m": (0.0,) * 3}, "flexion, which is positive"),
    ],
)
def test_faulty_nodes_are_one_line(values, message):
    with pytest.raises(ParameterError, match=message):
        AnatomicalKneeParameters(**values)
