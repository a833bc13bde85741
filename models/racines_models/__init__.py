"""Image generators, the networks that judge images, and the scores of generators.

`protocol` says what a generator is, `registry` finds one, `weights` reads and writes its tensors;
`statistics` has the intervals of all scores, `provenance` the hashes that stand beside them.
"""

from racines_data import renamed

renamed.install()
