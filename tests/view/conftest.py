"""A page with a stage, in a browser."""

import numpy as np
import pytest

from kneexo.view.stage import STAGE_SCRIPTS, STAGE_STYLES, stage_leg
from kneexo.view.web_page import self_contained_page, web_text

RATING_PA = 3.5e6


def stage_page(linkages, runs, *, flat=False, trace=True):
    """A page with a stage of these linkages and runs.

    A run has time, angle, reference, pressure, and perhaps angle and torque of a wearer.
    """
    names = ("time", "angle", "reference", "pressure", "wearer", "torque")
    legs = [stage_leg(f"leg {k}", link, -0.05, 1.6, RATING_PA) for k, link in enumerate(linkages)]
    data = {
        "stage": {"flat": flat, "trace": trace, "legs": legs},
        "runs": [dict(zip(names, map(np.ndarray.tolist, run), strict=False)) for run in runs],
    }
    script = """
    const read = (id) => JSON.parse(document.getElementById(id).textContent);
    window.stage = new Stage(document.getElementById("s"), read("stage"));
    read("runs").forEach((run, index) => stage.setRun(index, run));
    """
    scripts = [*map(web_text, STAGE_SCRIPTS), script]
    body = '<main><h1>t</h1><div id="s"></div></main>'
    return self_contained_page("t", body, list(map(web_text, STAGE_STYLES)), scripts, data)


@pytest.fixture
def stage(browser, tmp_path):
    """``stage(linkages, runs, size=…, phone=…, motion=…, **options)``, which opens a page."""

    def open_page(linkages, runs, size=(1440, 1000), phone=False, motion=False, **options):
        page = tmp_path / "stage.html"
        page.write_text(stage_page(linkages, runs, **options), encoding="utf-8")
        browser.open(page, *size, phone=phone, motion=motion)
        browser.wait_for("stage.legs.length > 0")
        return browser

    return open_page
