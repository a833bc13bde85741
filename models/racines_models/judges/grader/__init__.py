"""The grader: one ResNet-18 that says which view an image shows, and how good it is.

`model` judges, `training` teaches it views, then grades; `report` holds it against labels and
`annotate` lets it label a dataset.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
