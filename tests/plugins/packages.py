"""Packages of somebody else, laid down in a folder as pip lays them down."""

from collections.abc import Mapping
from pathlib import Path

Points = Mapping[str, Mapping[str, str]]
"""Entry points: by group, what each name stands for."""


def install(folder: Path, name: str, points: Points) -> Path:
    """Write the metadata of a distribution; on `sys.path` the folder makes it an installed one.

    Returns:
        The file of its entry points.
    """
    info = folder / f"{name}-1.0.dist-info"
    info.mkdir(parents=True, exist_ok=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    lines = [
        f"[{group}]\n" + "".join(f"{key} = {value}\n" for key, value in named.items())
        for group, named in points.items()
    ]
    (info / "entry_points.txt").write_text("\n".join(lines))
    return info / "entry_points.txt"
