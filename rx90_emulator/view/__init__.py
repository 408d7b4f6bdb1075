"""Looking at an arm in a browser: one page with a scene, tabs and rolling plots, from viser.

`Page` starts the server and owns the thread that `Page.run` is called on; a part builds what it shows once, when it is
made, and has its functions called on that thread:

- `with page.tab("Bag"): page.gui.add_slider(...)` adds a tab to the control panel; `with page.plot_tab("Friction"):`
  one to the panel of plots. `page.gui` and `page.scene` are viser's own; the scene's unit is m, z is up, its origin
  is the arm's base.
- `page.every(period, function)` calls `function(now)` again and again while the page runs, `now` from
  `time.monotonic()`. Read, compute and draw there.
- viser calls back (`on_click`, `on_update`) on threads of its own. Such a callback does nothing but hand over:
  `page.later(function)` has it called once on the page's thread. So no part needs a lock. A field that the page
  changes, too, goes through `on_change`, which loses nothing that a user gives at the same time.
- What writes a file goes through `FileFields`: beneath one folder, and over a file that is there only where a user has
  confirmed it.

page, guard, scene, plots are for all; live, processes and panel with its forms are of running nodes, whose ROS clients
stand in `rx90_common/exchange/` and the rooms' `node/`; recording and player are of bags. `rx90_emulator/cli/view.py`
puts them together.
"""

OPENED = "the page is open"
"""What `rx90_view` prints when a browser has loaded the page for the first time."""

TO_OTHERS = (
    "other machines can open the page, too: who has its address with the token can move the arm, switch its torque and "
    "write files beneath --output, and who listens on the way can read the address"
)
"""What it prints before the address of a page that other machines reach."""
