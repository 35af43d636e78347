"""The pages of docs/: links, names, drawings, tutorials. ``.ci/run`` builds the site itself."""

import ast
import importlib
import inspect
import math
import pickle
import re
import shutil
import subprocess
import sys
from dataclasses import is_dataclass
from pathlib import Path

import numpy as np
import pytest
from elsewhere import module_of
from PIL import Image

from kneexo import systems
from kneexo.analysis import fit_polynomials, linearize_loop, track
from kneexo.analysis.signals import rms
from kneexo.command_line.output import words_of
from kneexo.parameters import (
    G1,
    LINKAGES,
    BldcPumpParameters,
    CylinderParameters,
    PlantParameters,
    RodPolynomialParameters,
    Scenario,
    SimulationParameters,
)
from kneexo.simulation import simulate
from kneexo.studies.catalogue import STUDIES
from kneexo.studies.controller import controller_study
from kneexo.studies.paper import FIG_12
from kneexo.studies.reproduce import reproduce_study
from kneexo.systems._leaf import NamedLeaf

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = sorted(
    page
    for page in [*ROOT.glob("*.md"), *DOCS.glob("*.md"), *DOCS.glob("tutorials/*.md")]
    if page.name != "README.md" or page.parent == ROOT
)
TUTORIALS = [page for page in PAGES if page.parent.name == "tutorials" and page.stem != "index"]


