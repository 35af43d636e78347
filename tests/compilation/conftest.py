"""Shared by the tests of compilation: models without numba."""

from types import ModuleType

import pytest

from kneexo.compilation.codegen import source_text
from kneexo.compilation.expressions import read_equations
from kneexo.compilation.model import CompiledModel, DiagramModel
from kneexo.compilation.scenarios import scenario_diagram, scenario_run


def interpreted_module(text):
    """A generated module as plain Python: what numba would compile, without waiting for it."""
    module = ModuleType("interpreted")
    text = text.replace("from numba import njit\n", "def njit(**_): return lambda f: f\n")
    exec(compile(text, "<generated>", "exec"), module.__dict__)
    return module


@pytest.fixture(scope="session")
def interpreted_diagram():
    """``interpreted_diagram(diagram, inputs)``: its model without numba."""

    def make(diagram, inputs=()):
        text = source_text("diagram", read_equations(diagram, inputs))
        return DiagramModel(diagram, interpreted_module(text))

    return make


@pytest.fixture(scope="session")
def interpreted():
    """``interpreted(scenario)``: its model without numba, with parameters, state and inputs."""

    def make(scenario):
        inputs = ("knee_reference",) if scenario.reference.kind == "samples" else ()
        equations = read_equations(scenario_diagram(scenario), inputs)
        model = CompiledModel(interpreted_module(source_text("closed_loop", equations)))
        return model, scenario_run(scenario, model)

    return make
