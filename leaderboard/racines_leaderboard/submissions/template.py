"""A submission.yaml to fill in, with the digests of the files that lie beside it."""

import json
from pathlib import Path

from racines_data.errors import RacinesError
from racines_data.files import write_atomic
from racines_leaderboard.submissions.document import ALL, KINDS, NAME, YAML, measure, opened
from racines_leaderboard.submissions.worlds import made_for

TEXT = """\
# Every line that is no comment is needed. What the fields mean: docs/submit.md
schema: racines.submission/2
name: {name}                # a-z 0-9 and dashes
track: {track}
authors: [YOUR NAME]
method: A FEW WORDS FOR THE TABLE
description: >-
  A FEW SENTENCES.
licence: Apache-2.0
# url: https://example.org
# paper: https://example.org
tier: recomputed             # the tier asked for; self-reported if nothing can be scored again
dataset:
  source: {source}
  version: {version}
  digest: "{digest}"   # its content or recipe digest
seeds: [0]                   # of the training
code: {{url: "https://example.org/REPOSITORY", commit: "0000000"}}
training:
  budget: IMAGES OR STEPS SEEN
  hardware: WHAT IT RAN ON
  # images: 24000            # that one training saw, repeats counted
  # steps: 200000            # of environments, that one training took
  # hours: 1.5               # of one training, on that hardware
artefacts:
{artefacts}"""
ENTRY = """\
  - kind: {kind}
    path: {path}
    sha256: "{sha256}"
    size: {size}
"""


def write_template(folder: Path, track: str) -> Path:
    """Write a new submission.yaml into a folder, with an entry for each file that may be one.

    What the files say that they were made for is filled in.
    """
    if track not in ALL:
        raise RacinesError(f"track {track!r}: choose {', '.join(ALL[:-1])} or {ALL[-1]}")
    path = folder / YAML
    if path.exists():
        raise RacinesError(f"{path}: is there already: edit it, or remove it")
    told = {"source": "phantom", "version": "1.0.0", "digest": "0" * 64}
    endings = {kind.suffix for kind in KINDS.values()} - {""}
    entries = ""
    for file in sorted(folder.iterdir()) if folder.is_dir() else ():
        if file.suffix in endings and file.is_file() and NAME.fullmatch(file.name):
            with opened(folder, file.name, str(folder)) as stream:
                sha256, size = measure(stream, str(file))
            kind = _kind(file, track)
            told |= made_for(file, kind, track)
            entries += ENTRY.format(kind=kind, path=file.name, sha256=sha256, size=size)
    blank = ENTRY.format(kind="KIND", path="FILE", sha256="0" * 64, size=1)
    name = folder.resolve().name.lower().replace("_", "-")
    text = TEXT.format(name=name, track=track, artefacts=entries or blank, **told)
    write_atomic(path, text)
    return path


def _kind(path: Path, track: str) -> str:
    """Guess a file's kind by its ending and, where two share one, by what it says of itself."""
    if path.suffix == ".json":
        try:
            said = json.loads(path.read_text(encoding="utf-8")).get("schema", "")
        except (ValueError, AttributeError, RecursionError):
            said = ""
        return "trace" if str(said).startswith("racines.trace/") else "scores"
    for name, kind in KINDS.items():
        if kind.suffix == path.suffix and track in kind.tracks:
            return name
    raise RacinesError(f"{path}: no artefact of {track}: put it elsewhere")
