"""Names of the tasks; imports nothing heavy.

`SC` is the one heart's, `SC-patients` and `SC-beating` any patient's, `abdomen-KLX` an organ's.
"""

from racines_data.views import HEART, VIEWS

HEART_TIER, PATIENTS, BEATING = "heart", "patients", "beating"
TIERS = (HEART_TIER, PATIENTS, BEATING)
"""One still heart, which training and test share; still patients; patients that beat and breathe.
"""
ANY_VIEW = "AnyView"
"""In place of a view: the goal is drawn for each episode, and observed."""
REPLAY_ID = "racines/Replay-v0"
"""The Gymnasium id of recordings alone, whatever they show."""
GOALS = (*VIEWS, ANY_VIEW)
"""What a task on patients may look for."""


def task_name(view: str, anatomy: str = HEART, tier: str = HEART_TIER) -> str:
    """Return a task's name: the view, with organ and tier where they are not the one heart's."""
    organ = anatomy.replace("\\", "/").rstrip("/").rpartition("/")[2]  # of a folder, its name
    name = view if anatomy == HEART else f"{organ}-{view}"
    return name if tier == HEART_TIER else f"{name}-{tier}"


def tier_of(name: str) -> str:
    """Return the tier of a task's name."""
    tier = name.rpartition("-")[2]
    return tier if tier in TIERS[1:] else HEART_TIER


def task_id(view: str, anatomy: str = HEART, tier: str = HEART_TIER) -> str:
    """Return the Gymnasium id of a task."""
    return f"racines/{task_name(view, anatomy, tier)}-v0"
