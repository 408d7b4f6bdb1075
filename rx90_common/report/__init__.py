"""What every HTML report of the suite shares: the look of its plots."""

__all__ = ["drawing"]
