"""Draw the pages of commands and settings anew: `make docs-reference`."""

from racines_data.files import write_atomic
from tests.reference import PAGES, ROOT

if __name__ == "__main__":
    for name, page in PAGES.items():
        path = ROOT / "docs" / name
        if not path.is_file() or path.read_text() != page():
            write_atomic(path, page())
            print(f"drawn anew: docs/{name}")
