"""A judge's architecture, a format, and a command."""

from racines_models.judges.grader.model import Grader


class Tiny(Grader):
    architecture = "tiny"


def export(root, out, split=None, limit=None, progress=False):
    out.mkdir()
    return {"out": str(out), "frames": 1, "trajectories": 1, "format": "names"}


def greet(name: str, loud: bool = False) -> None:
    print(f"hello {name}{'!' if loud else ''}")
