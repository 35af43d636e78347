"""The block diagram of a scenario, against the connections of the loop in words."""

import re

import pytest

from kneexo.parameters import EncoderParameters, Scenario, SlidingModeParameters
from kneexo.parameters.paths import changed
from kneexo.view.block_diagram import block_diagram


def law(rod_extension, estimated_state, rod_reference, gain=5.0):
    return gain * (rod_reference[0] - rod_extension) - estimated_state[1]


LEG = Scenario.preset("leg")
PLANT = {"motor-cylinder", "cylinder-motor", "cylinder-knee", "knee-encoder", "encoder-coordinates"}
LOAD = {"knee-load", "load-cylinder"}
SMC = {"reference-rod_reference", "rod_reference-law", "estimator-law", "coordinates-estimator"}
BUS = {"law-drive", "drive-can_bus", "can_bus-motor"}
WEARER = {"reference-wearer", "wearer-cuff", "cuff-wearer", "cuff-load", "knee-cuff"}
WEARER |= {"cylinder-cuff", "cylinder-load_cell"}
PID = {"controller": {"kind": "pid"}}
CASES = {
    "paper": (Scenario(), PLANT | SMC | {"law-motor"}),
    "leg": (LEG, PLANT | LOAD | SMC | BUS),
    "PID": (
        changed(LEG, PID),
        (PLANT | LOAD | SMC | BUS | {"reference-law", "coordinates-law"})
        - {"estimator-law", "coordinates-estimator"},
    ),
    "exact states": (
        changed(LEG, {"estimator": {"kind": "exact"}}),
        (PLANT | LOAD | SMC | BUS | {"cylinder-law"}) - {"estimator-law", "coordinates-estimator"},
    ),
    "wearer": (changed(LEG, {"wearer": {"kind": "leg"}}), PLANT | LOAD | SMC | BUS | WEARER),
    "function": (LEG.with_law(law), PLANT | LOAD | SMC | BUS | {"coordinates-law"}),
}


@pytest.fixture(
    params=[pytest.param(c, marks=[pytest.mark.slow] if c != "PID" else []) for c in CASES],
    scope="module",
)
def drawn(request):
    """A block diagram, and the connections that it must have."""
    scenario, wires = CASES[request.param]
    figure = block_diagram(scenario)
    figure.canvas.draw()
    return figure, wires


def blocks_of(figure):
    return {p.get_gid(): p for p in figure.axes[0].patches if p.get_gid()}


def labels_of(figure):
    """The texts beside the wires."""
    return [t for t in figure.axes[0].texts if t.get_bbox_patch() is not None and t.get_text()]


def test_the_wires_are_those_of_the_loop(drawn):
    figure, wires = drawn
    arrows = {text.get_gid() for text in figure.axes[0].texts if text.get_gid()}
    assert arrows == wires
    assert set(blocks_of(figure)) == {name for wire in wires for name in wire.split("-")}


def test_no_label_covers_a_block_or_another_label_or_is_cut_off(drawn):
    figure, wires = drawn
    labels = [(text.get_text(), text.get_window_extent()) for text in labels_of(figure)]
    assert len(labels) == len(wires)
    blocks = [block.get_window_extent() for block in blocks_of(figure).values()]
    for index, (name, box) in enumerate(labels):
        others = [other for _, other in labels[:index]]
        assert not [o for o in blocks + others if box.overlaps(o)], name
    for text in figure.axes[0].texts:
        box = text.get_window_extent()
        inside = figure.bbox.x0 <= box.x0 <= box.x1 <= figure.bbox.x1
        assert inside, text.get_text()
        assert figure.bbox.y0 <= box.y0 <= box.y1 <= figure.bbox.y1, text.get_text()


def test_no_wire_runs_through_a_block(drawn):
    figure, _ = drawn
    axes = figure.axes[0]
    for line in axes.lines:
        for block in blocks_of(figure).values():
            low, high = block.get_bbox().min, block.get_bbox().max
            middle = line.get_xydata().mean(axis=0)
            assert not ((low < middle) & (middle < high)).all()


def test_text_is_legible_on_a_phone(drawn):
    figure, _ = drawn
    scale = 390.0 / (72.0 * figure.get_size_inches()[0])  # CSS pixels a point
    assert min(text.get_fontsize() for text in figure.axes[0].texts) * scale >= 7.0


@pytest.mark.slow
def test_signals_have_names_symbols_and_units():
    figure = block_diagram(LEG)
    texts = {text.get_text() for text in labels_of(figure)}
    assert "load_force\n$F_L$ (N)" in texts
    assert "knee_angle $\\theta_p$ (rad)\nmoment_arm $r$ (m)" in texts
    assert [t for t in texts if t.startswith("encoder_reading")]
    assert not [t for t in texts if re.match(r"[yu]\d*\b", t)]  # ports of Drake's primitives
    assert figure.get_label().endswith(".")


@pytest.mark.slow
def test_the_words_in_the_blocks_follow_the_parameters():
    encoder = EncoderParameters(counts_per_revolution=720)
    control = SlidingModeParameters(sample_time_s=0.001)
    pump = {"plant.pump.lag_s": 0.02, "plant.pump.speed_limit_rad_s": 104.71975511965978}
    scenario = changed(Scenario(encoder=encoder, controller=control), pump)
    figure = block_diagram(scenario)
    texts = [text.get_text() for text in figure.axes[0].texts]
    for words in (
        "counts of 0.500°",
        "microcontroller, every 1 ms",
        "20 ms, ±1000 rpm",
        "sliding mode",
        "reduced order",
        "observer, 20 ms",
    ):
        assert words in texts


@pytest.mark.slow
def test_equal_scenarios_give_equal_drawings():
    texts = []
    for _ in range(2):
        figure = block_diagram(Scenario())
        texts.append([(t.get_text(), t.get_position()) for t in figure.axes[0].texts])
    assert texts[0] == texts[1]
