"""Control laws as source text from a grammar: a seed gives the same files on every machine.

The seeds 2 k and 2 k + 1 give two laws with the same text, except for one number in the line
``VALUES``. The text builds objects that hold these values: containers, closures, classes, an
imported module. All laws are stable, because a proportional term dominates. Each jump of a command
is at least 1 rad/s.
"""

from __future__ import annotations

import importlib.util
import os
import random
import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from textwrap import indent
from typing import Any

PRESETS = ("paper", "bench", "leg")
_GROUPS = (
    ("equations",),
    ("equations", "equations"),
    ("equations", "equations", "equations"),
    ("truthiness",),
    ("equations", "truthiness"),
    ("Python",),
    ("Python", "Python", "equations"),
    ("Python", "truthiness"),
)
"""Groups of the terms of one law; each tuple is equally frequent."""
MODULES = ("held", "held_below")
"""Names of the modules that some laws import from their folder."""

HEADER = """\
import math
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache, partial, wraps
from types import SimpleNamespace

import numpy as np
from pydrake.math import max as drake_max, min as drake_min
from pydrake.symbolic import if_then_else


@dataclass(frozen=True)
class Gains:
    gain: float

    def times(self, number):
        return self.gain * number


def multiplied(factor):
    def by_factor(function):
        @wraps(function)
        def wrapper(*args, **kwargs):
            result = function(*args, **kwargs)
            if isinstance(result, tuple):
                return factor * result[0], result[1]
            return factor * result

        return wrapper

    return by_factor


def recursive(number, depth):
    return number if depth == 0 else 0.5 * recursive(number, depth - 1)
"""

HOLDERS = {
    "float": ("{v}", "{h}"),
    "list": ("[{v}, 1.0]", "{h}[0]"),
    "dict": ("{'gain': {v}}", "{h}['gain']"),
    "Fraction": ("Fraction({v})", "float({h})"),
    "complex": ("complex({v}, 1.0)", "{h}.real"),
    "method": ("Gains({v}).times", "{h}(1.0)"),
    "namespace": ("SimpleNamespace(gain={v})", "{h}.gain"),
    "partial": ("partial(pow, {v})", "{h}(1)"),
    "lru_cache": ("lru_cache(lambda value={v}: value)", "{h}()"),
    "NumPy array": ("np.array([1.0, {v}])", "{h}[1]"),
    "NumPy array of float32": ("np.array([{v}], dtype=np.float32)", "float({h}[0])"),
    "np.float32": ("np.float32({v})", "{h}"),
    "np.int16": ("np.int16({v})", "{h}"),
    "polynomial": ("np.poly1d([{v}])", "float({h}(0.0))"),
    "class attribute": ("type('Held', (), {'gain': [{v}]})", "{h}.gain[0]"),
    "property": (
        "type('Held', (), {'gain': property(lambda self, value={v}: value)})()",
        "{h}.gain",
    ),
}
"""Kinds of objects that hold a number: how to make one from a value, and how to read the number."""

