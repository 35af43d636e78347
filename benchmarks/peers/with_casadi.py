"""The simple loop in CasADi: one sample as a function, mapped over all samples, as C code."""

from __future__ import annotations

import contextlib
import subprocess
import tempfile
from pathlib import Path
from types import SimpleNamespace

import casadi as ca
import numpy as np
from hand_written import NoCompilerError, c_compiler
from peers import simple_loop as loop

HOW = "generated C, RK4 0.2 ms"
NOTE = "mapaccum; -O3 -ffast-math, here faster than without"
RK4 = True
_XP = SimpleNamespace(
    **{name: getattr(ca, name) for name in ("cos", "sin", "acos", "atan2", "sqrt")},
    minimum=ca.fmin,
    maximum=ca.fmax,
)


def prepare(p, steps, duration_s):
    """A function that runs the loop and returns rod extension and pressure (n, 2)."""
    x_0, z_0 = loop.start(p)
    dt, h = p.sample_time_s, p.sample_time_s / steps
    state, t, u = ca.SX.sym("state", 6), ca.SX.sym("t"), ca.SX.sym("u")
    y = ca.SX.sym("y", 4)
    rates = ca.Function("rates", [y, u], [ca.vertcat(*loop.derivatives(p, y, u, _XP))])
    x = state[:4]
    command, z = loop.update(p, t, x, state[4:], _XP)
    for _ in range(steps):
        k_1 = rates(x, command)
        k_2 = rates(x + 0.5 * h * k_1, command)
        k_3 = rates(x + 0.5 * h * k_2, command)
        k_4 = rates(x + h * k_3, command)
        x = x + h / 6.0 * (k_1 + 2.0 * (k_2 + k_3) + k_4)
    samples = round(duration_s / dt)
    sample = ca.Function("sample", [state, t], [ca.vertcat(x, *z)])
    trajectory = sample.mapaccum("trajectory", samples)
    times = dt * np.arange(samples)[None, :]
    start = np.array(x_0 + z_0)
    with contextlib.suppress(NoCompilerError):  # then CasADi's virtual machine runs it
        compiler = c_compiler()
        with tempfile.TemporaryDirectory() as directory:
            source = Path(directory, "trajectory.c")
            generator = ca.CodeGenerator(source.name)
            generator.add(trajectory)
            generator.generate(f"{directory}/")
            library = source.with_suffix(".so")
            options = ["-O3", "-march=native", "-ffast-math", "-shared", "-fPIC", "-w"]
            subprocess.run([compiler, *options, source, "-o", library, "-lm"], check=True)
            trajectory = ca.external("trajectory", str(library))

    def run():
        states = np.column_stack([start, trajectory(start, times).full()])
        return states[[loop.EXTENSION, loop.PRESSURE]].T * [1.0, loop.PA_PER_MPA]

    return run
