"""For tests of pages: the solver of a web module, and the script that types a number."""

import re

import pytest


def solver_of(table):
    """The simulation settings with which the engine has the method of a module."""
    tolerance = table["rosenbrock_tolerance"]
    if tolerance is not None:
        return {"integrator": "rosenbrock", "tolerance": tolerance}
    step_s = table["sample_time_s"] / table["rk4_steps_per_tick"]
    return {"integrator": "rk4", "step_s": step_s}


def typed(name, value):
    """The script that writes a value into the field of a quantity."""
    return f"""(() => {{ const box = document.getElementById("q-{name}-value");
      box.value = "{value}"; box.dispatchEvent(new Event("change")); }})()"""


def check_words(shown, printed):
    """A page says what kneexo prints, but neither reasons in parentheses nor the time at rest.

    Its numbers may be rounded differently.
    """
    printed = re.sub(r" \(.*?\)|, and then .*? N·m", "", printed)
    number = r"\d+(?:\.\d+)?"
    assert re.sub(number, "#", shown) == re.sub(number, "#", printed)
    values = [[float(value) for value in re.findall(number, text)] for text in (shown, printed)]
    assert values[0] == pytest.approx(values[1], rel=5e-3)
