"""Draw the figures of all pages anew: `make docs-numbers`."""

import sys

from tests.prose.markers import ROOT, NoFigure, redraw

if __name__ == "__main__":
    try:
        changed = redraw()
    except NoFigure as error:
        sys.exit(str(error))
    for path in changed:
        print(f"drawn anew: {path.relative_to(ROOT)}")
