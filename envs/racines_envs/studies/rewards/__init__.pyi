from .report import RewardReportConfig as RewardReportConfig

__all__ = ["RewardReportConfig"]
