"""Sphinx settings of the documentation: ``sphinx-build -W -n docs docs/_build/html``.

Nothing is loaded from the network, neither by the build nor by the pages: formulas become MathML
by docutils' own converter, which browsers show without a script.
"""

from __future__ import annotations

import atexit
import importlib
import os
import pkgutil
import re
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

from docutils import nodes
from docutils.utils.math import MathError
from docutils.utils.math.latex2mathml import tex2mathml
from sphinx.application import Sphinx
from sphinx.errors import ExtensionError
from sphinx.ext import autosummary
from sphinx.util import logging
from sphinx.util.inspect import signature, stringify_signature
from sphinx.util.nodes import make_refnode

import diagramc
import kneexo
from kneexo.command_line.main import main
from kneexo.errors import shortened
from kneexo.parameters.fields.fields import allowed_range, source_of, unit_of
from kneexo.parameters.fields.quantity import Parameters
from kneexo.systems._leaf import NamedLeaf

project = "kneexo"
author = "the kneexo authors"
sys.path.insert(0, str(Path(__file__).parent))  # notebooks.py
release = version = kneexo.__version__

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
]
templates_path = ["_templates"]
exclude_patterns = ["_build", "_templates", "jupyter_execute"]
html_theme = "furo"
html_show_copyright = False
html_title = f"kneexo {release}"
html_math_renderer = "mathml"
html_static_path = ["_static"]
html_css_files = ["site.css"]

autosummary.WELL_KNOWN_ABBREVIATIONS += ("Eq.", "Fig.")  # no sentence of a summary ends there

default_role = "py:obj"  # `Name` in a docstring is a reference that must resolve
nitpick_ignore_regex = [("py:class", ".*")]  # annotations may be aliases, or other packages'
suppress_warnings = ["ref.python"]  # a short name in an annotation that two modules have
autodoc_member_order = "bysource"
autodoc_default_options = {
    "members": True,
    "ignore-module-all": True,
    "exclude-members": "model_config",
    "show-inheritance": True,
}
autodoc_preserve_defaults = True
napoleon_google_docstring = False
napoleon_use_rtype = False
python_maximum_signature_line_length = 88
toc_object_entries_show_parents = "hide"

myst_enable_extensions = ["amsmath", "dollarmath"]
myst_heading_anchors = 3

# The build runs the pages with cells. An exception or text on stderr is a warning, which -W makes
# an error.
nb_execution_mode = "force"
nb_execution_timeout = 120
nb_execution_raise_on_error = True
nb_output_stderr = "error"
nb_merge_streams = True  # lines that a slow cell prints one by one are one box
nb_execution_show_tb = True

# What the kernels inherit: warnings of a cell are exceptions, and compiling says nothing.
os.environ["IPYTHONDIR"] = _ipython = tempfile.mkdtemp(prefix="kneexo-docs-")
atexit.register(shutil.rmtree, _ipython, ignore_errors=True)
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
_startup = Path(_ipython, "profile_default", "startup", "strict.py")
_startup.parent.mkdir(parents=True)
_startup.write_text(
    """\
import warnings
warnings.filterwarnings("error", module="__main__|diagramc|kneexo|matplotlib|numpy|pydrake|scipy")
from diagramc.native import machine_code
machine_code.ANNOUNCED_AFTER_S = 1e6
del machine_code, warnings
""",
    encoding="utf-8",
)

# The kernels talk to this machine alone; they need not warn that they do it in plain text.
Path(_ipython, "profile_default", "ipython_kernel_config.py").write_text(
    "c.IPKernelApp.log_level = 'ERROR'\n", encoding="utf-8"
)

EXTERNAL = {
    # Names of Drake, of the standard library and of type variables in our docstrings.
    *("RotaryEncoders", "PassThrough", "DiscreteTimeDelay", "VectorLogSink", "TrajectorySource"),
    *("Linearize", "ValueError", "TypeError", "SystemExit", "pydrake.math"),
    *("Expression", "FramePoseVector", "MeshcatVisualizer"),
    *("diagramc.equations.symbolic.T", "kneexo.simulation.lockstep.Result"),
    *("kneexo.simulation.lockstep.Function", "functools.partial", "numpy.linalg.lstsq"),
    *("jinja2.UndefinedError", "Multiplexer", "RandomSource", "Stage.unpack"),
    *("control.StateSpace", "pandas.DataFrame", "concurrent.futures.Executor"),
}


