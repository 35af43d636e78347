"""Python source text for numba from `Equations`: generated functions and the loops that call them.

Parameters stay arguments: what depends on them alone is computed once a run, by ``constants``.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from kneexo.compilation.cache import load_text, text_hash
from kneexo.compilation.equations import Equations
from kneexo.compilation.graph import COMPARISONS, SOURCES, Graph
from kneexo.compilation.unroll import unrolled

Group = tuple[str, list[tuple[str, int]]]
"""Condition under which a group is computed (empty: always), and its targets with their nodes."""

_MARK = "# ----- copied into each generated module from here on -----\n"
INTEGRATORS = ("exact_hold", "rk4", "runge_kutta3")
"""Time integrators of every compiled model, by the name of their loop."""

_HEADER = '''"""Equations, written by kneexo.compilation; do not edit."""

from typing import Any

import math

import numpy as np
from numba import njit

from kneexo.compilation.codegen import linear_parts

choose_slot, FINEST, SLOTS = linear_parts({parts!r})
_options = {{"cache": True, "nogil": True, "error_model": "numpy", "fastmath": {{"contract"}}}}
jit = njit(**_options)  # called from Python
_options |= {{"no_cpython_wrapper": True, "no_cfunc_wrapper": True}}
inner = njit(**_options)
inline = njit(**_options, forceinline=True)

'''

_CALLS = {
    "log": "math.log",
    "exp": "math.exp",
    "sqrt": "math.sqrt",
    "sin": "math.sin",
    "cos": "math.cos",
    "tan": "math.tan",
    "asin": "math.asin",
    "acos": "math.acos",
    "atan": "math.atan",
    "atan2": "math.atan2",
    "sinh": "math.sinh",
    "cosh": "math.cosh",
    "tanh": "math.tanh",
    "abs": "abs",
    "floor": "np.floor",
    "ceil": "np.ceil",
}
_ARRAYS = {"parameter": "p", "state": "x", "held": "d", "input": "u"}
_DECORATORS = {"derivatives": '@unrolled("x f")\n', "instant": "@inline\n"}  # called all the time
_ONCE = ("constants", "initialize")  # called once a run: compiling them would take longer
_LONGEST = 300  # characters of an expression before it gets a name


class _Writer:
    """Prints the functions of one module; ``hoisted`` are the nodes that ``constants`` computes."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self.hoisted: dict[int, int] = {}

    def hoist(self, roots: Iterable[int]) -> None:
        """Find what depends on parameters alone and is used by what does not, or is a root."""
        roots = list(roots)
        reached = self.graph.reachable(roots)
        used = set(roots)
        for node in reached:
            if not self.graph.is_fixed(node):
                used.update(self.graph.arguments(node))
        fixed = sorted(n for n in used if self.graph.is_fixed(n) and self.graph.value(n) is None)
        self.hoisted = {node: number for number, node in enumerate(fixed)}

    def constants(self) -> str:
        """The function that computes the hoisted nodes from the parameters."""
        hoisted, self.hoisted = self.hoisted, {}
        targets = [(f"c[{number}]", node) for node, number in hoisted.items()]
        text = self.function("constants", ("p", "c"), [("", targets)])
        self.hoisted = hoisted
        return text

    def function(self, name: str, arguments: Sequence[str], groups: Sequence[Group]) -> str:
        """A function that computes groups of targets; what two groups share comes first."""
        needed: dict[int, set[int]] = {}
        uses: Counter[int] = Counter()
        for number, (condition, targets) in enumerate(groups):
            for node in self._reachable([node for _, node in targets]):
                # Group −1 stands for "always".
                needed.setdefault(node, set()).add(number if condition else -1)
        for node in needed:
            if node in self.hoisted:
                continue
            repeats = 2 if self.graph.nodes[node][0] in {"min", "max"} else 1
            for argument in self.graph.arguments(node):
                uses[argument] += repeats
        for _, targets in groups:
            uses.update(node for _, node in targets)
        shared = {n for n, users in needed.items() if len(users) > 1 or -1 in users}
        names: dict[int, str] = {}
        lines = self._assignments(sorted(shared), uses, names, "    ")
        for number, (condition, targets) in enumerate(groups):
            own = sorted(n for n, users in needed.items() if n not in shared and number in users)
            indent = "        " if condition else "    "
            body = self._assignments(own, uses, names, indent)
            body += [f"{indent}{target} = {self._text(node, names)}" for target, node in targets]
            if condition and body:
                lines.append(f"    if {condition}:")
            lines += body
        if name == "derivatives":
            lines.append("    return f")
        text = (
            f"def {name}({', '.join(arguments)}):\n" + "\n".join(lines or ["    pass"]) + "\n\n\n"
        )
        if name in _ONCE:  # numpy's functions return nan where those of math raise
            return re.sub(r"math\.a(sin|cos|tan)", r"np.arc\1", text).replace("math.", "np.")
        return _DECORATORS.get(name, "@inner\n") + text

    def _reachable(self, roots: Sequence[int]) -> list[int]:
        found: set[int] = set()
        pending = list(roots)
        while pending:
            node = pending.pop()
            if node not in found:
                found.add(node)
                if node not in self.hoisted:
                    pending.extend(self.graph.arguments(node))
        return sorted(found)

    def _assignments(
        self, nodes: Sequence[int], uses: Counter[int], names: dict[int, str], indent: str
    ) -> list[str]:
        lines = []
        for node in nodes:
            if self.graph.nodes[node][0] in SOURCES or node in self.hoisted:
                continue
            text = self._text(node, names)
            if uses[node] > 1 or len(text) > _LONGEST:
                names[node] = f"v{node}"
                lines.append(f"{indent}v{node} = {text}")
            else:
                names[node] = text
        return lines

    def _text(self, node: int, names: dict[int, str]) -> str:
        if node in self.hoisted:
            return f"c[{self.hoisted[node]}]"
        if node in names:
            return names[node]
        kind, *_ = self.graph.nodes[node]
        if kind == "constant":
            return _literal(float(self.graph.value(node) or 0.0))
        if kind == "time":
            return "t"
        if kind in SOURCES:
            return f"{_ARRAYS[str(kind)]}[{self.graph.nodes[node][1]}]"
        texts = [self._text(argument, names) for argument in self.graph.arguments(node)]
        return _operation(str(kind), texts)


