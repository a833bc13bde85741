"""What the site does beside its plugins: links from notebooks to pages, which those leave alone."""

import logging
import posixpath
import re
from typing import Any

LINK = re.compile(r'href="(?!https?:|#)([^"#]+\.(?:md|ipynb))(#[^"]*)?"')
log = logging.getLogger("mkdocs.hooks")


def on_page_content(html: str, page: Any, config: Any, files: Any) -> str:
    """Return a notebook's page with links to the pages that its links to sources become."""
    if not page.file.src_uri.endswith(".ipynb"):
        return html

    def built(found: re.Match[str]) -> str:
        place = posixpath.normpath(posixpath.join(posixpath.dirname(page.file.src_uri), found[1]))
        target = files.get_file_from_path(place)
        if target is None:
            log.warning("%s: a link to %s, which is not there", page.file.src_uri, found[1])
            return found[0]
        return f'href="{target.url_relative_to(page.file)}{found[2] or ""}"'

    return LINK.sub(built, html)
