"""Writes names, units and values of a scenario's parameters in words, for figures and reports."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from pydantic.fields import FieldInfo

from kneexo.parameters.fields.fields import unit_of, words_of
from kneexo.parameters.fields.names import Place
from kneexo.parameters.scenario import Scenario

_UNITS = frozenset(
    ("deg", "hz", "kg", "m", "m2", "m3", "mm", "n", "pa", "per", "rad", "rpm", "s", "s2", "s3", "w")
)
"""The units at the ends of names."""
_NEEDS_PART = frozenset(("offset", "stiffness"))
"""Words that say nothing without the part of the scenario."""

_GREEK = {"lambda": "λ", "phi": "Φ", "eta": "η"}


def labels(paths: Iterable[str]) -> dict[str, str]:
    """Return a dictionary from dotted path to words with a unit, such as ``mass (kg)``.

    If several values have the same words, or if the word says nothing alone, the text begins with
    the part of the scenario, such as ``cylinder mass (kg)`` and ``cuff stiffness (N·m/rad)``.
    """
    known, texts = list(paths), {}
    for path in known:
        count, unit = 2 if _words(path) in _NEEDS_PART else 1, _unit(path)
        while count <= path.count(".") and any(
            _last_words(other, count) == _last_words(path, count)
            for other in known
            if other != path
        ):
            count += 1
        name = _last_words(path, count)
        texts[path] = f"{name} ({unit})" if unit else name
    return texts


def value_text(path: str, value: Any) -> str:
    """Return the value at a dotted path as text. A number has four digits and no unit.

    A value that is true or false in a scenario file is ``on`` or ``off``. The text of a part also
    has the changed values of this part, with their units.
    """
    words = words_of(_field(path))
    if isinstance(value, Mapping):
        changes = ", ".join(_with_unit(f"{path}.{key}", item) for key, item in value.items())
        state = "on" if True in words else ""
        return ", ".join(filter(None, (state, changes)))
    if isinstance(value, bool) or (value is None and False in words):
        return "on" if value else "off"
    if isinstance(value, int | float):
        text = f"{value:.4g}"
        plain = f"{float(text):.0f}" if "e+" in text and abs(value) < 1e6 else text
        return plain.replace("e+0", "e").replace("-", "−")
    return str(value)


def _with_unit(path: str, value: Any) -> str:
    """Return words, value and unit, such as ``coulomb friction 40 N``."""
    texts = (_words(path), value_text(path, value), _unit(path))
    return " ".join(filter(None, texts))


def _words(path: str) -> str:
    """Return the last name of a dotted path as words: ``plant.load.leg_mass_kg`` is "leg mass"."""
    words = path.rpartition(".")[2].split("_")
    while len(words) > 1 and (words[-1] in _UNITS or words[-1] == _unit(path)):
        words.pop()
    return " ".join(_GREEK.get(word, word) for word in words)


def _last_words(path: str, count: int) -> str:
    """Return the words of the last ``count`` names of a dotted path."""
    parts = path.split(".")
    ends = range(max(1, len(parts) - count + 1), len(parts) + 1)
    return " ".join(_words(".".join(parts[:end])) for end in ends)


def _unit(path: str) -> str:
    field = _field(path)
    unit = unit_of(field) if field else ""
    return "" if unit == "1" else unit


def _field(path: str) -> FieldInfo | None:
    place = Place((Scenario,))
    for name in path.split("."):
        place = place.below(name)
    return place.field