def _literal(value: float) -> str:
    if value != value:
        return "math.nan"
    if abs(value) == float("inf"):
        return "math.inf" if value > 0 else "-math.inf"
    return repr(value) if value >= 0 else f"({value!r})"


def _operation(kind: str, texts: Sequence[str]) -> str:
    joined = {"add": " + ", "multiply": " * ", "divide": " / ", "power": " ** "}
    joined |= {name: f" {sign} " for name, sign in COMPARISONS.items()}
    joined |= {"and": " and ", "or": " or "}
    if kind in joined:
        return f"({joined[kind].join(texts)})"
    if kind == "not":
        return f"(not {texts[0]})"
    if kind == "where":
        return f"({texts[1]} if {texts[0]} else {texts[2]})"
    if kind in {"min", "max"}:  # as std::min and std::max
        first, second = texts
        sign = f"{second} < {first}" if kind == "min" else f"{first} < {second}"
        return f"({second} if {sign} else {first})"
    return f"{_CALLS[kind]}({', '.join(texts)})"


def _linear_parts() -> str:
    return Path(__file__).with_name("linear_parts.py").read_text(encoding="utf-8")


def linear_parts(expected: str) -> tuple[Any, int, int]:
    """What generated modules share, of the text with the hash ``expected``; from the cache."""
    text = _linear_parts()
    assert text_hash(text) == expected, "the model was generated by another version"
    module = load_text(text)
    return module.choose_slot, module.FINEST, module.SLOTS


