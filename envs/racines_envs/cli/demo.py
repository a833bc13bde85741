"""The command `racines demo`. Heavy imports stand inside."""

from pathlib import Path
from typing import Annotated

import typer

from racines_data.cli import options as opt
from racines_data.terminal import note, say, say_json


def demo(
    patient: Annotated[
        int | None, typer.Option(help="Seed of a test patient.  [default: drawn by --seed]")
    ] = None,
    view: opt.View = None,
    tier: opt.Tier = None,
    seed: Annotated[
        int | None, typer.Option(min=0, help="Seed of what is drawn by chance.")
    ] = None,
    out: opt.OwnOut = None,
    live: Annotated[bool, typer.Option("--live", help="Play in the terminal as well.")] = False,
    force: opt.Force = False,
    as_json: opt.AsJson = False,
) -> None:
    """Watch the published agent find a view in a patient that it never saw.

    Writes demo/index.html, a page, and demo/demo.gif, or into --out. Without --seed patient and
    start are drawn by chance, and the command that repeats them is printed. By default A4C in a
    beating heart. That the agent does not find the view is a result, and no error.
    """
    from racines_envs.demo.episode import drawn, load_servo, verdict
    from racines_envs.demo.run import check_folder, demonstrate, next_commands

    folder = out or Path("demo")
    check_folder(folder, force)
    draw, agent = drawn(patient, seed, view, tier), load_servo()
    tell = note if as_json else say
    tell(f"{draw.view}, patient {draw.patient} of the test split, {draw.tier}")
    tell(f"again: {draw.again}")
    if live:
        from racines_envs.demo.live import LiveView

        with LiveView() as screen:
            outcome = demonstrate(draw, agent, folder, screen)
    else:
        outcome = demonstrate(draw, agent, folder)
    if as_json:
        return say_json(outcome.told, indent=2)
    for line in ("", *verdict(outcome), "", f"Open {folder / 'index.html'} in a browser.", ""):
        say(line)
    say("Try next:")
    for command, about in next_commands(draw):
        say(f"  {command}")
        say(f"      {about}")
