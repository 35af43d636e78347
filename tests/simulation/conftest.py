"""Shared by the tests of simulation."""

import pytest

from kneexo.simulation import compile_scenario, scenario_run


@pytest.fixture(scope="session")
def compiled_run():
    """``compiled_run(scenario)``: its model, with parameters, state and inputs."""

    def make(scenario):
        model = compile_scenario(scenario)
        return model, scenario_run(scenario, model)

    return make
