"""The command `racines study sheet`. Heavy imports stand inside, so that --help is instant."""

from pathlib import Path
from typing import Annotated

import typer

from racines_data.cli import options as opt


def sheet(
    out: opt.OutFile = Path("docs/images/contact_sheet.png"),
    anatomy: Annotated[str, typer.Option(help="Name of an anatomy.")] = "heart",
    anatomy_seed: Annotated[int, typer.Option(help="0 is the canonical organ.")] = 0,
    seed: opt.DrawSeed = 0,
) -> None:
    """Draw a contact sheet: every view at falling grades, and `Random` scans."""
    from racines_data.phantom import Phantom, PhantomConfig
    from racines_data.phantom.figures import contact_sheet

    contact_sheet(Phantom(PhantomConfig(anatomy=anatomy, anatomy_seed=anatomy_seed)), out, seed)
    typer.echo(f"wrote {out}")
