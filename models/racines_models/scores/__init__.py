"""Scores of a generator on held-out poses: each number with n, an interval and its provenance.

`scoring` is the way in, `scorer` makes the figures of one sample; `metrics` and `diversity` hold
the metrics, `features` the networks behind the distances, and `plugin` what a metric of another
package is.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
