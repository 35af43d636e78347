"""The first picture of the README, `docs/playground.png`, shows the page to play with as it is now.

After a change of the page, ``python tests/page/test_playground_picture.py`` takes the picture
again.
"""

from __future__ import annotations

import io
import time
import typing
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import kneexo as kx

PICTURE = Path(__file__).parents[2] / "docs/playground.png"
WIDTH, HEIGHT = 1400, 1060
"""Size of the window in CSS pixels."""

MOMENT_S = 7.5
"""Time of the run that the picture shows: the knee bends and the error is large."""


def picture(browser: typing.Any, folder: Path) -> Image.Image:
    """The page of the preset ``leg`` when all numbers are there, paused at `MOMENT_S`."""
    page = kx.play(kx.Scenario.preset("leg"), names=["preset leg"]).write(folder / "knee.html")
    browser.call("Emulation.setScrollbarsHidden", hidden=True)
    browser.open(page, width=WIDTH, height=HEIGHT, motion=True)
    text = "document.querySelector('#numbers').textContent"
    browser.wait_for(f"/Phase margin\\s*[0-9.]+\\s*deg/.test({text})")
    play = "document.querySelector('#stage .play').textContent"
    browser.wait_for(f"{play}.includes('Pause')")  # the whole run may come after the margins
    browser.evaluate(
        f"""(async () => {{
          document.querySelector("#stage .play").click();
          const slider = document.querySelector("#stage .stage-bar input[type=range]");
          slider.value = {MOMENT_S};
          slider.dispatchEvent(new Event("input", {{ bubbles: true }}));
        }})()"""
    )
    pixels = at_rest(browser)
    browser.call("Emulation.setScrollbarsHidden", hidden=False)
    return Image.fromarray((255.0 * pixels).round().astype(np.uint8))


def at_rest(browser: typing.Any) -> np.ndarray:
    """The picture of a page when it has been the same for 6 s: the sweep has ended."""
    pictures = [browser.picture()]
    while len(pictures) < 4 or any(not np.array_equal(pictures[-1], p) for p in pictures[-4:-1]):
        assert len(pictures) < 120, "the page moves for 4 min"
        time.sleep(2.0)
        pictures.append(browser.picture())
    return pictures[-1]


def as_file(image: Image.Image) -> bytes:
    """The picture as PNG with 256 colours, among them the rare ones."""
    file = io.BytesIO()
    image.quantize(256, Image.Quantize.FASTOCTREE).save(file, "PNG", optimize=True)
    return file.getvalue()


def coarse(image: Image.Image) -> np.ndarray:
    """Grey values from 0 to 1 in squares of 20 px, which differ little between fonts."""
    size = image.width // 20, image.height // 20
    return np.asarray(image.convert("L").resize(size, Image.Resampling.BOX)) / 255.0


def test_the_picture_is_small():
    assert PICTURE.stat().st_size < 250_000
    with Image.open(PICTURE) as image:
        assert image.size == (WIDTH, HEIGHT)


@pytest.mark.slow(gate=0)  # fonts of the machine
def test_the_picture_shows_the_page_of_today(browser, tmp_path):
    now = coarse(picture(browser, tmp_path))
    with Image.open(PICTURE) as image:
        shown = coarse(image)
    assert np.abs(now - shown).mean() < 0.02
    assert np.abs(now - np.roll(shown, 5, axis=0)).mean() > 0.04  # a shifted page is seen


if __name__ == "__main__":
    import sys
    import tempfile

    tests = Path(__file__).parents[1]
    sys.path[:0] = [str(tests), str(tests / "shared")]
    from conftest import _Browser

    with tempfile.TemporaryDirectory() as folder:
        browser = _Browser(folder)
        try:
            PICTURE.write_bytes(as_file(picture(browser, Path(folder))))
        finally:
            browser.close()