def cells_of(text):
    """The code of the cells that a page shows, open or folded, without the options of the cells."""
    cells = re.findall(r"^```\{code-cell\}.*?\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    return [re.sub(r"\A(:.*\n)+", "", cell) for cell in cells if "[remove-input]" not in cell]


EXECUTED = [page for page in PAGES if cells_of(page.read_text("utf-8"))]
"""Pages that show their cells: the tutorials, and others whose numbers the build computes."""
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


def test_no_link_of_a_page_is_dead():
    assert [(page.name, dead) for page in PAGES for dead in dead_links(page)] == []


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
    generated = {page.with_suffix("") for page in DOCS.glob("*.rst")}  # from docstrings
    assert pages | generated == listed | {DOCS / "index"}
    # A reader must find a page among the titles. One is moved.md, which goes with the old names.
    assert len(pages - {page.with_suffix("") for page in DOCS.glob("tutorials/*.md")}) <= 26


def test_two_clicks_lead_from_the_first_page_to_every_page():
    def linked(page):
        text = page.read_text("utf-8") if page.suffix == ".md" and page.exists() else ""
        targets = (target.partition("#")[0] for _, target in LINK.findall(text))
        return {(page.parent / target).resolve() for target in targets if "://" not in target}

    first = DOCS / "index.md"
    near = linked(first)
    reached = {first, *near, *(page for neighbour in near for page in linked(neighbour))}
    pages = [page for page in PAGES if DOCS in page.parents]
    assert [page.name for page in pages if page not in reached] == []


GALLERY = (DOCS / "gallery.md").read_text("utf-8")


def test_the_gallery_has_every_figure_with_its_page_and_the_command_that_draws_it():
    entries = re.findall(r"^\[!\[[^]]+\]\((\w+)\.png\)\]\(([\w./]+)", GALLERY, re.MULTILINE)
    assert sorted(name for name, _ in entries) == sorted(p.stem for p in DOCS.glob("*.png"))
    for name, page in entries:
        *_, command = re.findall(r"kneexo (.*?) --out", GALLERY.partition(f"({name}.png)")[0])
        if name in ("leg_tracking", "playground"):
            word = {"leg_tracking": "simulate", "playground": "play"}[name]
            assert command == f"{word} --preset leg"
            continue
        (study,) = (study for study in STUDIES.values() if study.command == command)
        drawn = (ROOT / f"kneexo/studies/{study.name}/figures.py").read_text("utf-8")
        assert f'"{name}": ' in drawn
        shown = "fig13" in name or f"({name}.png)" in (DOCS / page).read_text("utf-8")
        assert shown, page  # tutorial 1 computes the data of Fig. 13 itself


@pytest.mark.slow
def test_the_picture_of_a_run_has_the_words_and_the_size_of_today():
    """`tests/studies/test_shown.py` does the same with the figures of studies."""
    figure = track(Scenario.preset("leg")).plot()[0].figure
    with Image.open(DOCS / "leg_tracking.png") as image:
        assert image.info["Description"] == words_of(figure)
        assert image.size == pytest.approx(150.0 * figure.get_size_inches(), abs=1.0)


@pytest.fixture(scope="module")
def public():
    return module_of("public_names", DOCS / "public_names.py").public_names()


def test_the_reference_lists_what_users_import(public):
    assert "kneexo.analysis.tracking.tracking.track" in public["kneexo.analysis"]
    assert "diagramc.model.compile_diagram" in public["diagramc"]
    assert "kneexo.systems.bldc_pump.BldcPump" in public["kneexo.systems"]
    listed = {name for names in public.values() for name in names}
    assert not [name for name in listed if re.search(r"\.(printer|passes)\.", name)]
    for module, names in public.items():
        for name in names:
            defined_in, _, last = name.rpartition(".")
            assert hasattr(importlib.import_module(module), last), f"{module} has no {last}"
            assert hasattr(importlib.import_module(defined_in), last), name


def functions_of(name):
    """A public function, or methods and initializer of a public class, each with its docstring."""
    module, _, last = name.rpartition(".")
    value = getattr(importlib.import_module(module), last)
    if inspect.isfunction(value):
        yield name, value, value.__doc__
    elif inspect.isclass(value):
        for method, attribute in vars(value).items():
            function = getattr(attribute, "__func__", attribute)
            if inspect.isfunction(function) and method[0] != "_":
                yield f"{name}.{method}", function, inspect.getdoc(function)
            if method == "__init__" and not is_dataclass(value):
                yield name, function, value.__doc__


def untold(function, text):
    """Arguments without a line in the section Parameters, if there are three or more arguments."""
    arguments = list(inspect.signature(function).parameters.values())
    arguments = [a for a in arguments if a.name not in ("self", "cls")]
    _, _, section = inspect.cleandoc(text or "").partition("Parameters\n----------\n")
    told = {name for line in re.findall(r"^\w.*", section, re.M) for name in line.split(", ")}
    named = [a.name for a in arguments if a.kind is not a.VAR_KEYWORD]
    return [n for n in named if n not in told] if len(arguments) >= 3 else []


def test_every_argument_of_a_public_function_is_told(public):
    assert untold(lambda a, b, c: 0, "Text.\n\nParameters\n----------\na, c\n    One.") == ["b"]
    names = {name for names in public.values() for name in names}
    functions = [item for name in sorted(names) for item in functions_of(name)]
    assert len(functions) > 200
    lacking = {name: untold(function, text) for name, function, text in functions}
    assert {name: arguments for name, arguments in lacking.items() if arguments} == {}


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


FIRST_CELL = re.compile(r"^\| (\$.*?\$) \|", re.MULTILINE)


@pytest.mark.parametrize(("page", "least"), [("theory.md", 120), ("transparency.md", 7)])
def test_a_section_uses_the_symbols_of_its_table(page, least):
    text = (DOCS / page).read_text("utf-8")
    sections = re.split(r"^(?=## )", text, flags=re.MULTILINE) if page == "theory.md" else [text]
    count = 0
    for section in sections:
        cells = FIRST_CELL.findall(section)
        symbols = [symbol.strip(" $") for cell in cells for symbol in cell.split(", ")]
        where = text if section.startswith("## Symbols") else section
        body = FIRST_CELL.sub("", where)
        assert [symbol for symbol in symbols if symbol not in body] == [], section[:30]
        count += len(symbols)
    assert count >= least


def test_the_names_of_the_symbols_are_in_the_code():
    code = "\n".join(module.read_text("utf-8") for module in MODULES)
    identifiers = set(re.findall(r"\w+", code))
    rows = re.findall(r"^\| \$.*?\$ \|.*?\|.*?\|(.*)\|$", THEORY, re.MULTILINE)
    names = {name for row in rows for name in re.findall(r"`(\w+)`", row)}
    assert len(names) > 80
    assert sorted(names - identifiers) == []


@pytest.mark.slow
def test_the_short_names_do_what_their_page_shows(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    short = "{simulation: {duration_s: 1}, reference: {frequency_hz: 4, amplitude_deg: 0.5}}\n"
    Path("my.yaml").write_text(short, encoding="utf-8")
    text = (DOCS / "results.md").read_text(encoding="utf-8")
    names, many, *_ = re.findall(r"^```python\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    exec(names)
    assert "phase margin" in capsys.readouterr().out
    exec(many.replace("500", "3"), {})
    assert capsys.readouterr().out.startswith("3 runs, 0 failed\n")
    assert len(Path("batch.csv").read_text(encoding="utf-8").splitlines()) == 4


@pytest.mark.parametrize("tutorial", TUTORIALS, ids=lambda page: page.stem)
def test_a_tutorial_ends_with_a_picture_and_a_number(tutorial):
    text = tutorial.read_text(encoding="utf-8")
    *_, last = cells_of(text)
    assert "plt.subplots" in last
    assert re.search(r"print\(\s*f\"[^\"]*\{", last)
    assert f"{{nb-download}}`{tutorial.stem}.ipynb`" in text


@pytest.mark.parametrize("tutorial", TUTORIALS, ids=lambda page: page.stem)
def test_a_tutorial_folds_its_imports(tutorial):
    first = tutorial.read_text(encoding="utf-8").partition("```{code-cell} ipython3\n")[2]
    options, _, code = first.partition("```")[0].partition("\n\n")
    assert options == ":tags: [hide-input]"
    kinds = ast.Import | ast.ImportFrom
    assert all(isinstance(statement, kinds) for statement in ast.parse(code).body)


def test_the_tutorials_are_executed():
    assert set(TUTORIALS) < set(EXECUTED)


def test_no_code_of_an_executed_page_is_wider_than_its_box():
    code = "\n".join(cell for page in EXECUTED for cell in cells_of(page.read_text("utf-8")))
    assert [line for line in code.split("\n") if len(line) > 100] == []


NUMBER = re.compile(r"(?<![\w.])\d[\d_]*(?:\.\d+)?(?![\w.]*\d)")
WORDS = {"ten thousand": "10_000", "two hundred": "200", "twenty": "20", "ten": "10"}


def numbers(text):
    return {float(number.replace("_", "")) for number in NUMBER.findall(text)}


def computed_part(page):
    """A tutorial, or the sections of another page that have cells: the rest quotes studies."""
    text = page.read_text(encoding="utf-8")
    if page in TUTORIALS:
        return text
    sections = re.split(r"^(?=## )", text, flags=re.MULTILINE)
    return "".join(section for section in sections if "```{code-cell}" in section)


def untold_numbers(text):
    """Numbers of a page that are no input of its cells: in the prose, and in what is printed.

    What a run gives is an expression in an f-string, so a cell computes it when it is read.
    """
    tree = ast.parse("\n".join(cells_of(text)))
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


def test_every_number_of_an_executed_page_comes_from_a_cell():
    untold = {page.stem: untold_numbers(computed_part(page)) for page in EXECUTED}
    assert untold == {page.stem: set() for page in EXECUTED}


def test_a_number_that_no_cell_has_is_seen():
    cell = "```{code-cell} ipython3\ngain = 8e-3\nprint(f'{gain} of 0.25 Hz')\n```\n"
    assert untold_numbers(cell + "By 8 mm it rises to 3.7 deg, in Fig. 12 ten times.") == {
        0.25,
        3.7,
        10.0,
    }


@pytest.fixture(scope="module")
def drawings():
    return module_of("drawings", DOCS / "drawings.py")


@pytest.mark.parametrize(
    "name",
    [
        "mechanism",
        pytest.param("hydraulic_circuit", marks=pytest.mark.slow),
        pytest.param("sample_timing", marks=pytest.mark.slow),
    ],
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


# ------------------------------------------- numbers that take too long for a build of the pages


def unsaid(page, *texts):
    """Which of the texts a page lacks; numbers as the pages print them."""
    printed = (DOCS / page).read_text("utf-8")
    shown = [re.sub(r"e([+-])0", r"e\1", text).replace("°-", "°−") for text in texts]
    return [text for text in shown if text not in printed]


def test_a_number_that_a_page_lacks_is_seen():
    assert unsaid("validation.md", "| pole of the moon |", "1e-09 |") == ["| pole of the moon |"]


def test_what_the_rounding_of_table_1_explains():
    table = RodPolynomialParameters().p_mm_deg
    powers = 70.0 ** np.arange(5, 0, -1)
    digits = [f"{value:.4g}" for value in table[:5]]  # as the paper prints them
    last = [10.0 ** math.floor(math.log10(abs(float(d))) - 3) for d in digits]
    reach, missing = 0.5 * np.dot(last, powers), 38.98 - np.polyval(table, 70.0)
    assert 0.9 < missing / reach < 1.0
    texts = [f"The difference is {missing:.4f} mm.", f"moves x(70°) by at most {reach:.4f} mm"]
    assert unsaid("theory.md", *texts) == []


@pytest.mark.slow
def test_the_validation_has_the_numbers_of_reproduce():
    results = reproduce_study().results()
    table, g4, fig9, fig12 = (results[n] for n in ("table1", "table1_g4", "fig9", "fig12"))
    fig13, scaling, limit = (results[n] for n in ("fig13", "scaling", "speed_limit"))
    at = [list(fig13["frequencies_hz"]).index(f) for f in (0.2, 0.21, 0.22, 0.24)]
    smc = fig12["smc"]
    texts = [
        f"| {table['linkage_rmse_mm']:.5f}, {table['linkage_max_mm']:.5f} mm |",
        f"| {table['x_at_10deg_mm']:.2f}, {table['x_at_70deg_mm']:.2f} mm |",
        f"| {fig9['error_after_1s_mm']:.4f} mm, < 1e-8 mm |",
        f"| {smc['max_error_deg']:.3f}°, {smc['mean_command_change_rpm']:.2f} rpm |",
        f"| {fig12['pid']['max_error_deg']:.3f}° |",
        "| " + " / ".join(f"{fig13['gain'][n]:.3f}" for n in at) + " |",
        f"| {fig13['bandwidth_hz']:.4f} Hz, −{-fig13['phase_at_bandwidth_deg']:.1f}° |",
        f"| × {scaling['gear_3']['ratio']:.3f}, × {scaling['half_amplitude']['ratio']:.3f} |",
        f"| {limit['peak_speed_demand_at_0.1hz_rpm']:.0f} rpm, "
        f"{limit['saturation_from_hz']:.3f} Hz | `kneexo reproduce` (`speed_limit`)",
        f"the SMC commands up to {smc['peak_command_rpm']:.0f} rpm",
        f"by {fig13['gain_spread'][at[2]]:.4f} between the five trials",
        f"| {g4['refit_p_sse_mm2']:.4f} mm², {g4['refit_q_sse_deg2']:.3f} deg² |",
        f"| {g4['refit_p_rmse_mm']:.4f} mm, {g4['refit_q_rmse_deg']:.4f}° |",
    ]
    labels = {
        "smc": "SMC, defaults",
        "pid": "PID as in the paper (P, 5 1/s)",
        "pid_tuned": "PID, tuned",
        "pid_feedforward": "PID, tuned, with reference velocity",
    }
    for name, label in labels.items():
        margins, metrics = linearize_loop(FIG_12[name], knee_angle_deg=40.0).margins(), fig12[name]
        texts.append(
            f"| {label} | {metrics['max_error_deg']:.3f} | "
            f"{metrics['mean_command_change_rpm']:.2f} | {margins.phase_margin_deg:.1f} | "
            f"{1e3 * margins.delay_margin_s:.3g} |"
        )
    assert fig9["final_error_mm"] < 1e-8
    assert unsaid("validation.md", *texts) == []
    loop = linearize_loop(FIG_12["smc"], knee_angle_deg=40.0)
    gain = abs(loop.output_response(100.0)[0])
    texts = [
        f"falls below −3 dB at {loop.bandwidth_hz():.2f} Hz and rises again beyond "
        f"({gain:.2f} at 100 Hz)",
        f"falls below −3 dB at {loop.complementary_sensitivity_bandwidth_hz():.2f} Hz. `kneexo",
    ]
    assert unsaid("frequency_response.md", *texts) == []


def test_the_refits_of_fig_5_over_the_whole_range():
    knee = np.linspace(0.0, 90.0, 901)
    rod = np.polyval(RodPolynomialParameters().p_mm_deg, knee)
    residual = np.polynomial.Polynomial.fit(rod, knee, 5)(rod) - knee
    fits = [rms(fit_polynomials(LINKAGES[name]).q_error_deg) for name in ("G1", "G2", "G3")]
    texts = [f"{fit:.3f}° on {name}" for fit, name in zip(fits, ("G1", "G2", "G3"), strict=True)]
    assert unsaid("validation.md", *texts, f"at the same points, leaves {rms(residual):.3f}°") == []


@pytest.mark.slow(gate=0)
def test_the_page_of_the_controllers_has_the_numbers_of_their_study():
    study = controller_study()
    grid, (_, phi, eta) = study.settings, study.centre
    ten, eighty = grid.lambdas_per_s.index(10.0), grid.lambdas_per_s.index(80.0)

    def settling(name):
        return "…".join(f"{study.values[name][n, phi, eta]:.3g}" for n in (ten, eighty))

    built = {c.lambda_per_s: c for c in study.limit_cycle if c.variant == "as built"}
    exact = {c.lambda_per_s: c for c in study.limit_cycle if c.variant == "exact encoder"}
    assert grid.settling_band_deg == 0.2
    texts = [f"| {claim.cases} | {100 * claim.share:.0f} % |" for claim in study.claims()]
    texts += [
        f"its end in {settling('settling_s')} s",
        f"in {settling('large_settling_s')} s. It is",
        f"of {built[20.0].disk_margin:.4f} at λ = 20 1/s and of {built[10.0].disk_margin:.4f} at",
        f"by {built[20.0].max_error_deg:.1f}° and by {built[10.0].max_error_deg:.1f}°, with an",
        f"encoder by {exact[20.0].max_error_deg:.2f}° and by {exact[10.0].max_error_deg:.1f}°",
    ]
    assert unsaid("controllers.md", *texts) == []


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
            if is_type_variable(node):
                continue
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            documented = isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
            leaves = [leaf for target in targets for leaf in ast.walk(target)]
            named = [n.id for n in leaves if isinstance(n, ast.Name) and not documented]
        else:
            continue
        names += [name for name in named if not name.startswith("_")]
    return names


MODULES = [
    path
    for package in ("diagramc", "kneexo")
    for path in sorted((ROOT / package).rglob("*.py"))
    if path.name == "__init__.py" or not path.name.startswith("_")
]


@pytest.mark.parametrize("part", sorted({path.relative_to(ROOT).parts[:2] for path in MODULES}))
def test_every_public_name_is_documented(part):
    modules = [path for path in MODULES if path.relative_to(ROOT).parts[:2] == part]
    names = [(path.name, undocumented(path.read_text(encoding="utf-8"))) for path in modules]
    assert [entry for entry in names if entry[1]] == []


def test_a_name_without_a_docstring_is_seen():
    source = 'A = 1\n"""One."""\nB: int = 2\n_C = 3\nT = TypeVar("T")\ndef f(): ...\n'
    assert undocumented(source) == ["B", "f"]


def is_type_variable(node):
    call = node.value.func if isinstance(node.value, ast.Call) else None
    return isinstance(call, ast.Name) and call.id in ("TypeVar", "ParamSpec")


def public_names(path):
    """Names that a public module defines, with the methods of its classes, and where they are."""
    parts = path.relative_to(ROOT).with_suffix("").parts
    module = ".".join(parts).removesuffix(".__init__")
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        names = []
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names = [node.name]
        elif isinstance(node, ast.Assign | ast.AnnAssign) and not is_type_variable(node):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            names = [n.id for t in targets for n in ast.walk(t) if isinstance(n, ast.Name)]
        if isinstance(node, ast.ClassDef) and node.name[0] != "_":
            names += [
                f"{node.name}.{method.name}"
                for method in node.body
                if isinstance(method, ast.FunctionDef) and method.name[0] != "_"
            ]
        yield from (f"{module}.{name}" for name in names if name[0] != "_")


def passed_on(package):
    """Classes and functions in the ``__all__`` of a package, where they are."""
    module = importlib.import_module(".".join(package.parent.relative_to(ROOT).parts))
    for name in getattr(module, "__all__", ()):
        value = getattr(module, name)
        if getattr(value, "__name__", "") == name:
            yield f"{value.__module__}.{name}"


@pytest.mark.slow(gate=0)
def test_every_public_name_is_in_the_reference(tmp_path):
    pytest.importorskip("myst_nb", reason="needs pip install '.[docs]'")
    pages = tmp_path / "docs"
    shutil.copytree(DOCS, pages, ignore=shutil.ignore_patterns("_build", "api", "*.md", "*.ipynb"))
    build = [sys.executable, "-m", "sphinx", "-q", "-b", "dummy", "-D", "root_doc=modules"]
    built = subprocess.run([*build, pages, tmp_path / "out"], capture_output=True, text=True)
    assert built.returncode == 0, built.stderr
    environment = pickle.loads((tmp_path / "out/.doctrees/environment.pickle").read_bytes())
    reference = environment.domaindata["py"]["objects"]
    expected = {name for path in MODULES for name in public_names(path)}
    packages = [path for path in MODULES if path.name == "__init__.py"]
    expected |= {name for package in packages for name in passed_on(package)}
    assert len(expected) > 800
    assert sorted(expected - set(reference)) == []
