"""Pieces and defaults of a runner."""

from diagramc.native.runner import Runner


def test_a_piece_of_a_run_has_as_many_steps_whatever_their_size(servo):
    model = servo[0]
    pieces = {
        step: Runner(model.code, integrator="rk4", step_s=step).piece for step in (2e-4, 2e-5)
    }
    assert pieces == {2e-4: 16_000, 2e-5: 1_600}  # ticks of 2 ms
