"""Every default, unit, bound and slider against `defaults.txt`: a wrong one changes the file.

After a change that is meant, ``python tests/test_defaults.py`` writes the file.
"""

from __future__ import annotations

import typing
from pathlib import Path

from pydantic.fields import FieldInfo

from kneexo import parameters
from kneexo.page.sliders import SLIDERS, Slider
from kneexo.page.thrown_faults import THROWN_FAULTS
from kneexo.parameters import Scenario
from kneexo.parameters.fields.fields import models_of, more_models_of, unit_of
from kneexo.parameters.fields.quantity import Parameters
from kneexo.studies import paper
from kneexo.studies.catalogue import STUDIES

SETS = ("UNCERTAINTY", "WEARER_UNCERTAINTY")
SNAPSHOT = Path(__file__).with_name("defaults.txt")


def classes_of(model: type[Parameters]) -> typing.Iterator[type[Parameters]]:
    """The class and those that its fields may hold."""
    yield model
    for field in model.model_fields.values():
        for held in (*models_of(field), *more_models_of(field)):
            yield from classes_of(held)


def plain(value: typing.Any) -> str:
    """A value as text: floats to 12 digits, of parameter objects what differs from the defaults."""
    if isinstance(value, float):
        return f"{value:.12g}"
    if isinstance(value, dict):
        return f"{{{', '.join(f'{key}: {plain(item)}' for key, item in value.items())}}}"
    if isinstance(value, tuple):
        return f"({', '.join(map(plain, value))})"
    if isinstance(value, Parameters):
        fields = type(value).model_fields.items()
        changes = [(n, getattr(value, n)) for n, f in fields if getattr(value, n) != f.default]
        shown = ", ".join(f"{name}={plain(item)}" for name, item in changes if item != "")
        return f"{type(value).__name__}({shown})"
    return repr(value)


def field_line(name: str, field: FieldInfo) -> str:
    """Default, unit and bounds of a field."""
    names = ("ge", "gt", "le", "min_length", "max_length")
    bounds = [
        f"{name} {plain(getattr(bound, name))}"
        for name in names
        for bound in field.metadata
        if getattr(bound, name, None) is not None
    ]
    if typing.get_origin(field.annotation) is typing.Literal:
        bounds.append(f"one of {plain(typing.get_args(field.annotation))}")
    default = "required" if field.is_required() else plain(field.default)
    return " | ".join([name, default, unit_of(field), ", ".join(bounds)]).rstrip()


def slider_line(name: str, slider: Slider) -> str:
    """Label, ends, scale, unit and factor on the page, and the modes of a slider."""
    ends = f"{plain(slider.low)} … {plain(slider.high)} {slider.scale}"
    shown, choices = plain(slider.shown or ()), plain(slider.choices)
    return f"slider {name} | {slider.label} | {ends} | {shown} | {choices}"


def snapshot() -> str:
    """A line for each field, constant, setup of a study, slider and fault that a page throws."""
    roots = [Scenario, *(study.computation().settings for study in STUDIES.values())]
    lines = ["field | default | unit | bounds"]
    for model in dict.fromkeys(c for root in roots for c in classes_of(root)):
        lines += [
            field_line(f"{model.__name__}.{name}", field)
            for name, field in model.model_fields.items()
        ]
    for module in (parameters, paper):
        for name, value in vars(module).items():
            if name.isupper() and name[0] != "_" and name not in ("LINKAGES", *SETS):
                lines.append(f"{name} | {plain(value)}")
    for set_name in SETS:
        for path, value in getattr(parameters, set_name).values.items():
            lines.append(f"{set_name} {path} | {plain(value.model_copy(update={'source': ''}))}")
    lines += [
        f"kneexo {study.command} | {plain(study.computation().scenario)}"
        for study in STUDIES.values()
        if study.takes_scenario
    ]
    for kind, sliders in SLIDERS.items():
        lines += [slider_line(f"{kind.__name__}.{name}", item) for name, item in sliders.items()]
    for name, fault in THROWN_FAULTS.items():
        parts = (fault.label, fault.place, fault.kind, plain(fault.size), fault.unit)
        lines.append(" | ".join((f"thrown {name}", *parts)))
        if fault.slider is not None:
            lines.append(slider_line(f"thrown {name}", fault.slider))
    return "\n".join(lines) + "\n"


def test_every_default_unit_and_bound_is_that_of_the_snapshot() -> None:
    assert snapshot().splitlines() == SNAPSHOT.read_text(encoding="utf-8").splitlines()


if __name__ == "__main__":
    SNAPSHOT.write_text(snapshot(), encoding="utf-8")
