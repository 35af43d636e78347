"""The knee's FMUs with binaries for other machines, run under emulators, and in ecos."""

import shutil

import numpy as np
import pytest

from diagramc.c import build, cross
from kneexo.command_line.main import main
from kneexo.diagrams import SIGNALS
from kneexo.export.fmu import export_fmu
from kneexo.export.target import largest_step_s
from kneexo.parameters import KneeLoadParameters, PlantParameters, Scenario, SimulationParameters
from kneexo.parameters.paths import changed
from kneexo.parameters.presets import with_preset
from kneexo.simulation.compiled import simulate_compiled

TICK_S, STEPS = 0.002, 1000
LOADED = Scenario(plant=PlantParameters(load=KneeLoadParameters()))
LEG = Scenario.model_validate(with_preset("leg", {}))


@pytest.mark.slow(gate=0)
@pytest.mark.parametrize(
    ("fmi", "scenario", "integrator"),
    [(2, LOADED, "rk4"), (3, LOADED, "rk4"), (3, LEG, "rosenbrock")],
)
def test_the_loop_is_the_same_on_each_platform(fmi, scenario, integrator, run_elsewhere, tmp_path):
    """2 s with a disturbance: other mathematical libraries round differently."""
    pytest.importorskip("ziglang", reason="needs Zig: pip install ziglang")
    platforms = ["x86_64-linux", "aarch64-linux", "x86_64-windows"]
    options = {"fmi": fmi, "integrator": integrator, "platforms": platforms}
    file = export_fmu(scenario, tmp_path, "loop", **options)
    rows = {platform: run_elsewhere(file.path, platform, STEPS, TICK_S) for platform in platforms}
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


@pytest.mark.slow
@pytest.mark.parametrize("fmi", [2, 3])
def test_ecos_couples_plant_and_controller(fmi, tmp_path):
    """As libcosim, ecos steps all FMUs at once, so that the command arrives a sample later."""
    if not any(map(shutil.which, build.COMPILERS)):
        pytest.skip("needs a C compiler")
    try:
        from ecospy import EcosSimulation, EcosSimulationStructure
    except (ImportError, OSError):
        pytest.skip("needs ecos: pip install '.[fmu]', apt-get install libtbb12")

    scenario = Scenario(simulation=SimulationParameters(duration_s=1.0))
    delayed = changed(scenario, {"bus.latency_samples": 1})
    step_s = largest_step_s(scenario, "plant")
    data = simulate_compiled(delayed, integrator="rk4", step_s=step_s).data
    names = [f"controller::{name}" for name in SIGNALS["knee_reference"]]
    reference = np.column_stack([data[name] for name in SIGNALS["knee_reference"]])
    with EcosSimulationStructure() as structure:
        for what in ("plant", "controller"):
            structure.add_model(what, export_fmu(scenario, tmp_path, what, fmi=fmi).path)
        for source, target, name in (
            ("plant", "controller", "encoder_reading_rad"),
            ("controller", "plant", "motor_speed_command_rad_s"),
        ):
            structure.make_real_connection(f"{source}::{name}", f"{target}::{name}")
        with EcosSimulation(structure=structure, step_size=TICK_S) as simulation:
            simulation.init()
            values = [simulation.get_real("plant::rod_extension_m")]
            for n in range(500):
                for name, value in zip(names, reference[n].tolist(), strict=True):
                    simulation.set_real(name, value)
                simulation.step(1)
                values.append(simulation.get_real("plant::rod_extension_m"))
    expected = data["rod_extension_m"]
    difference = np.abs(values - expected).max() / np.abs(expected).max()
    print(f"ecos, FMI {fmi}: difference {difference:.1e}")
    assert difference < 1e-9
