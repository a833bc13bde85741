"""The whole report of `racines doctor`, and its page."""

import textwrap
from collections.abc import Iterator
from importlib.metadata import version
from typing import Any

from racines_leaderboard.doctor import files, installed, machine

WIDTH = 79
_LABEL = 13  # letters of a line's name, and what follows


def examine(full: bool = False) -> dict[str, Any]:
    """Return what is here, what is broken, and what to run next.

    With `full` the published weights are hashed, not only measured. `problems` holds `what`,
    `problem` and `remedy` of all that is broken: empty where all is well.
    """
    report: dict[str, Any] = {
        "schema": "racines.doctor/1",
        "racines": version("racines"),
        "python": installed.python(),
        "packages": installed.packages(),
        "extras": installed.extras(),
        "machine": machine.machine(),
        "confinement": machine.confinement(),
        "datasets": files.datasets(),
        "weights": files.weights(full),
    }
    report["problems"] = list(_problems(report))
    report["next"] = list(_next(report))
    return report


def _problems(report: dict[str, Any]) -> Iterator[dict[str, str]]:
    """Yield what is broken, with its remedy."""
    if not report["python"]["fits"]:
        told = f"{report['python']['version']} is outside {report['python']['asked']}"
        yield {"what": "Python", "problem": told, "remedy": "make an environment with one inside"}
    for each in report["packages"]:
        if not each["fits"]:
            here = each["version"]
            told = "missing" if here is None else f"{here} is outside the tested {each['asked']}"
            remedy = f'pip install "{each["name"]}{each["asked"]}"'
            yield {"what": each["name"], "problem": told, "remedy": remedy}
    for place in (*report["datasets"], report["weights"]):
        for each in place["broken"]:
            yield {"what": each["file"], "problem": each["problem"], "remedy": each["remedy"]}


def _next(report: dict[str, Any]) -> Iterator[str]:
    """Yield commands that make sense now."""
    if report["problems"]:
        yield "racines doctor, once the problems above are solved"
        return
    if not report["datasets"]:
        yield "racines data build --profile smoke"
    else:
        yield f"racines data validate {report['datasets'][0]['root']}"
    if report["weights"]["files"]:
        yield "racines demo"
        yield "racines weights list"
    yield "racines leaderboard"


def page(report: dict[str, Any]) -> str:
    """Return the report as text of at most 79 letters a line, where paths allow it."""
    here, seen = report["machine"], report["python"]
    memory = "unknown" if here["memory"] is None else f"{here['memory'] / 2**30:.1f} GiB"
    parts = [
        _line("racines", report["racines"]),
        _line("Python", f"{seen['version']} (tested: {seen['asked']})"),
        _line("packages", _packages(report["packages"])),
        *_extras(report["extras"]),
        _line("processor", here["cpu"]),
        _line("", f"{here['instructions']}, {here['cores']} cores, {memory} of memory"),
        _line("CUDA", here["cuda"]["told"]),
        _line("confinement", _confinement(report["confinement"])),
        *_datasets(report["datasets"]),
        _line("weights", _weights(report["weights"])),
        "",
        *_told_problems(report["problems"]),
        *(_line("Next" if not i else "", each) for i, each in enumerate(report["next"])),
    ]
    return "\n".join(parts)


def _line(name: str, told: str) -> str:
    """Return a named line, wrapped under itself; words and paths are not broken."""
    lines = textwrap.wrap(
        told, WIDTH - _LABEL, break_long_words=False, break_on_hyphens=False
    ) or [""]  # fmt: skip
    first, rest = f"{name:<{_LABEL}}{lines[0]}", (" " * _LABEL + each for each in lines[1:])
    return "\n".join(each.rstrip() for each in (first, *rest))


def _packages(packages: list[dict[str, Any]]) -> str:
    fit = sum(each["fits"] for each in packages)
    told = "all inside" if fit == len(packages) else f"{fit} inside"
    named = ", ".join(
        f"{each['name']} {each['version'] or 'missing'}"
        for each in packages
        if each["name"] in installed.KEY or not each["fits"]
    )
    return f"{len(packages)}, {told} the tested ranges: {named}"


def _extras(extras: list[dict[str, Any]]) -> Iterator[str]:
    usable = ", ".join(each["name"] for each in extras if each["usable"])
    yield _line("extras", f"usable: {usable or 'none'}")
    for each in extras:
        if not each["usable"]:
            lacking = each["lacking"]
            some = ", ".join(lacking[:3]) + (f" and {len(lacking) - 3} more" * (len(lacking) > 3))
            yield _line("", f"{each['name']} lacks {some}: {each['install']}")


def _confinement(told: dict[str, Any]) -> str:
    if told["available"]:
        return "available: others' files are opened in a confined process"
    return f"not available ({told['why']}): others' files need --unconfined, which trusts them"


def _datasets(datasets: list[dict[str, Any]]) -> Iterator[str]:
    if not datasets:
        yield _line("datasets", "none in data/")
    for i, each in enumerate(datasets):
        state = f"{len(each['broken'])} files broken" if each["broken"] else "sizes as recorded"
        told = f"{each['root']}: {each['what']}, {each['files']} files, "
        told += f"{each['bytes'] / 1e6:.1f} MB, {state}"
        yield _line("" if i else "datasets", told)
    if datasets:
        yield _line("", "checked in full by: racines data validate FOLDER")


def _weights(told: dict[str, Any]) -> str:
    if not told["files"] and not told["broken"]:
        return "none here: they come with a checkout of the repository"
    how = "hashes" if told["full"] else "sizes"
    state = f"{len(told['broken'])} files broken" if told["broken"] else f"{how} as published"
    more = "" if told["full"] else "; all hashes: racines doctor --full"
    return (
        f"{told['sets']} sets, {told['files']} files, {told['bytes'] / 1e6:.1f} MB, {state}{more}"
    )


def _told_problems(problems: list[dict[str, str]]) -> Iterator[str]:
    if not problems:
        yield "Nothing is broken."
        return
    yield f"{len(problems)} broken:"
    for each in problems:
        told = f"{each['what']}: {each['problem']}"
        yield textwrap.fill(told, WIDTH, initial_indent="  ", subsequent_indent="    ",
                            break_long_words=False, break_on_hyphens=False)  # fmt: skip
        yield f"    {each['remedy']}"
