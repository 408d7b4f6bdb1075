"""What every HTML report of the suite shares: its page, and plots that are described once and drawn in one style."""
