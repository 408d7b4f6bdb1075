"""What `rx90_view` prints, for the programs that start it; needs nothing of the page."""

OPENED = "the page is open"
"""When a browser has loaded the page for the first time."""

TO_OTHERS = (
    "other machines can open the page, too: who has its address with the token can move the arm, switch its torque and "
    "write files beneath --output, and who listens on the way can read the address"
)
"""Before the address, of a page that they reach."""
