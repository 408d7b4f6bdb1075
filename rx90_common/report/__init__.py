"""What every HTML report of the suite shares: its page and the look of its plots."""

__all__ = ["drawing", "page"]
