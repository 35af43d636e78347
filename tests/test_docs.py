"""The pages of docs/: links, names, drawings, tutorials. ``.ci/run`` builds the site itself."""

import ast
import importlib
import re
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest

from kneexo import systems
from kneexo.parameters import (
    G1,
    BldcPumpParameters,
    CylinderParameters,
    EncoderParameters,
    PlantParameters,
    Scenario,
    SimulationParameters,
    SlidingModeParameters,
)
from kneexo.simulation import simulate
from kneexo.systems._leaf import NamedLeaf

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = sorted(
    page
    for page in [*ROOT.glob("*.md"), *DOCS.glob("*.md"), *DOCS.glob("tutorials/*.md")]
    if page.name != "README.md" or page.parent == ROOT
)
TUTORIALS = [page for page in PAGES if page.parent.name == "tutorials" and page.stem != "index"]
LINK = re.compile(r"\[((?:[^\]\[]|\[[^\]]*\])*)\]\(([^)\s]+)\)")


def text_of(page):
    """The page without its code."""
    text = page.read_text(encoding="utf-8")
    return re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)


def anchors(page):
    """The anchors of the headings, as code hosts and MyST name them."""
    headings = re.findall(r"^#+ (.*)$", text_of(page), re.MULTILINE)
    plain = [re.sub(r"[^\w\- ]", "", re.sub(r"[`*]", "", heading).lower()) for heading in headings]
    return {heading.replace(" ", "-") for heading in plain}


def dead_links(page):
    dead = []
    for _, target in LINK.findall(text_of(page)):
        if "://" in target:
            continue
        path, _, anchor = target.partition("#")
        file = page.parent / path if path else page
        if not file.exists() or (anchor and anchor not in anchors(file)):
            dead.append(target)
    return dead


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_no_link_of_a_page_is_dead(page):
    assert dead_links(page) == []