# {a}, {b}: rad/s; {edge}: m; {time}: s, between two samples; {flag}: 0 or 1, or the time;
# {old}, {new}: an element of the state and of the next state.
TERMS = {
    "equations": {
        "feedforward": "term = {a} * 40.0 * wanted",
        "numpy.dot": "term = {a} * np.dot([0.0, 20.0, 1.0, 0.01], reference)",
        "numpy.sum": "term = {a} * np.sum(0.1 * reference)",
        "matrix product": "term = reference @ np.array([0.0, 9.0 * {a}, 2.0, 0.02])",
        "float32 array": "term = {a} * (reference @ np.array([0.1, 9.3, 0.7, 0], np.float32))",
        "polynomial": "term = 1e3 * np.polyval([{a}, {b}, 0.0], error)",
        "numpy functions": "term = {a} * np.tanh(1e3 * error) + {b} * np.sqrt(1e-6 + error**2)",
        "comprehension": "term = sum(weight * {a} for weight in [x * error for x in (9, 90)])",
        "recursion": "term = {a} * recursive(1e3 * error, 3)",
        "try without error": "try:\n    term = {a} * 9.0 * error\nexcept TypeError:\n    term = 9",
        "untaken division": "term = {a} * error if True else 1.0 / 0.0",
        "sine of time": "term = {a} * np.sin(50.0 * time_s)",
        "ramp": "term = {a} * drake_min(1.0, 30.0 * time_s)",
        "dead zone": "term = 1e4 * (drake_max(error, {edge}) + drake_min(error, 0.0))",
        "if_then_else": "term = if_then_else(error > {edge}, {a}, -{b})",
        "if_then_else of time": "term = if_then_else(time_s > {time}, {a} * wanted, 1e3 * error)",
        "if_then_else of state": "term = if_then_else({old} > 3.0, {a}, 0.0)\n{new} = {old} + 1.0",
        "absolute value": "term = {a} * abs(1e3 * error) + {b} * np.abs(wanted)",
        "integral": "term = {old}\n{new} = {old} + {a} * error",
        "leaky integral": "term = {old}\n{new} = 0.9 * {old} + {a} * 10.0 * error",
        "bounded integral": (
            "term = {old}\n{new} = drake_max(-{b}, drake_min({b}, {old} + {a} * 99.0 * error))"
        ),
        "filter": "{new} = {old} + 0.2 * (1e3 * error - {old})\nterm = {a} * {new}",
        "difference": "term = {a} * 1e3 * (error - {old})\n{new} = error",
    },
    "truthiness": {
        "if": "term = 0.0\nif {flag}:\n    term = {a}",
        "conditional": "term = {a} if {flag} else -{b}",
        "and": "term = {flag} and {a}",
        "or": "term = {a} * ({flag} or 0.5)",
        "not": "term = {a} * (not {flag})",
        "if not": "term = -{b}\nif not {flag}:\n    term = {a}",
        "while": "term = 0.0\nwhile {flag}:\n    term = {a}\n    break",
        "any": "term = {a} if any([{flag}, 0.0]) else -{b}",
        "all": "term = {a} if all([{flag}, 1.0]) else -{b}",
        "bool": "term = {a} * bool({flag})",
        "filter function": "term = {a} * len(list(filter(None, [{flag}, 1.0])))",
        "numpy.any": "term = {a} if np.any([{flag}]) else -{b}",
        "numpy.where": "term = {a} * float(np.where([{flag}], 1.0, 0.0)[0])",
        "numpy.logical_not": "term = {a} if np.logical_not([{flag}])[0] else -{b}",
        "numpy.count_nonzero": "term = {a} * int(np.count_nonzero([{flag}, 1.0]))",
        "lambda": "term = (lambda x: {a} if x else -{b})({flag})",
        "match": "match bool({flag}):\n    case True:\n        term = {a}\n    case _:\n"
        "        term = -{b}",
    },
    "Python": {
        "if": "if error > {edge}:\n    term = {a}\nelse:\n    term = -{b}",
        "elif": "if wanted > 0.02:\n    term = {a}\nelif error < {edge}:\n    term = -{b}\nelse:\n"
        "    term = 0.0",
        "if of time": "term = 0.0\nif time_s > {time}:\n    term = {a}",
        "minimum and maximum": "term = min({a}, max(-{b}, 2e4 * error))",
        "clip": "term = float(np.clip(2e4 * error, -{a}, {b}))",
        "sign": "term = {a} * np.sign(error - {edge})",
        "numpy.where of error": "term = np.where(error > {edge}, {a}, -{b})",
        "copysign": "term = math.copysign({a}, error - {edge})",
        "math functions": "term = {a} * math.tanh(1e3 * error) + {b} * math.sin(9.0 * wanted)",
        "floor": "term = 2.0 * math.floor(1e4 * error)",
        "round": "term = 2.0 * round(1e4 * float(error))",
        "interpolation": "term = np.interp(error, [-1e-3, 0.0, 1e-3], [-{a}, 0.0, {b}])",
        "index": "term = (-{b}, 0.0, {a})[int(error > 0) + int(error > {edge})]",
        "dictionary": "term = {True: {a}, False: -{b}}[bool(error > {edge})]",
        "sorted": "term = 1e3 * sorted([error, {edge}, 0.0], key=abs)[1]",
        "text": "term = {a} if f'{float(error):+.4f}'.startswith('-') else -{b}",
        "text of state": "term = {a} if str({old}) == '1.0' else -{b}\n{new} = 1.0 - {old}",
        "type": "term = {a} if isinstance(error, float) else -{b}",
        "attribute": "term = {a} if hasattr(error, 'Evaluate') else -{b}",
        "swallowed error": "try:\n    term = {a} if {old} > 12.0 else 0.0\nexcept Exception:\n"
        "    term = 0.0\n{new} = {old} + 1.0",
        "two ways by type": "term = 0.0\nif isinstance(time_s, float) and time_s < {time}:\n"
        "    term = {a}",
        "hysteresis": "{new} = 1.0 if error > {edge} else 0.0 if error < -{edge} else {old}\n"
        "term = {a} * {new}",
        "anti-windup": "{new} = {old}\nif abs({old} + {a} * 99.0 * error) < {b}:\n"
        "    {new} = {old} + {a} * 99.0 * error\nterm = {old}",
        "counter": "{new} = ({old} + 1.0) % 5.0\nterm = {a} * {old}",
        "rate limit": "{new} = {old} + min(max(3e4 * error - {old}, -{b}), {b})\nterm = {new}",
        "while": "n, term = {old}, 0.0\nwhile n > 0:\n    n, term = n - 1.0, term + {a}\n"
        "{new} = ({old} + 1.0) % 3.0",
    },
}
"""Lines that set the variable ``term``, a part of the command in rad/s, by group and name."""

