"""Shows the knee in three dimensions, live or recorded.

- `mechanism` has the points, bars and pins of leg and linkage.
- `parts` has the shapes and colours of the drawn parts, and the poses of their frames.
- `knee_frames` and `pressure_colour` are the leaf systems of a live view.
- `meshcat_view` adds a live view to a diagram that Drake's Simulator runs.
- `legs` has the runs that a page shows, from scenarios or from files.
- `stage` describes legs as data. ``web/stage.js`` draws and moves these legs in a browser.
- `web_page` assembles one self-contained HTML file with a strict security policy.
- `page` makes one HTML file of runs, with a time slider.
"""
