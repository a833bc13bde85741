from .frames import MaskSet as MaskSet
from .model import SegmentationConfig as SegmentationConfig
from .model import SegmentationJudge as SegmentationJudge

__all__ = ["MaskSet", "SegmentationConfig", "SegmentationJudge"]
