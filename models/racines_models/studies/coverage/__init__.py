"""Coverage: how often the interval of a score contains what it is an interval of.

`population` holds the figures of real methods on a dataset's trajectories; `simulation` draws
studies from them and counts; `report` writes the table that intervals are printed with.
"""
