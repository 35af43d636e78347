"""Simulate 1,000 plants with uncertain parameters and write their metrics into a table."""

import csv

import numpy as np

from kneexo.analysis import track
from kneexo.parameters import CylinderParameters, KneeLoadParameters, PlantParameters, Scenario
from kneexo.sweeps import parallel_map, process_pool


def row_of(values):
    """Simulate one plant; return its parameters and its metrics as a row of the table."""
    mass_kg, bulk_modulus_pa, shank_kg = values
    cylinder = CylinderParameters(mass_kg=mass_kg, bulk_modulus_pa=bulk_modulus_pa)
    plant = PlantParameters(cylinder=cylinder, load=KneeLoadParameters(segment_mass_kg=shank_kg))
    metrics = track(Scenario(plant=plant)).metrics
    return {
        "mass_kg": mass_kg,
        "bulk_modulus_pa": bulk_modulus_pa,
        "shank_kg": shank_kg,
        "max_error_deg": metrics.max_error_deg,
        "mean_command_change_rpm": metrics.mean_command_change_rpm,
    }


def write_table(path, runs=1000, workers=None):
    """Draw the parameters, simulate, by default on all cores, and write a line for each run."""
    draws = np.random.default_rng(1).uniform([1.0, 7.5, 0.0], [4.0, 9.0, 5.0], size=(runs, 3))
    with process_pool(workers) as pool:
        rows = parallel_map(row_of, [(m, 10.0**b, s) for m, b, s in draws.tolist()], executor=pool)
    with open(path, "w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, fieldnames=rows[0])
        writer.writeheader()
        writer.writerows(rows)


if __name__ == "__main__":  # worker processes import this file
    write_table("thousand_runs.csv")
