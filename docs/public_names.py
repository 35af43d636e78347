"""The names that users import, read from the source: what the page ``reference`` lists."""

from __future__ import annotations

import ast
import functools
import importlib
import importlib.util
import inspect
import itertools
import pkgutil

import diagramc
import kneexo

BESIDE_PACKAGES = {
    "kneexo.analysis.batches": ("BatchResult", "BatchRow"),
    "kneexo.analysis.identification.experiment": ("Experiment", "standard_candidates"),
    "kneexo.analysis.identification.fit": ("FittedScenario",),
    "kneexo.errors": ("KneexoError", "ScenarioError", "LinkageError"),
    "kneexo.export.firmware": ("export_firmware", "export_sil"),
    "kneexo.export.fmu": ("export_fmu",),
    "kneexo.geometry.linkage": (
        *("pose", "rod_extension", "encoder_angle", "knee_angle_from_encoder"),
        *("knee_angle_from_rod", "icr"),
    ),
    "kneexo.geometry.linkage_properties": ("linkage_properties", "LinkageProperties", "OverMotion"),
    "kneexo.parameters.paths": ("changed", "value_at"),
    "kneexo.parameters.scenario_file": ("load_scenario", "dump_scenario", "load_uncertainty"),
    "kneexo.parameters.uncertainty": ("draw", "realize"),
    "kneexo.analysis.responses": ("BodeResponse",),
    "kneexo.geometry.rod_polynomial": ("controller_polynomial", "fitted_polynomial"),
    "kneexo.studies.paper": ("FIG_12", "IDEAL_SMC", "EQ_27_EXACT_STATES", "EQ_27_DIFFERENCES"),
    "kneexo.view.drawing": ("mechanism_svg",),
    "kneexo.view.meshcat_view": ("add_meshcat_view",),
    "kneexo.page.play": ("Playground",),
    "kneexo.view.page": ("view_page",),
}
"""Names that users import from the module that defines them."""


def public_names() -> dict[str, list[str]]:
    """Return what users import: by package or module, the full names of where it is defined.

    The ``__all__`` of a package has its names for users.
    """
    packages = []
    for root in (diagramc, kneexo):
        inner = pkgutil.walk_packages(root.__path__, f"{root.__name__}.")
        packages += [root.__name__, *(info.name for info in inner if info.ispkg)]
    names = {package: passed_on(package) for package in packages}
    names |= {m: [f"{m}.{name}" for name in list_] for m, list_ in BESIDE_PACKAGES.items()}
    return {module: names[module] for module in sorted(names) if names[module]}


def top_level(module: str) -> list[ast.stmt]:
    """Return the statements of a module, with those below an ``if TYPE_CHECKING``."""
    tree = ast.parse(inspect.getsource(importlib.import_module(module)))
    inner = [node.body for node in tree.body if isinstance(node, ast.If)]
    return [*tree.body, *itertools.chain(*inner)]


@functools.cache
def imported(module: str) -> dict[str, str]:
    """Return the names that a module imports from both packages, and from where."""
    names = {}
    for node in top_level(module):
        if isinstance(node, ast.ImportFrom):
            source = "." * node.level + (node.module or "")
            package = importlib.import_module(module).__package__
            source = importlib.util.resolve_name(source, package)
            if source.startswith(("diagramc", "kneexo.")):
                names |= {alias.asname or alias.name: source for alias in node.names}
    return names


def home(module: str, name: str) -> str:
    """Return the full name of ``name`` in the module that defines ``name``."""
    source = imported(module).get(name)
    return f"{module}.{name}" if source is None else home(source, name)


def passed_on(package: str) -> list[str]:
    """Return the full names of what a package has for users, without templates such as ``X_``."""
    names = getattr(importlib.import_module(package), "__all__", ())
    public = [name for name in names if name.strip("_") == name]
    return [home(package, name) for name in sorted(public, key=str.lower)]
