"""Simulate 1,000 plants with random parameters, write a table (pandas), and plot the worst."""

import matplotlib.pyplot as plt
import numpy as np

import kneexo as kx
from kneexo.parameters import KneeLoadParameters, PlantParameters

RUNS = 1000
scenario = kx.Scenario(
    plant=PlantParameters(load=KneeLoadParameters()),  # the knee carries the shank
    nominal=PlantParameters(),  # the plant that the controller believes in stays the same
)
source = np.random.default_rng(1)
result = kx.batch(
    scenario,
    {
        "plant.cylinder.mass_kg": source.uniform(1.0, 4.0, RUNS),
        "plant.cylinder.bulk_modulus_pa": 10.0 ** source.uniform(7.5, 9.0, RUNS),
        "plant.load.segment_mass_kg": source.uniform(0.0, 5.0, RUNS),
    },
    combine="zip",
)
print(result)
result.to_dataframe().to_csv("thousand_runs.csv")
worst = result.worst("max_error_deg")
kx.track(worst.scenario).plot()
plt.savefig("thousand_runs.png")
