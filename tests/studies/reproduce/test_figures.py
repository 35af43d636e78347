from kneexo.studies.reproduce.figures import motions


def test_the_view_shows_the_runs_of_fig_12(by_hand):
    shown = motions(by_hand)
    assert list(shown) == [
        "Fig. 12, sliding-mode control",
        "Fig. 12, PID as in the paper (P, 5 1/s)",
    ]
    for (plant, columns), name in zip(shown.values(), ("smc", "pid"), strict=True):
        tracked = by_hand.fig12[name]
        assert plant is tracked.scenario.plant
        assert columns["knee_angle_rad"] is tracked.run["knee_angle_rad"]
        assert columns["time_s"] is tracked.run.time_s