def test_a_dead_link_is_seen(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("# A b\n[x](#a-b) [y](#c) [z](no.md) [w](https://a.org)\n", encoding="utf-8")
    assert dead_links(page) == ["#c", "no.md"]


def test_every_page_is_in_the_table_of_contents():
    listed = set()
    for index in (DOCS / "index.md", DOCS / "tutorials/index.md"):
        blocks = re.findall(r"^```\{toctree\}\n(.*?)^```", index.read_text("utf-8"), re.S | re.M)
        entries = [e for block in blocks for e in block.split("\n") if e and e[0] != ":"]
        listed |= {(index.parent / entry).resolve() for entry in entries}
    pages = {page.with_suffix("").resolve() for page in PAGES if DOCS in page.parents}
    assert pages | {DOCS / "reference"} == listed | {DOCS / "index"}


THEORY = (DOCS / "theory.md").read_text(encoding="utf-8")


def test_the_theory_names_what_its_modules_have():
    linked = re.findall(r"\[((?:`\w+`(?:, )?)+)\]\(\.\./(kneexo/[\w/]+)\.py\)", THEORY)
    assert len(linked) >= 15
    for names, path in linked:
        module = importlib.import_module(path.replace("/", "."))
        for name in re.findall(r"`(\w+)`", names):
            assert hasattr(module, name), f"{path} has no {name}"


def test_the_theory_has_every_leaf_system():
    leaves = {
        name
        for name, value in vars(systems).items()
        if isinstance(value, type) and issubclass(value, NamedLeaf)
    }
    aside = {"StepKneeReference", "RampKneeReference"}  # named as steps and ramps
    assert [name for name in sorted(leaves - aside) if f"`{name}`" not in THEORY] == []


def test_the_theory_uses_every_symbol_of_its_table():
    head, _, body = THEORY.partition("## The four-bar knee")
    cells = re.findall(r"^\| ((?:\$[^$]+\$(?:, )?)+) \|", head, re.MULTILINE)
    symbols = [s for cell in cells for s in re.split(r", |\\ldots", cell.replace("$", "")) if s]
    assert len(symbols) > 60
    unused = [s.strip() for s in symbols if s.strip() not in body]
    assert unused == ["a_1"]  # the ground link is given by its joints


@pytest.mark.parametrize("tutorial", TUTORIALS, ids=lambda page: page.stem)
def test_a_tutorial_ends_with_a_picture_and_a_number(tutorial):
    text = tutorial.read_text(encoding="utf-8")
    *_, last = re.findall(r"^```\{code-cell\}.*?\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    assert "plt.subplots" in last
    assert re.search(r"print\(\s*f\"[^\"]*\{", last)
    assert f"{{nb-download}}`{tutorial.stem}.ipynb`" in text


NUMBER = re.compile(r"(?<![\w.])\d[\d_]*(?:\.\d+)?(?![\w.]*\d)")
WORDS = {"ten thousand": "10_000", "two hundred": "200", "twenty": "20", "ten": "10"}


def numbers(text):
    return {float(number.replace("_", "")) for number in NUMBER.findall(text)}


def untold_numbers(text):
    """Numbers of a tutorial that are no input of its cells: in the prose, and in what is printed.

    What a run gives is an expression in an f-string, so a cell computes it when it is read.
    """
    cells = re.findall(r"^```\{code-cell\}.*?\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    tree = ast.parse("\n".join(cells))
    literals = [node for node in ast.walk(tree) if isinstance(node, ast.Constant)]
    inputs = {abs(float(n.value)) for n in literals if isinstance(n.value, int | float)}
    # as they read in another unit
    scales = (1e-6, 1e-3, 1e3, 1e6, 1e2)
    inputs |= {round(scale * value, 12) for value in inputs for scale in scales}
    prose = re.sub(r"^---.*?^---|^```.*?^```|^#.*?$", "", text, flags=re.DOTALL | re.MULTILINE)
    prose = re.sub(r"`[^`]*`|\$[^$]*\$|\]\([^)]*\)", " ", prose)
    for name, digits in WORDS.items():
        prose = re.sub(rf"\b{name}\b", digits, prose)
    named = r"\b(?:Fig\.|Table|Eq\.|FMI|G|tutorial|Tutorial) ?\d+"  # names, no results
    nodes = list(ast.walk(tree))
    formats = [node.format_spec for node in nodes if isinstance(node, ast.FormattedValue)]
    strings = [n for n in nodes if isinstance(n, ast.JoinedStr) and n not in formats]
    shown = [n.value for s in strings for n in s.values if isinstance(n, ast.Constant)]
    printed = re.sub(r"[-−]3 dB", "", " ".join(shown))  # the definition of bandwidth
    prose = re.sub(r"[-−]3 dB", "", re.sub(named, "", prose))
    return (numbers(prose) | numbers(printed)) - inputs


@pytest.mark.parametrize("tutorial", TUTORIALS, ids=lambda page: page.stem)
def test_every_number_of_a_tutorial_comes_from_a_cell(tutorial):
    assert untold_numbers(tutorial.read_text(encoding="utf-8")) == set()


def test_a_number_that_no_cell_has_is_seen():
    cell = "```{code-cell} ipython3\ngain = 8e-3\nprint(f'{gain} of 0.25 Hz')\n```\n"
    assert untold_numbers(cell + "By 8 mm it rises to 3.7 deg, in Fig. 12 ten times.") == {
        0.25,
        3.7,
        10.0,
    }


@pytest.fixture(scope="module")
def drawings():
    sys.path.insert(0, str(DOCS))
    try:
        yield importlib.import_module("drawings")
    finally:
        sys.path.remove(str(DOCS))


@pytest.mark.parametrize(
    "name", ["mechanism", "hydraulic_circuit", "block_diagram", "sample_timing"]
)
def test_nothing_of_a_drawing_is_cut_off(drawings, name):
    figure = getattr(drawings, name)()
    figure.canvas.draw()
    frame = figure.bbox
    texts = [t for ax in figure.axes for t in ax.texts if t.get_text()]
    for text in texts:
        box = text.get_window_extent()
        assert frame.x0 <= box.x0 <= box.x1 <= frame.x1, text.get_text()
        assert frame.y0 <= box.y0 <= box.y1 <= frame.y1, text.get_text()
    for ax in figure.axes:
        for patch in ax.patches if not ax.axison else ():
            box = patch.get_window_extent()
            assert ax.bbox.x0 <= box.x0 <= box.x1 <= ax.bbox.x1
            assert ax.bbox.y0 <= box.y0 <= box.y1 <= ax.bbox.y1
        assert not ax.axison or (ax.get_xlabel() + ax.get_ylabel()).endswith(")")
    plt.close(figure)


def test_the_drawings_follow_the_parameters(drawings):
    plant = PlantParameters(
        pump=BldcPumpParameters(gear_ratio=3.0), cylinder=CylinderParameters(mass_kg=1.7)
    )
    figure = drawings.hydraulic_circuit(plant)
    texts = " ".join(text.get_text() for text in figure.axes[0].texts)
    assert "3:1" in texts
    assert "1.7 kg" in texts
    assert "0.8 cm³/rev" in texts
    assert "±5000 rpm" in texts
    assert "314 mm²" in texts
    assert "236 mm²" in texts
    plt.close(figure)


def test_the_mechanism_closes_where_it_is_drawn(drawings):
    figure = drawings.mechanism(G1, 50.0)
    ends = {line.get_gid(): line.get_xydata() @ [1.0, 1j] for line in figure.axes[1].lines}
    for name, length in (("a_2", G1.a_2_m), ("a_3", G1.a_3_m), ("a_4", G1.a_4_m)):
        assert abs(np.diff(ends[name])[0]) == pytest.approx(1e3 * length, rel=1e-12)
    for one, other in (("a_1", "a_2"), ("a_2", "a_3"), ("a_3", "a_4"), ("a_4", "a_1")):
        assert np.abs(np.subtract.outer(ends[one], ends[other])).min() < 1e-9
    theta_3 = np.angle(np.diff(ends["a_3"])[0])
    knee = np.degrees(np.angle(np.exp(1j * (theta_3 + G1.phi_rad))))
    assert knee == pytest.approx(50.0, abs=1e-9)
    plt.close(figure)


def test_the_loop_is_drawn_with_its_encoder_and_its_period(drawings):
    encoder = EncoderParameters(counts_per_revolution=720)
    law = SlidingModeParameters(sample_time_s=0.001)
    figure = drawings.block_diagram(Scenario(encoder=encoder, controller=law))
    texts = " ".join(text.get_text() for text in figure.axes[0].texts)
    assert "counts of 0.500°" in texts
    assert "every 1 ms" in texts
    plt.close(figure)


def test_the_timing_is_that_of_a_run(drawings):
    figure = drawings.sample_timing(start_s=1.0, samples=3)
    (counts, *_), (command, speed) = (ax.lines[:2] for ax in figure.axes)
    run = simulate(Scenario(simulation=SimulationParameters(duration_s=1.1)))
    index = 1.0 / 0.002
    for sample in range(3):
        row = round(index) + sample
        middle = 2.0 * sample + 1.0  # ms
        reading = np.degrees(run["encoder_reading_rad"][row]) / 360.0 * 4096.0
        assert np.interp(2.0 * sample + 0.1, *counts.get_data()) == pytest.approx(reading, abs=1.01)
        held = run["motor_speed_command_rad_s"][row + 1] * 30.0 / np.pi
        assert np.interp(middle, *command.get_data()) == pytest.approx(held, rel=1e-6)
        ends = run["motor_speed_rad_s"][row : row + 2] * 30.0 / np.pi
        assert ends.min() - 0.1 <= np.interp(middle, *speed.get_data()) <= ends.max() + 0.1
    plt.close(figure)


def undocumented(source):
    """Public names that a module defines without a docstring: autodoc shows no other."""
    tree = ast.parse(source)
    names = []
    for node, after in zip(tree.body, [*tree.body[1:], None], strict=True):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            overload = any(
                isinstance(d, ast.Name) and d.id == "overload" for d in node.decorator_list
            )
            named = [] if overload or ast.get_docstring(node) else [node.name]
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            call = node.value.func if isinstance(node.value, ast.Call) else None
            if isinstance(call, ast.Name) and call.id in ("TypeVar", "ParamSpec"):
                continue
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            told = isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
            leaves = [leaf for target in targets for leaf in ast.walk(target)]
            named = [n.id for n in leaves if isinstance(n, ast.Name) and not told]
        else:
            continue
        names += [name for name in named if not name.startswith("_")]
    return names


MODULES = [
    path
    for path in sorted((ROOT / "kneexo").rglob("*.py"))
    if path.name == "__init__.py" or not path.name.startswith("_")
]


@pytest.mark.parametrize("module", MODULES, ids=lambda p: str(p.relative_to(ROOT)))
def test_every_public_name_is_documented(module):
    assert undocumented(module.read_text(encoding="utf-8")) == []


def test_a_name_without_a_docstring_is_seen():
    source = 'A = 1\n"""One."""\nB: int = 2\n_C = 3\nT = TypeVar("T")\ndef f(): ...\n'
    assert undocumented(source) == ["B", "f"]
