"""LeRobot: its policies in our tasks (`env`, `envhub`), and back on our board (`to_onnx`)."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
