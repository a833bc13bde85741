"""The commands `racines phantom from-mesh` and `from-labels`. Heavy imports stand inside."""

from pathlib import Path
from typing import Annotated, Any

import typer

from racines_data.cli import options as opt
from racines_data.terminal import say, say_json

Tissues = Annotated[
    Path, typer.Option(help="YAML of tissues, landmarks and views (docs/own-anatomy.md).")
]


def from_mesh(
    folder: Annotated[Path, typer.Argument(help="Folder of OBJ, PLY, STL or VTK surfaces.")],
    tissues: Tissues,
    out: opt.OwnOut = None,
    as_json: opt.AsJson = False,
) -> None:
    """Make a phantom of closed surfaces, and of a heart's phases one that beats.

    Rims are closed where the YAML names them; what else is open is refused.
    """
    from racines_data.own import make

    _tell(make.from_mesh(folder, tissues, _folder(out, tissues)), out, as_json)


def from_labels(
    file: Annotated[Path, typer.Argument(help="Label map, NIfTI with its affine.")],
    tissues: Tissues,
    out: opt.OwnOut = None,
    as_json: opt.AsJson = False,
) -> None:
    """Make a phantom of a label map."""
    from racines_data.own import make

    _tell(make.from_labels(file, tissues, _folder(out, tissues)), out, as_json)


def _folder(out: Path | None, tissues: Path) -> Path:
    from racines_data.own.sheet import read_sheet
    from racines_data.phantom.saved import FOLDER

    return out or FOLDER / read_sheet(tissues).head.name


def _tell(told: dict[str, Any], out: Path | None, as_json: bool) -> None:
    from racines_data.phantom.saved import FOLDER

    if as_json:
        say_json(told, indent=2)
        return
    for part in told["parts"]:
        caps = ", ".join(
            f"{name} closed over {n} rim edges" for name, n in part.get("caps", {}).items()
        )
        made = "synthetic" if part["synthetic"] else caps
        say(f"{part['name']:24} {part['ml']:8.1f} mL  {made}".rstrip())
    for view, grade in told["shown"].items():
        say(f"view {view}: grade {grade:.1f} at its pose")
    say(f"written: {out or FOLDER / told['name']}")
