"""Looking at an arm in a browser: one page with a scene and tabs, from viser, and a locked panel that moves the arm.

`Page` starts the server and owns the thread that `Page.run` is called on; a part builds what it shows once, when it is
made, and has its functions called on that thread:

- `with page.tab("Live"): page.gui.add_html(...)` adds a tab. `page.gui` and `page.scene` are viser's own; the scene's
  unit is m, z is up, its origin is the arm's base.
- `page.every(period, function)` calls `function(now)` again and again while the page runs, `now` from
  `time.monotonic()`. Read, compute and draw there.
- viser calls back on threads of its own. Such a callback does nothing but hand over: `page.later(function)` has it
  called once on the page's thread. So no part needs a lock.

Viser serves whoever connects, other pages in the same browser included. So all that `page.gui` holds is shown alone,
without an input; inputs are those of `ControlPanel`, made for one client after it has given the code.

page, scene, live and panel are of the page, tour of the arm that `rx90 view --demo` moves.
"""