def list_public_names(_app: Sphinx, document: str, content: list[str]) -> None:
    """Append to the page ``reference`` a table of names for each package that users import."""
    if document != "reference":
        return
    from public_names import public_names

    for module, names in public_names().items():
        summary = (importlib.import_module(module).__doc__ or "").split("\n\n")[0]
        lines = [module, "-" * len(module), "", summary, "", ".. autosummary::", ""]
        content[0] += "\n".join(["", *lines, *(f"   ~{name}" for name in names), ""])


_attributes: dict[str, list[str]] = {}


def prepare(_app: Any, what: str, name: str, _obj: Any, _opts: Any, lines: list[str]) -> None:
    """Absolute values |x| in docstrings are no substitutions of reStructuredText."""
    for index, line in enumerate(lines):
        pieces = re.split(r"(``.*?``)", line)
        lines[index] = "".join(p if p.startswith("``") else p.replace("|", r"\|") for p in pieces)
    if what in ("attribute", "data", "property"):
        _attributes[name] = list(lines)


def restore(_app: Any, _what: str, name: str, _obj: Any, _opts: Any, lines: list[str]) -> None:
    """What napoleon takes for "type: description" in an attribute is a sentence with a colon."""
    if name in _attributes:
        lines[:] = _attributes.pop(name)


def sign(_app: Any, what: str, _name: str, obj: Any, *_: Any) -> tuple[str, str] | None:
    """The arguments of a leaf system are those of its ``__init__``; parameters have a table."""
    if what != "class" or not isinstance(obj, type):
        return None
    if issubclass(obj, Parameters):
        return "", ""
    if issubclass(obj, NamedLeaf):
        return stringify_signature(signature(obj.__init__, bound_method=True)), ""
    return None


def limits(text: str) -> str:
    """A range as signs that a narrow column does not tear apart."""
    for plain, printed in ((">=", "≥"), ("<=", "≤"), (" and ", ", "), ("e-", "e−")):
        text = text.replace(plain, printed)
    return re.sub(r"([≥>≤]) ", "\\1\u00a0", text)


def list_quantities(
    _app: Any, what: str, _name: str, obj: Any, _opts: Any, lines: list[str]
) -> None:
    """The numbers of a parameter class with unit, range and provenance."""
    if what != "class" or not (isinstance(obj, type) and issubclass(obj, Parameters)):
        return
    rows = [("name", "default", "unit", "range", "source")]
    for name, field in obj.model_fields.items():
        value = field.default
        told = f"{value:.6g}" if isinstance(value, float) else shortened(repr(value), 60)
        told = "required" if field.is_required() else f"``{told}``"
        cells = (
            told,
            unit_of(field),
            limits(allowed_range(field)),
            source_of(field),
        )
        rows.append((f"``{name}``", *(cell.replace("|", r"\|") for cell in cells)))
    if len(rows) == 1:
        return
    lines += ["", ".. list-table::", "   :header-rows: 1", "   :widths: 26 14 10 14 36", ""]
    for first, *others in rows:
        lines += [f"   * - {first}", *(f"     - {cell}" for cell in others)]
    lines.append("")


def resolve(app: Sphinx, env: Any, node: Any, contnode: Any) -> Any:
    """A name without its module, or of a package that imports it from elsewhere."""
    target = node.get("reftarget", "")
    if node.get("refdomain") != "py":
        return None
    if target in EXTERNAL:
        return contnode
    objects = env.domains.python_domain.objects
    parent, _, last = target.rpartition(".")
    if parent.startswith(("diagramc", "kneexo")):
        value = getattr(importlib.import_module(parent), last, None)
        home = getattr(value, "__module__", None)
        places = [name for name in objects if name == f"{home}.{last}"]
        if value is not None and home is None:  # a constant does not know where it was made
            tail = f".{last}"
            places = [n for n in objects if n.startswith(f"{parent}.") and n.endswith(tail)]
    else:
        places = [name for name in objects if name.endswith(f".{target}")]
    if not places:
        return None
    here = (node.get("py:module") or "").split(".")
    name = max(places, key=lambda place: sum(map(str.__eq__, place.split("."), here)))
    entry = objects[name]
    return make_refnode(app.builder, node["refdoc"], entry.docname, entry.node_id, contnode, name)


def source_links(_app: Sphinx, _document: str, content: list[str]) -> None:
    """Links of the Markdown pages to modules lead to the reference."""
    content[0] = re.sub(
        r"\]\(\.\./((?:diagramc|kneexo)(?:/[a-z]\w*)+)\.py\)",
        lambda match: f"](/api/{match[1].replace('/', '.')}.rst)",
        content[0],
    )


