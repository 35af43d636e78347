"""Makes the page to play with, on which the closed loop of a scenario runs in the browser."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import product
from typing import Any

from kneexo.analysis.tracking.clauses import CLAUSES
from kneexo.diagrams.wearer import moment_of
from kneexo.errors import KneexoError, ParameterError
from kneexo.page.model import web_model, web_modules, with_structure
from kneexo.page.modules import TORQUE_MODES
from kneexo.page.sliders import Slider
from kneexo.parameters import Scenario
from kneexo.parameters.criteria import MARGINS, RECOVERY_BAND_DEG
from kneexo.parameters.device.law import Law
from kneexo.parameters.fields.fields import kind_of
from kneexo.parameters.fields.quantity import Parameters
from kneexo.parameters.paths import changed
from kneexo.version import __version__
from kneexo.view.stage import STAGE_SCRIPTS, STAGE_STYLES, stage_leg
from kneexo.view.web_page import self_contained_page, web_text

MOST_SCENARIOS = 8
"""Largest number of scenarios of a page. A page of eight structures has about 4 MB."""

LONGEST_RUN_S = 60.0
"""Longest run of a page in s. A page shows the first part of a longer scenario."""

_SHORTEST_RUN_S = 0.5

_SCRIPTS = (
    "page/web/playground_setups.js",
    "page/web/playground_curves.js",
    "page/web/playground_safety.js",
    "page/web/playground_bode.js",
    "page/web/playground_controls.js",
    "page/web/playground_numbers.js",
    "page/web/playground_runner.js",
    "page/web/playground_history.js",
    "page/web/playground.js",
)

_WORKER = (
    "page/web/simulator.js",
    "page/web/linear_loop.js",
    "page/web/sine_sweep.js",
    "page/web/worker.js",
)

_CONTROLLERS, _LOADS = ("smc", "pid"), ("none", "knee")
"""Kinds of controller and load between which switches of the page choose."""

_GROUPS = {
    "Fault": ("fault.",),
    "Task": ("reference.", "simulation."),
    "Push": ("push.",),
    "Controller": ("controller.", "estimator.", "encoder.", "nominal.", "polynomial.", "bus."),
    "Protection": ("protection.",),
    "Wearer": ("wearer.", "load_cell."),
    "Motor and pump": ("plant.pump.",),
    "Oil and cylinder": ("plant.cylinder.", "plant.full_order."),
    "Leg": ("plant.load.", "plant.knee.", "plant.linkage."),
}
"""Groups of sliders: prefixes of their names, by the title of the group."""


def playground_page(scenarios: Sequence[Scenario], names: Sequence[str]) -> str:
    """Return one HTML page on which the closed loops of ``scenarios`` run and can be changed.

    ``names`` are the names of the scenarios on the page. Two scenarios are compared when the page
    opens. With a single scenario, the user can compare the loop with another
    kind of controller.

    Raises the errors of `playground_data`.
    """
    return page_of(playground_data(scenarios, names))


def page_of(data: dict[str, Any]) -> str:
    """Return the HTML page with data of `playground_data`."""
    names = [entry["name"] for entry in data["scenarios"]]
    styles = (*STAGE_STYLES, "page/web/playground.css")
    scripts = (*STAGE_SCRIPTS, *_SCRIPTS)
    return self_contained_page(
        f"kneexo: {', '.join(names)}",
        web_text("page/web/playground.html"),
        [web_text(name) for name in styles],
        [web_text(name) for name in scripts],
        {"playground": data},
        worker="\n".join(web_text(name) for name in _WORKER),
        wasm=True,
    )


def playground_data(scenarios: Sequence[Scenario], names: Sequence[str]) -> dict[str, Any]:
    """Return the data of a page.

    They are modules, scenarios, groups of sliders, and the two set-ups that the page can compare.
    Raises `ParameterError` for no scenario or more than `MOST_SCENARIOS`, and the errors of
    `web_model`.
    """
    if not 1 <= len(scenarios) <= MOST_SCENARIOS:
        raise ParameterError(
            f"{len(scenarios)} scenarios: a page has at least 1 and at most {MOST_SCENARIOS}"
        )
    entries = [_entry(scenario, name) for scenario, name in zip(scenarios, names, strict=True)]
    models = [model for entry in entries for model in entry["models"]]
    first = {"scenario": 0, **entries[0]["start"], "values": {}}
    if len(entries) > 1:
        second = {"scenario": 1, **entries[1]["start"], "values": {}}
    else:
        second = first | _other_controller(entries[0]["models"], first)
    longest_s = min(map(_longest_s, scenarios))
    return {
        "kneexo": __version__,
        "modules": web_modules(models),
        "scenarios": entries,
        "setups": [first, second],
        "compare": len(entries) > 1,
        "clauses": CLAUSES,
        "margins": MARGINS,
        "recovery_band_deg": RECOVERY_BAND_DEG,
        "groups": [{"title": title, "prefixes": prefixes} for title, prefixes in _GROUPS.items()],
        # Its default is the duration of each scenario.
        "duration": Slider("duration of the run", _SHORTEST_RUN_S, longest_s, "").quantity(
            "simulation.duration_s", longest_s, "s", ""
        ),
    }


def missing_models(data: dict[str, Any]) -> list[str]:
    """Return a sentence for each reason why controllers and loads are not on a page."""
    return [
        f"{entry['name']}: the page has no "
        f"{', no '.join(f'{controller} with load {load}' for controller, load in pairs)}. {reason}"
        for entry in data["scenarios"]
        for reason, pairs in entry["missing"].items()
    ]


def _entry(scenario: Scenario, name: str) -> dict[str, Any]:
    """Return a scenario's part of the data: its models, its leg, and the choices of its switches.

    The first model is that of the scenario. The models of other controllers and loads follow, if
    they can be made on this machine.
    """
    duration_s = min(max(scenario.duration_s, _SHORTEST_RUN_S), _longest_s(scenario))
    scenario = changed(scenario, {"simulation.duration_s": duration_s})
    first = _model(scenario)
    variants, missing = _variants(scenario, first)
    models = [first, *variants]
    for model in models[1:]:
        # Samples once a page, which stays small.
        if model["references"].get("samples") == first["references"].get("samples"):
            model["references"].pop("samples", None)  # the page reads those of the first
    knee, limits = scenario.plant.knee, first["limits"]
    faults = first.get("faults") or {"fault": "none", "protection": "off"}
    return {
        "name": name,
        "models": models,
        "missing": missing,
        "duration_s": duration_s,
        "start": {
            "controller": first["controller"],
            "load": first["load"],
            "reference": scenario.reference.kind,
            "fault": faults["fault"],
            "protection": faults["protection"],
        },
        "leg": stage_leg(
            name,
            scenario.plant.linkage,
            limits["knee_low_rad"] - math.radians(knee.overshoot_deg),
            limits["knee_high_rad"] + math.radians(knee.overshoot_deg),
            scenario.plant.cylinder.pressure_rating_pa,
        )
        | {"pressure_unit": "bar"},  # as the curves and sliders of the page
    }


def _longest_s(scenario: Scenario) -> float:
    """Return the duration in s of the longest run that a biological moment of a wearer covers."""
    moment = moment_of(scenario)
    return LONGEST_RUN_S if moment is None else min(LONGEST_RUN_S, moment.times_s[-1])


def _model(scenario: Scenario) -> dict[str, Any]:
    """Return the model of a scenario, with the values of its scenario file but its faults."""
    return {**web_model(scenario), "scenario": _differences(scenario.changed({"faults": ()}))}


def _variants(
    scenario: Scenario, first: dict[str, Any]
) -> tuple[list[dict[str, Any]], dict[str, list[tuple[str, str]]]]:
    """Return the models of the other combinations of controller and load, and the missing ones.

    The second result is a dictionary from the reason why a model cannot be made to combinations of
    controller and load. A machine without Zig has the modules of the most common structures only.
    """
    controllers, loads = [first["controller"], *_CONTROLLERS], [first["load"], *_LOADS]
    if first["wearer"]:  # a cuff acts on the load, and only a moment can be assisted
        modes = (mode for mode in TORQUE_MODES if mode != "assist" or first["moment"])
        controllers, loads = [first["controller"], *modes], loads[:1]
    pairs = product(dict.fromkeys(controllers), dict.fromkeys(loads))
    models: list[dict[str, Any]] = []
    missing: dict[str, list[tuple[str, str]]] = {}
    for pair in pairs:
        if pair == (first["controller"], first["load"]):
            continue
        try:
            models.append(_model(with_structure(scenario, *pair)))
        except KneexoError as error:
            missing.setdefault(str(error), []).append(pair)
    return models, missing


def _other_controller(models: list[dict[str, Any]], first: dict[str, Any]) -> dict[str, Any]:
    """Return the controller of set-up B of a page with one scenario."""
    others = [
        model["controller"]
        for model in models
        if model["load"] == first["load"] and model["controller"] != first["controller"]
    ]
    return {"controller": others[0]} if others else {}


def _differences(parameters: Parameters) -> dict[str, Any]:
    """Return the values of ``parameters`` that differ from the defaults, as in a scenario file."""
    result: dict[str, Any] = {}
    for name, field in type(parameters).model_fields.items():
        value = getattr(parameters, name)
        if name == "kind" or (not field.is_required() and value == field.default):
            continue
        if isinstance(value, Parameters):
            kind = kind_of(type(value))
            result[name] = ({} if kind is None else {"kind": kind}) | _differences(value)
        elif isinstance(value, Law):
            result[name] = value.written
        else:
            result[name] = list(value) if isinstance(value, tuple) else value
    return result
