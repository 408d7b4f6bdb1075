"""What `rx90_view` prints, for the programs that start it; needs nothing of the page."""

OPENED = "the page is open"
"""When a browser has loaded the page for the first time."""
