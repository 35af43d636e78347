"""What all leaf systems have in common: ports, states, periods, parameters and conversion.

The end of `docs/drake_systems.md` has the structure of each leaf and of its variants. After a
change that is meant, ``python tests/systems/test_every_leaf.py`` writes the table. The numbers of a
leaf are tested in its own file against an independent source, and the ranges of all parameters in
``tests/parameters/test_every_class.py``.
"""

import inspect
import itertools
import math
import re
from pathlib import Path

import pytest

from diagramc.testing import check_leaf
from kneexo import law as users_law, systems
from kneexo.parameters import (
    BypassParameters,
    CuffParameters,
    KneeLoadParameters,
    LawParameters,
    LegParameters,
    LoadCellParameters,
    PidParameters,
    SlidingModeParameters,
    ThermalParameters,
    TorqueParameters,
)
from kneexo.systems import (
    BackwardDifference,
    BldcPump,
    Cuff,
    FullCylinder,
    KneeLoad,
    LoadCell,
    PidController,
    SlidingModeController,
    TorqueController,
    TorqueLimitedPump,
    TrackingObserver,
    WearerKnee,
)
from kneexo.systems._leaf import NamedLeaf


def law(rod_extension, gain=2.0):
    return gain * rod_extension


REQUIRED = {
    "EncoderCount": (0.1,),
    "FunctionLaw": (LawParameters(function=law, values={"gain": 2.0}),),
    "HeldCommand": (0.002, ("rod_extension",)),
    "LinearLaw": (0.002, ("rod_extension",), 1, 1),
}
"""Arguments of the classes that have no default for them."""

CLASSES = {
    name: value
    for folder in (systems, users_law)
    for name in folder.__all__
    if inspect.isclass(value := getattr(folder, name)) and issubclass(value, NamedLeaf)
}
VARIANTS = {
    "BldcPump, ideal": lambda: BldcPump(ideal=True),
    "TorqueLimitedPump, warm": lambda: TorqueLimitedPump(thermal=ThermalParameters()),
    "FullCylinder, bypass": lambda: FullCylinder(bypass=BypassParameters()),
    "Cuff, slips": lambda: Cuff(CuffParameters(slip_torque_n_m=20.0)),
    "KneeLoad, inertia": lambda: KneeLoad(KneeLoadParameters(inertia_kg_m2=0.1)),
    "LoadCell, noise": lambda: LoadCell(LoadCellParameters(seed=1)),
    "PidController, 1 ms": lambda: PidController(PidParameters(sample_time_s=0.001)),
    "SlidingModeController, continuous": lambda: SlidingModeController(
        SlidingModeParameters(continuous=True)
    ),
    "SlidingModeController, 1 ms": lambda: SlidingModeController(
        SlidingModeParameters(sample_time_s=0.001)
    ),
    "TrackingObserver, 5 ms": lambda: TrackingObserver(sample_time_s=0.005),
    "BackwardDifference, 5 ms": lambda: BackwardDifference(sample_time_s=0.005),
    "TorqueController, assist": lambda: TorqueController(TorqueParameters(mode="assist")),
    "WearerKnee, passive": lambda: WearerKnee(LegParameters(motion="passive")),
    "WearerKnee, active": lambda: WearerKnee(LegParameters(motion="active")),
}
"""Leaf systems whose parameters change their structure."""
RANGES = {
    "FourBarKnee": {"rod_extension": (0.01, 0.14)},
    "Cylinder": {"moving_mass": [(1.0, 9.0), (-90.0, 90.0)], "load_flow": (-1e-5, 1e-5)},
}
"""Ranges of leaf systems that fail far away."""
LEAVES = (*CLASSES, *VARIANTS)
PAGE = Path(__file__).parents[2] / "docs" / "drake_systems.md"
HEAD = """\
| leaf | inputs | outputs | states | Context parameters |
|---|---|---|---|---|
"""
UNITS = {"command_and_state": "rad/s, …", "law_command": "rad/s"}
"""Units of the ports that no docstring has."""
every_leaf = pytest.mark.parametrize("name", LEAVES)


def made(name):
    return VARIANTS[name]() if name in VARIANTS else CLASSES[name](*REQUIRED.get(name, ()))


