"""Names that the parts of a study share."""

EXPERT = "expert"
"""A person who says to be one; the only kind of rater that gets to a board."""
MACHINES = ("simulated", "oracle", "grader")
"""Programs that rate."""
KINDS = (EXPERT, "trial", *MACHINES)
"""Who rates: an expert, somebody who tries the kit out, or a program."""
TRUE_FRAMES = "true-frames"
"""The system that shows the dataset's own frames."""
OVERALL = "overall"
"""All generators' images together, in a report."""