INPUTS = {
    "rod_extension, rod_reference": (
        "reference = rod_reference\n"
        "error, wanted = rod_reference[0] - rod_extension, rod_reference[1]"
    ),
    "rod_reference, estimated_state": (
        "reference = rod_reference\n"
        "error, wanted = rod_reference[0] - estimated_state[0], estimated_state[1]"
    ),
    "knee_angle, knee_reference": (
        "reference = -0.04 * knee_reference\n"
        "error, wanted = 0.04 * (knee_angle - knee_reference[0]), -0.04 * knee_reference[1]"
    ),
    "rod_extension, rod_reference, estimated_state, knee_angle, knee_reference": (
        "reference = rod_reference\n"
        "error, wanted = rod_reference[0] - rod_extension, -0.04 * knee_reference[1]\n"
        "error = error + 1e-3 * (knee_angle - knee_reference[0]) + 1e-4 * estimated_state[1]"
    ),
}
"""For each list of arguments, the lines that compute ``reference``, ``error`` and ``wanted``."""


@dataclass(frozen=True)
class GeneratedLaw:
    """A law as source text."""

    seed: int
    files: dict[str, str]
    """Text of each file by its name; ``law.py`` defines ``law``."""
    inputs: str
    """Names of the measurements and references that the law reads."""
    features: tuple[str, ...]
    """What the law is made of: its form, its holders and its terms."""

    @property
    def preset(self) -> str:
        """Name of the preset with which the law runs."""
        return PRESETS[self.seed // 2 % len(PRESETS)]

    @property
    def in_file(self) -> bool:
        """True if kneexo gets the name of the file, False if it gets the function itself."""
        return self.seed // 6 % 2 == 0

    def write(self, folder: Path) -> Path:
        """Write the files into a folder, as a user who edits them; return the path of ``law.py``.

        Modules that another law imported from the folder are forgotten. Each file is newer than the
        file before, so that Python does not run the code of that file.
        """
        for name in MODULES:
            sys.modules.pop(name, None)
            (folder / f"{name}.py").unlink(missing_ok=True)
        for name, text in self.files.items():
            (folder / name).write_text(text, encoding="utf-8")
            os.utime(folder / name, (next(_seconds),) * 2)
        return folder / "law.py"

    def function(self, folder: Path) -> Callable[..., Any]:
        """Write the files and import the law by Python alone."""
        path = self.write(folder)
        spec = importlib.util.spec_from_file_location("generated_law", path)
        module = importlib.util.module_from_spec(spec)
        sys.path.insert(0, str(folder))
        try:
            spec.loader.exec_module(module)
        finally:
            sys.path.remove(str(folder))
        return module.law


_seconds = count(1_000_000_000)


def generated_law(seed: int, *, form: str | None = None, terms: Sequence[str] = ()) -> GeneratedLaw:
    """Return the law of a seed. ``form`` and ``terms`` replace what the seed would choose.

    A term is a group of `TERMS`, or a group and a name such as ``truthiness: if``.
    """
    return _Writer(seed).law(form, terms)


class _Writer:
    """Writes the text of one law."""

    def __init__(self, seed: int) -> None:
        self._seed = seed
        self._rng = random.Random(f"text {seed // 2}")  # a text: the same in every Python
        self._values: list[float] = []
        self._names: list[str] = []
        self._made: list[str] = []
        self._features: list[str] = []
        self._state: list[float] = []
        self._next: list[str] = []
        self._gains: list[str] = []

    def law(self, form: str | None, terms: Sequence[str]) -> GeneratedLaw:
        """Return the law: first the body of its function, then what surrounds the body."""
        rng = self._rng
        inputs = rng.choice(list(INPUTS))
        body = [INPUTS[inputs], f"command = {rng.randrange(20, 50)}e3 * error"]
        for factor in rng.sample(
            ("2e3 * error", "4e3 * error", "30.0 * wanted"), rng.randrange(1, 3)
        ):
            body.append(f"command = command + {factor} * {self._held()}")
        terms = terms or rng.choice(_GROUPS)
        for term in terms:
            body += [self._term(*term.split(": ")), "command = command + term"]
        limits = ["drake_min(drake_max(command, -{l}), {l})"]
        if "Python" in terms and not any("if_then_else" in one for one in self._features):
            limits.append("min(max(command, -{l}), {l})")
        if rng.random() < 0.3:
            limit = rng.choice(limits).replace("{l}", f"{rng.randrange(60, 400)}.0")
            body.append(f"command = {limit}")
        arguments = inputs
        if any("time_s" in line for line in body):
            arguments += ", time_s"
        if self._state:
            arguments += f", state={tuple(self._state)}"
            body.append(
                f"return command, {rng.choice(('[{}]', '({},)')).format(self._next_text())}"
            )
        else:
            body.append("return command")
        arguments = ", ".join([arguments, *self._gains])
        form = form or rng.choice(list(_FORMS))
        text, below = _FORMS[form](self, arguments, body)
        changed = rng.randrange(len(self._values))
        self._values[changed] += self._seed % 2
        values = f"VALUES = {tuple(self._values)}\n"
        made = "".join(f"HELD{n} = {make}\n" for n, make in enumerate(self._made))
        files = {"law.py": "\n".join((HEADER, values + made, text))}
        if below:
            files = {
                "held.py": "import held_below\n\n\ndef held(n):\n    return held_below.HELD[n]\n",
                "held_below.py": f"{HEADER}\n{values}{made}HELD = [{', '.join(self._names)}]\n",
                "law.py": "\n".join((HEADER, text)),
            }
        return GeneratedLaw(self._seed, files, inputs, (form, *self._features))

    def _next_text(self) -> str:
        return ", ".join(self._next)

    def _value(self) -> str:
        """Return the text of a new value, from 1 to 9."""
        self._values.append(self._rng.randrange(1, 9) + self._rng.choice((0, 0.25, 0.5)))
        return f"VALUES[{len(self._values) - 1}]"

    def _held(self) -> str:
        """Return the text that reads a value from a new object."""
        kind = self._rng.choice(list(HOLDERS))
        self._features.append(f"holder: {kind}")
        make, read = HOLDERS[kind]
        self._made.append(make.replace("{v}", self._value()))
        name = f"HELD{len(self._made) - 1}"
        self._names.append(name)
        return read.replace("{h}", name)

    def _term(self, group: str, name: str = "") -> str:
        """Return the lines of a term, by default of one that the rest of the state has room for."""
        rng = self._rng
        room = len(self._state) < 3
        fit = [n for n, text in TERMS[group].items() if room or "{old}" not in text]
        name = name or rng.choice(fit)
        self._features.append(f"{group}: {name}")
        text = TERMS[group][name]
        if "{old}" in text:
            old, new = self._new_state(0.0)
            text = text.replace("{old}", old).replace("{new}", new)
        while "{flag}" in text:
            text = text.replace("{flag}", self._flag(), 1)
        for mark, low, high, form in (
            ("{a}", 8, 25, "{}.0"),
            ("{b}", 4, 20, "{}.0"),
            ("{edge}", 1, 30, "{}e-5"),
            ("{time}", 5, 40, "0.0{:02}1"),
        ):
            while mark in text:
                text = text.replace(mark, form.format(rng.randrange(low, high)), 1)
        return text

    def _new_state(self, start: float) -> tuple[str, str]:
        """Return the texts of a new element of the state and of its next value."""
        n = len(self._state)
        self._state.append(start)
        self._next.append(f"next{n}")
        return f"state[{n}]", f"next{n}"

    def _flag(self) -> str:
        """Return the text of a number that is true at some samples, or always, or never."""
        rng = self._rng
        kinds = ["time_s", "gain"] + ["alternating", "constant"] * (len(self._state) < 3)
        kind = rng.choice(kinds)
        if kind == "time_s":
            return "time_s"
        start = float(rng.randrange(2))
        if kind == "gain":
            self._gains.append(f"use{len(self._gains)}={start}")
            return self._gains[-1].partition("=")[0]
        old, _ = self._new_state(start)
        self._next[-1] = f"1.0 - {old}" if kind == "alternating" else old
        return old

    # ------------------------------------------------------------------------ forms of laws

    def _function(self, arguments: str, body: list[str], name: str = "law") -> str:
        return f"def {name}({arguments}):\n" + indent("\n".join(body), "    ") + "\n"

    def _plain(self, arguments: str, body: list[str]) -> tuple[str, bool]:
        gain = f"{arguments}, gain={self._value()}"
        body = [*body[:-1], "command = command + 3e3 * gain * error", body[-1]]
        return self._function(gain, body), False

    def _closure(self, arguments: str, body: list[str]) -> tuple[str, bool]:
        names = ", ".join(self._names)
        inner = self._function(arguments, body) + "\nreturn law\n"
        return f"def make({names}):\n{indent(inner, '    ')}\nlaw = make({names})\n", False

    def _decorated(self, arguments: str, body: list[str]) -> tuple[str, bool]:
        return (
            f"@multiplied(1.0 + 0.02 * {self._value()})\n{self._function(arguments, body)}",
            False,
        )

    def _partial(self, arguments: str, body: list[str]) -> tuple[str, bool]:
        names = ", ".join(self._names)
        function = self._function(f"{names}, {arguments}", body, "_law")
        return f"{function}\nlaw = partial(_law, {names})\n", False

    def _object(
        self, arguments: str, body: list[str], *, method: str = "__call__", change: str = ""
    ) -> tuple[str, bool]:
        """Return a class; ``change`` are lines of the method that change ``self.calls``."""
        first = ""
        if change:
            first = "self.calls = 0\n"
            hidden = [change, "command = command + 9.0 * (self.calls % 3)"]
            body = [*body[:-1], *hidden, body[-1]]
        lines = re.sub(r"\b(HELD\d)\b", r"self.\1", "\n".join(body))
        init = first + "\n".join(f"self.{name} = {name}" for name in self._names)
        names = ", ".join(self._names)
        text = self._function(f"self, {names}", [init], "__init__")
        text += "\n" + self._function(f"self, {arguments}", [lines], method)
        attribute = "" if method == "__call__" else f".{method}"
        return f"class Law:\n{indent(text, '    ')}\nlaw = Law({names}){attribute}\n", False

    def _method(self, arguments: str, body: list[str]) -> tuple[str, bool]:
        return self._object(arguments, body, method="command")

    def _hidden_state(self, arguments: str, body: list[str]) -> tuple[str, bool]:
        return self._object(arguments, body, change="self.calls += 1")

    def _late_state(self, arguments: str, body: list[str]) -> tuple[str, bool]:
        change = (
            "try:\n    if 0.0 < error < 3e-4:\n        self.calls += 1\n"
            "except RuntimeError:\n    pass"
        )
        return self._object(arguments, body, change=change)

    def _imported(self, arguments: str, body: list[str]) -> tuple[str, bool]:
        lines = re.sub(r"\bHELD(\d)\b", r"held.held(\1)", "\n".join(body))
        return f"import held\n\n{self._function(arguments, [lines])}", True


_FORMS = {
    "function": _Writer._plain,
    "closure": _Writer._closure,
    "decorated function": _Writer._decorated,
    "partial": _Writer._partial,
    "object": _Writer._object,
    "bound method": _Writer._method,
    "object with hidden state": _Writer._hidden_state,
    "object with late hidden state": _Writer._late_state,
    "imported modules": _Writer._imported,
}
