"""The command `racines study processors`: does every processor draw the same phantom?"""

from racines_data.cli import options as opt
from racines_data.errors import RacinesError
from racines_data.terminal import say_json, say_page


def processors(out: opt.OwnOutFile = None, as_json: opt.AsJson = False) -> None:
    """Draw the phantom's canonical frames and compare them with those that other processors drew.

    Exit 1 where two sets differ by more than processors may. PyTorch chooses its instructions once
    a process: ATEN_CPU_CAPABILITY=default, avx2 or avx512 before the command chooses others. With
    --out the sets on record are written with the one drawn here.
    """
    from racines_leaderboard.determinism import processors as study

    found = study.read_record()
    here = study.draw(found)
    report = study.compare_all(found, here)
    if out is not None:
        study.write_record(found.with_drawing(here), out)
    if as_json:
        say_json(report)
    else:
        say_page(study.processors_markdown(report))
    if not report["holds"]:
        limit = report["tolerance"]
        raise RacinesError(
            f"canonical frames differ by more than processors may ({limit['levels']} gray levels, "
            f"{limit['beyond_in_a_frame']} pixels of a frame by more than one, "
            f"{limit['share']:.2%} of all pixels): other code drew them"
        )
