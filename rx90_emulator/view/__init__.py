"""What people look at in a browser: the arm, its friction, and recorded bags."""