def units_of(kind):
    """Units of ports by name, from the table in the docstring of a leaf."""
    lines = inspect.getdoc(kind).splitlines()
    rules = [n for n, line in enumerate(lines) if line.startswith("===")]
    heads = [n for n in rules if lines[n + 1].startswith(("input port", "output port"))]
    for first in heads:
        starts = [match.start() for match in re.finditer("=+", lines[first])]
        for line in lines[first + 2 : next(n for n in rules if n > first + 2)]:
            name, _, unit = (line[a:b].strip() for a, b in itertools.pairwise(starts[:4]))
            yield name, unit


def needs(system, wanted):
    """Whether an output, the rates or the update fail while this input alone is open."""
    context = system.CreateDefaultContext()
    for n in range(system.num_input_ports()):
        port = system.get_input_port(n)
        if port is not wanted:
            port.FixValue(context, port.Allocate())
    outputs = [system.get_output_port(n) for n in range(system.num_output_ports())]
    calls = [*(port.Eval for port in outputs), system.EvalTimeDerivatives]
    if system.GetUniquePeriodicDiscreteUpdateAttribute():
        calls.append(system.EvalUniquePeriodicDiscreteUpdate)
    for call in calls:
        try:
            call(context)
        except Exception as error:  # such as the range of a mechanism
            if "is not connected" in str(error):
                return True
    return False


def structure(system):
    """Ports with sizes, the inputs that an output feels at once, states, period, parameters."""
    units = UNITS | dict(itertools.chain(*map(units_of, CLASSES.values())))
    units |= dict(units_of(CLASSES[type(system).__name__.partition("_𝓣")[0].rstrip("_")]))

    def shown(port):
        size = f" ({port.size()})" if port.size() > 1 else ""
        return f"`{port.get_name()}`{size} {units[port.get_name()]}"

    inputs = [system.get_input_port(n) for n in range(system.num_input_ports())]
    outputs = []
    for o in range(system.num_output_ports()):
        felt = [p.get_name() for i, p in enumerate(inputs) if system.HasDirectFeedthrough(i, o)]
        follows = f" ← {', '.join(felt)}" if felt else ""
        outputs.append(shown(system.get_output_port(o)) + follows)
    context = system.CreateDefaultContext()
    groups = range(context.num_discrete_state_groups())
    discrete = sum(context.get_discrete_state(n).size() for n in groups)
    timing = system.GetUniquePeriodicDiscreteUpdateAttribute()
    states = [f"{count} continuous"] if (count := context.num_continuous_states()) else []
    if timing:
        assert timing.offset_sec() == 0.0
        states.append(f"{discrete} discrete, every {timing.period_sec():g} s")
    names = ", ".join(f"`{name}`" for name in system.parameter_names)
    entries = [shown(port) + ("" if needs(system, port) else ", optional") for port in inputs]
    columns = map("<br>".join, (entries, outputs, states))
    return " | ".join([*columns, names])


def table():
    rows = []
    for name in LEAVES:
        kind, _, variant = name.partition(",")
        package, room, module = CLASSES[kind].__module__.split(".")
        source, test = f"../{package}/{room}/{module}.py", f"../tests/{room}/test_{module}.py"
        links = f"[{kind}]({source}){variant and f',{variant}'} ([test]({test}))"
        rows.append(f"| {links} | {structure(made(name))} |")
    return HEAD + "\n".join([*rows, ""])


@every_leaf
def test_a_name_that_is_unknown_and_a_number_that_is_not_finite_are_refused(name):
    system = made(name)
    system.set_name("part")
    context = system.CreateDefaultContext()
    known = system.parameter_names
    with pytest.raises(ValueError, match=r"^part: unknown parameter 'no'; known: ") as caught:
        system.set_parameter(context, "no", 1.0)
    assert str(caught.value).endswith(f"known: {', '.join(known)}")
    for parameter in known:
        before = getattr(system.parameters(context), parameter)
        with pytest.raises(ValueError, match=f"^part: {parameter} = nan: must be finite$"):
            system.set_parameter(context, parameter, math.nan)
        assert getattr(system.parameters(context), parameter) == before


@every_leaf
def test_each_leaf_keeps_the_rules_in_all_scalars(name):
    ranges = next((ranges for known, ranges in RANGES.items() if known in name), {})
    check_leaf(made(name), ranges, scalars=["AutoDiffXd", "Expression"])


def test_the_page_has_the_structure_of_each_leaf():
    assert PAGE.read_text(encoding="utf-8").endswith(f"\n\n{table()}")


if __name__ == "__main__":
    text = PAGE.read_text(encoding="utf-8").partition(HEAD.partition("\n")[0])[0]
    PAGE.write_text(text + table(), encoding="utf-8")
