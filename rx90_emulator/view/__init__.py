"""Looking at an arm in a browser: one page with a scene, tabs and rolling plots, from viser; no ROS in this folder.

How parts plug in. `Page` starts the server and owns the thread that `Page.run` is called on; a part builds what it
shows once, when it is made, and has its functions called on that thread:

- `with page.tab("Bag"): page.gui.add_slider(...)` adds a tab to the control panel; `with page.plot_tab("Friction"):`
  one to the panel of plots. `page.gui` and `page.scene` are viser's own; the scene's unit is m, z is up, its origin
  is the arm's base.
- `page.every(period, function)` calls `function(now)` again and again while the page runs, `now` from
  `time.monotonic()`. Read, compute and draw there.
- viser calls back (`on_click`, `on_update`) on threads of its own. Such a callback does nothing but hand over:
  `page.later(function)` has it called once on the page's thread. So no part needs a lock. A field that the page
  changes, too, goes through `on_change` of `changes.py`, which loses nothing that a user gives at the same time.
- `ArmScene(page, "/second", robot, ghost=(0, 114, 178)).show(position)` draws an arm in a pose; `LineScene` a line with
  the laser spot and its coloured trace; `RollingPlot` and `LoopPlot` plots, of which nothing grows without end.
- What writes a file asks `page.output.path_for(name)` for its path: beneath one folder, and over a file that is there
  only where a user has confirmed it.
- `ArmState` is what a part that reads (nodes, a bag) hands to one that draws.

Subfolders are such parts: `live/` reads running nodes. A part that needs nodes gets them through clients in
`rx90_common/exchange/` and the rooms' `node/`. The command that puts parts together is `rx90_emulator/cli/view.py`.
"""
