"""What `rx90_view` prints, for the programs that start it; needs nothing of the page."""

OPENED = "the page is open"
"""When a browser has loaded the page for the first time."""

TO_OTHERS = "other machines can open the page, too, and do with it what you can"
"""Before the address, of a page that they reach."""
