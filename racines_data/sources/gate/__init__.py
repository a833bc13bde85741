"""The one gate that every trajectory passes, whatever its source: at build, at import, at validate.

`bounds` says what is plausible of a source, `numbers` looks at poses, times and forces, `motion` at
what they say together, `pixels` at the images; `check` runs them. What is checked, and what no one
can tell from the numbers, stands in docs/import.md.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