def _assign(target: str, nodes: Iterable[int]) -> list[tuple[str, int]]:
    return [(f"{target}[{i}]", node) for i, node in enumerate(nodes)]


def source_text(equations: Equations) -> str:
    """The text of a module that runs ``equations``; equal equations give equal text."""
    graph = equations.graph
    derivatives = graph.with_reciprocals(equations.derivatives)
    gradients = graph.gradients(derivatives)
    size = len(equations.states)
    elements = [row.get(column, graph.zero) for row in gradients for column in range(size)]
    jacobian = _assign("j", graph.with_reciprocals(elements))
    groups: list[Group] = [("", _assign("m", (limit.margin for limit in equations.limits)))]
    for number, update in enumerate(equations.updates):
        groups.append((f"fires[{number}]", [(f"after[{i}]", node) for i, node in update.values]))
    first = 0
    layout = {}
    for number, (port, nodes) in enumerate(equations.outputs.items()):
        layout[port] = (first, len(nodes))
        targets = [(f"y[{first + i}]", node) for i, node in enumerate(nodes)]
        groups.append((f"wanted[{number}]", targets))
        first += len(nodes)
    if len(equations.updates) == 1:  # then nearly every instant updates: share freely
        groups[1] = ("", groups[1][1])
    faster = iter(graph.with_reciprocals(node for _, targets in groups for _, node in targets))
    groups = [(when, [(target, next(faster)) for target, _ in targets]) for when, targets in groups]
    initial = _assign("after", equations.initial_held)

    writer = _Writer(graph)
    roots = derivatives + equations.initial_held + [node for _, node in jacobian]
    roots += [node for _, targets in groups for _, node in targets]
    writer.hoist(roots)
    common = ("t", "x", "d", "u", "c")
    functions = [
        writer.constants(),
        writer.function("derivatives", common, [("", _assign("f", derivatives))]),
        writer.function("jacobian", (*common, "j"), [("", jacobian)]),
        writer.function("initialize", (*common, "after"), [("", initial)]),
        writer.function("instant", (*common, "fires", "wanted", "after", "y", "m"), groups),
    ]
    facts = {
        "PARAMETERS": tuple(equations.parameters),
        "STATES": tuple(equations.states),
        "HELD": tuple(equations.held),
        "INPUTS": equations.inputs,
        "OUTPUTS": layout,
        "FEEDTHROUGH": tuple(
            port
            for port, nodes in equations.outputs.items()
            if any("input" in graph.depends[node] for node in nodes)
        ),
        "PERIODS": tuple((update.period_s, update.offset_s) for update in equations.updates),
        "LIMITS": tuple(limit.system for limit in equations.limits),
        "CONSTANT_COUNT": len(writer.hoisted),
        "STATE_COUNT": len(equations.states),
        "HELD_COUNT": len(equations.held),
        "INPUT_COUNT": sum(equations.inputs.values()),
        "OUTPUT_COUNT": first,
        "LIMIT_COUNT": len(equations.limits),
    }
    text = _HEADER.format(parts=text_hash(_linear_parts()))
    text += "".join(f"{key} = {value!r}\n" for key, value in facts.items()) + "\n\n"
    return text + unrolled("".join(functions) + _loops(), len(equations.states))


def _loops() -> str:
    """The loops, with one copy of ``run`` for each integrator."""
    _, text = Path(__file__).with_name("loops.py").read_text(encoding="utf-8").split(_MARK)
    steps, run = text.split("@jit\ndef run(")
    run, rest = run.split("@jit\n", maxsplit=1)
    runs = (f"run_{name}(" + run.replace(" advance(", f" advance_{name}(") for name in INTEGRATORS)
    return steps + "".join(f"@jit\ndef {text}" for text in runs) + "@jit\n" + rest
