"""The page to play with: sliders, faults and modules of a scenario, and the page itself."""
