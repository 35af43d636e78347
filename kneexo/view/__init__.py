"""The knee in three dimensions, in a browser: recorded runs as a page, and live runs.

- `mechanism` says where each part is at a knee angle;
- `page` makes one HTML file of recorded runs, with a time slider;
- `live` shows a Drake simulation while it runs.
"""
