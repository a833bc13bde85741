from .naming import check_name as check_name

__all__ = ["check_name"]
