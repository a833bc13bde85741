"""Names of the tasks: `SC` is the heart's, `abdomen-KLX` another organ's. Imports nothing heavy."""

from racines_data.views import HEART


def task_name(view: str, anatomy: str = HEART) -> str:
    """Return the name of a task: the view, after the organ's name where that is not the heart."""
    return view if anatomy == HEART else f"{anatomy}-{view}"


def task_id(view: str, anatomy: str = HEART) -> str:
    """Return the Gymnasium id of a task."""
    return f"racines/{task_name(view, anatomy)}-v0"
