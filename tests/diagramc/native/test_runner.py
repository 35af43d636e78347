"""Pieces and defaults of a runner."""

import inspect

from diagramc.native.runner import Runner


def test_a_piece_of_a_run_has_as_many_steps_whatever_their_size(servo):
    model = servo[0]
    pieces = {
        step: Runner(model.code, integrator="rk4", step_s=step).piece for step in (2e-4, 2e-5)
    }
    assert pieces == {2e-4: 16_000, 2e-5: 1_600}  # ticks of 2 ms


def test_defaults_of_the_integrators():
    signature = inspect.signature(Runner)
    defaults = {name: signature.parameters[name].default for name in ("step_s", "tolerance")}
    assert defaults == {"step_s": 2e-4, "tolerance": None}  # see test_rosenbrock.py
