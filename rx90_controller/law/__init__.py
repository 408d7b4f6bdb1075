"""The CS7B's control law and its supervision, compiled, and the controller that the nodes and the closed loop use."""
