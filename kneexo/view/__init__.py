"""Recorded runs in three dimensions, in a browser.

- `legs` takes a scenario or the files of an earlier run;
- `page` makes one HTML file of them, with a time slider.

A Drake simulation while it runs: `kneexo.view.meshcat_view`.
"""
