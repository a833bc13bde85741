"""Files that readers never see half-written."""

import io
import json
import os
from pathlib import Path
from typing import Any

from PIL import Image


def write_atomic(path: Path, content: bytes) -> None:
    """Write a file under a temporary name, then rename it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(path.name + ".partial")
    partial.write_bytes(content)
    os.replace(partial, path)


def write_json(path: Path, content: dict[str, Any]) -> None:
    """Write readable JSON atomically."""
    write_atomic(path, (json.dumps(content, indent=2) + "\n").encode())


def image_bytes(image: Image.Image) -> bytes:
    """Encode a picture as PNG."""
    buffer = io.BytesIO()
    image.save(buffer, "PNG")
    return buffer.getvalue()
