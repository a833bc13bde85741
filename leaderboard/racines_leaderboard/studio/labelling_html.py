"""What the study's page shows: the image on black, how far the rater is, and what comes after."""

from racines_leaderboard.expert.kit import Kit
from racines_leaderboard.studio.escape import text
from racines_leaderboard.studio.labelling import Sitting
from racines_leaderboard.studio.pictures import ultrasound


def instructions_html(kit: Kit) -> str:
    """Return what a kit tells its raters."""
    document = kit.document
    views = "".join(
        f"<li><strong>{text(view['name'])}</strong>, {text(view['title'])}</li>"
        for view in document["views"]
    )
    return (
        f'<div class="rc-note"><p>{text(document["preface"], 2000)}</p>'
        f"<p>{text(document['instructions'], 4000)}</p><ul>{views}</ul></div>"
    )


def image_html(sitting: Sitting) -> str:
    """Return the image to be judged; its name is not shown, for the address tells nothing else."""
    if sitting.image is None:
        return ""
    png = Kit.open(sitting.kit).image_path(sitting.image).read_bytes()
    return ultrasound(png, f"image {sitting.done + 1} of {sitting.total}")


def progress_html(sitting: Sitting) -> str:
    """Return how far a rater is, in words and as a bar."""
    share = 100 * sitting.done / max(sitting.total, 1)
    told = f"{sitting.done} of {sitting.total} images answered · {sitting.rater}"
    return (
        f'<div class="rc-note"><p>{text(told)}</p>'
        f'<div class="rc-bar"><div style="width:{share:.1f}%"></div></div></div>'
    )


def code_html(sitting: Sitting) -> str:
    """Return the code with which a rater can go on another time."""
    return (
        '<p class="rc-note rc-code">To go on another time: name '
        f"<code>{text(sitting.rater)}</code>, code <code>{text(sitting.code)}</code>. "
        "Write both down; nobody can find the code again.</p>"
    )


def finished_html(sitting: Sitting) -> str:
    """Return thanks, and how the ratings are scored."""
    file = f"{sitting.ratings.name}/{sitting.rater}.jsonl"
    command = f"racines expert score {sitting.kit.name} {file}"
    return (
        f'<div class="rc-done"><p>All {sitting.total} images have an answer. Thank you.</p>'
        f"<p>The ratings are in <code>{text(file)}</code>; whoever holds the key scores them "
        f"with <code>{text(command)}</code>.</p></div>"
    )
