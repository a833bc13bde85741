"""Commands of other packages: `racines NAME …` by entry point of the group `racines.commands`.

    [project.entry-points."racines.commands"]
    hello = "my_package.hello:hello"        # a function for typer, or a typer.Typer

A command's module is imported when the command is called, so a broken one harms no other.
"""

from typing import Any

import typer

from racines_data.plugins import Plugins

COMMANDS = Plugins("command", "racines.commands", or_give="")
_PASS_ON = {"allow_extra_args": True, "ignore_unknown_options": True, "help_option_names": []}


def register(app: typer.Typer) -> None:
    """Add the installed commands to the root; ours keep their names."""
    taken = {each.name for each in (*app.registered_commands, *app.registered_groups)}
    for name, point in COMMANDS.points().items():
        if name in taken:
            continue
        about = f"Of another package ({point.value})."
        app.command(name, help=about, context_settings=dict(_PASS_ON))(_call)


def _call(context: typer.Context) -> Any:
    name = str(context.info_name)
    made = COMMANDS.load(name)
    if not isinstance(made, typer.Typer):
        function, made = made, typer.Typer(add_completion=False)
        made.command()(function)
    command = typer.main.get_command(made)
    return command.main(context.args, prog_name=f"racines {name}", standalone_mode=False)