def drop_old_pages(app: Sphinx) -> None:
    """Autosummary keeps the page of a module that is no more, and its import would be a warning."""
    modules = {"diagramc", "kneexo"}
    for root in (diagramc, kneexo):
        infos = pkgutil.walk_packages(root.__path__, f"{root.__name__}.")
        modules |= {info.name for info in infos}
    for page in Path(app.srcdir, "api").glob("*.rst"):
        if page.stem not in modules:
            page.unlink()


FRAMES = {
    "play": ("playground.html", "The page to play with", ["play", "--preset", "leg"]),
    "fault": (
        "protected.html#a.fault=encoder_frozen",
        "Throw a fault at the knee",
        ["play", "--preset", "protected"],
    ),
    "knee": ("knee.html", "The knee moves", ["view", "--preset", "leg"]),
}
"""Pages in frames. Each marker in the Markdown has address, title, and command of the file."""


def place_frames(_app: Sphinx, document: str, content: list[str]) -> None:
    """Replace a marker by a frame with its page, and by a link that opens the page alone.

    The style hides frames on paper. There a picture replaces the page to play with.
    """
    up = "../" * document.count("/")
    for marker, (file, title, _) in FRAMES.items():
        picture = f'<img src="{up}_images/playground.png" alt="" loading="lazy">'
        shown = f"{picture if marker == 'play' else ''}{title}: open it alone"
        frame = (
            f'<iframe class="{marker}" src="{up}{file}" title="{title}" loading="lazy"></iframe>\n'
            f'<p class="{marker}-alone"><a href="{up}{file}">{shown}</a></p>'
        )
        content[0] = content[0].replace(f"<!-- {marker} -->", f"```{{raw}} html\n{frame}\n```")


def write_frames(app: Sphinx, failure: Exception | None) -> None:
    """The pages in frames, beside those of the site that show them."""
    if failure is not None or app.builder.format != "html":
        return
    for file, _, command in FRAMES.values():
        if main([*command, "--out", str(app.outdir / file.partition("#")[0])]):
            raise ExtensionError(f"kneexo {command[0]} has failed")


def finish_notebooks(_app: Sphinx, env: Any) -> None:
    """What ``nb-download`` offers is for Jupyter: it knows no role and no page of the site."""
    from notebooks import make_plain

    for notebook in Path(env.mystnb_config.output_folder, "tutorials").glob("*.ipynb"):
        make_plain(notebook)


_ACCENT = re.compile(r"(\\(?:d*dot|hat|bar|tilde))\s*(\{\\?\w+\}|\\[a-zA-Z]+|\w)(?=\s*['_^])")
_FUNCTION = re.compile(
    r"(\\(?:arc)?(?:cos|sin|tan)h?|\\operatorname\{\w+\})(?![a-z])( *(?=\w|\\(?!left)))?"
)


def mathml(self: Any, node: nodes.Element, *, block: bool) -> None:
    """Write a formula as MathML; what it cannot read is a warning, and -W stops."""
    # docutils puts the index of an accented letter below it, and three dots far apart; it leaves
    # no space around the name of a function.
    formula = _ACCENT.sub(r"{{}\1 \2}", node.astext())
    formula = _FUNCTION.sub(lambda m: rf"\,{m[1]}" + (" " if m[2] is None else r"\,"), formula)
    try:
        self.body.append(str(tex2mathml(formula, as_block=block)).replace("˙˙˙", "..."))
    except MathError as error:
        logging.getLogger(__name__).warning("%s: %s", error, node.astext(), location=node)
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    """Connect the above."""
    app.connect("autodoc-process-docstring", prepare, priority=400)  # napoleon has 500
    app.connect("autodoc-process-docstring", restore, priority=600)
    app.connect("autodoc-process-signature", sign)
    app.connect("autodoc-process-docstring", list_quantities)
    app.connect("missing-reference", resolve)
    app.connect("builder-inited", drop_old_pages, priority=400)  # autosummary has 500
    app.connect("source-read", list_public_names)
    app.connect("source-read", source_links)
    app.connect("source-read", place_frames)
    app.connect("build-finished", write_frames)
    app.connect("env-updated", finish_notebooks)
    app.add_html_math_renderer(
        "mathml",
        (lambda self, node: mathml(self, node, block=False), None),
        (lambda self, node: mathml(self, node, block=True), None),
    )
    return {"parallel_read_safe": True, "parallel_write_safe": True}
