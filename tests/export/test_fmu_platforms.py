"""The knee's FMUs with binaries for other machines, run under emulators."""

import numpy as np
import pytest

from kneexo.command_line.main import main
from kneexo.compiler.c import cross
from kneexo.export.fmu import export_fmu
from kneexo.parameters import Scenario
from kneexo.parameters.plant import KneeLoadParameters, PlantParameters

TICK_S, STEPS = 0.002, 1000
LOADED = Scenario(plant=PlantParameters(load=KneeLoadParameters()))


@pytest.mark.slow
@pytest.mark.parametrize("fmi", [2, 3])
def test_the_loop_is_the_same_on_each_platform(fmi, run_elsewhere, tmp_path):
    """2 s with a disturbance: other mathematical libraries round differently."""
    file = export_fmu(LOADED, tmp_path, "loop", fmi=fmi, platforms="all")
    rows = {
        platform: run_elsewhere(file.path, platform, STEPS, TICK_S)
        for platform in ("x86_64-linux", "aarch64-linux", "x86_64-windows")
    }
    native = rows.pop("x86_64-linux")
    largest = np.abs(native).max(axis=0)
    assert np.count_nonzero(largest) > 20
    for platform, values in rows.items():
        difference = np.abs(values - native).max(axis=0)
        relative = difference[largest > 0.0] / largest[largest > 0.0]
        print(f"FMI {fmi}, {platform}: difference {relative.max():.1e}")
        assert np.all(difference <= 1e-9 * largest)


@pytest.mark.parametrize(
    ("platforms", "message"),
    [
        ("win64", "platforms: 'win64' is unknown; must be all, or of x86_64-linux, "),
        ("x86_64-linux,", "platforms: '' is unknown; must be all, or of x86_64-linux, "),
        ("all", "platforms: the compiler Zig is not installed; pip install ziglang, or "),
    ],
)
def test_platforms_that_cannot_be_built_are_one_line(
    platforms, message, tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr(cross, "find_spec", lambda name: None)
    out = tmp_path / "new"
    assert main(["export", "fmu", "--platforms", platforms, "--out", str(out)]) == 2
    error = capsys.readouterr().err
    assert error.startswith(f"kneexo: {message}")
    assert error.count("\n") == 1
    assert not out.exists()
