"""A scenario is hashable, can be sent to a worker, and knows the plant of its controller."""

import pickle

import pytest

from kneexo.parameters import (
    G2,
    CylinderParameters,
    KneeLoadParameters,
    PidParameters,
    PlantParameters,
    SampledReference,
    Scenario,
)
from kneexo.studies.paper import IDEAL_SMC


def test_the_controller_believes_in_the_plant_unless_a_nominal_one_is_given() -> None:
    nominal = PlantParameters(cylinder=CylinderParameters(mass_kg=1.0))
    assert Scenario().believed_plant is Scenario().plant
    assert Scenario(nominal=nominal).believed_plant == nominal


@pytest.mark.parametrize(
    "scenario",
    [
        Scenario(),
        IDEAL_SMC,
        Scenario(
            nominal=PlantParameters(linkage=G2, load=KneeLoadParameters()),
            controller=PidParameters(),
            reference=SampledReference(times_s=(0.0, 1.0, 2.0), angles_deg=(5.0, 6.0, 5.5)),
        ),
    ],
    ids=["default", "ideal", "pid"],
)
def test_scenario_is_hashable_and_picklable(scenario: Scenario) -> None:
    copy = pickle.loads(pickle.dumps(scenario))
    assert copy == scenario
    assert hash(copy) == hash(scenario)
    assert len({scenario, copy, Scenario(bus={"latency_samples": 3})}) == 2
