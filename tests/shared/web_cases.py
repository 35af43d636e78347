"""The solver of a web module, for the tests that compare pages with the compiled engine."""


def solver_of(table):
    """The simulation settings with which the engine has the method of a module."""
    tolerance = table["rosenbrock_tolerance"]
    if tolerance is not None:
        return {"integrator": "rosenbrock", "tolerance": tolerance}
    step_s = table["sample_time_s"] / table["rk4_steps_per_tick"]
    return {"integrator": "rk4", "step_s": step_s}
