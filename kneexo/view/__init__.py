"""Shows the knee in three dimensions, live or recorded.

- `mechanism` has the points, bars and pins of leg and linkage.
- `parts` has the shapes, colours and poses of the drawn parts.
- `knee_frames` and `pressure_colour` are the leaf systems of a live view.
- `meshcat_view` adds a live view to a diagram that Drake's Simulator runs.
- `legs` has the runs that a page shows, from scenarios or from files.
- `page` makes one HTML file of runs, with a time slider.
"""
