from .run import TransferConfig as TransferConfig

__all__ = ["TransferConfig"]
