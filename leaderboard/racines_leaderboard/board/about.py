"""What each board asks, in one sentence, for its heading on every page."""

_ONE_HEART = (
    "One simulated heart, the same in training and test, at the settings of the profile {profile}: "
    "draw its images, or find a view of it. A figure here says nothing of another heart."
)
ABOUT = {
    "patients": "Find a view of the heart on patients whom nobody trained on; hearts are still.",
    "beating": "The same search while hearts beat and chests breathe.",
    "phantom-default": _ONE_HEART.format(profile="default"),
    "phantom-reference": _ONE_HEART.format(profile="reference"),
    "echo-rotation": "Draw held-out turns of one recorded real heart: n = 1 patient.",
    "echo-interpolation": "The same of turns in narrow blocks, close to those of training.",
    "trackerless": "Estimate the motion of the probe from images alone.",
    "trackerless-rotation": "The same of turns about the apex of one recorded real heart: angles.",
    "trackerless-tracked": "The same of two recorded sweeps of phantoms, tracked in millimetres.",
}
_UNKNOWN = "Results on one dataset."


def about(board: str) -> str:
    """Return what a board asks; of an unknown one, that it is of one dataset."""
    return ABOUT.get(board, _UNKNOWN)
